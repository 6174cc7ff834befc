//! A submap: keyframes that belong together, and what they have seen, in a frame of its own.

use crate::layer::{Placement, moved};
use crate::layers::{LayerBoxes, LayerSlots, Part, SubmapLayers};
use crate::params::MapParams;
use crate::submap_id::SubmapId;
use nalgebra::{UnitQuaternion, Vector3};
use percept_geometry::{KeyframeId, Pose, Timestamp, se3};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Keyframes that belong together, and what they have seen, in a frame of its own: that of the map when it was begun, so
/// that its cells are the map's until a correction moves it.
///
/// The newest submap of a map is filled; the others are frozen: a correction moves them as a whole.
#[derive(Debug, Clone)]
pub struct Submap {
    pub(crate) id: SubmapId,
    pub(crate) t_map_submap: Pose,
    /// Where its layers have each keyframe: base to submap.
    keyframes: BTreeMap<KeyframeId, Pose>,
    /// Mean height of these, submap's frame, metres.
    height_m: f64,
    /// Of its layers, submap's frame.
    pub(crate) boxes: LayerBoxes,
    pub(crate) is_frozen: bool,
    /// Stamp of its newest keyframe; none if it was given.
    pub(crate) seen: Option<Timestamp>,
    /// Whether that was too long ago: its layers are not shown any more.
    pub(crate) is_expired: bool,
    pub(crate) slots: Arc<LayerSlots>,
}

impl Submap {
    pub(crate) fn new(id: SubmapId, params: &MapParams) -> Self {
        Self {
            id,
            t_map_submap: Pose::identity(),
            keyframes: BTreeMap::new(),
            height_m: 0.0,
            boxes: LayerBoxes::empty(),
            is_frozen: false,
            seen: None,
            is_expired: false,
            slots: Arc::new(LayerSlots::new(params, &SubmapLayers::new(params))),
        }
    }

    /// Which it is.
    pub fn id(&self) -> SubmapId {
        self.id
    }

    /// Submap to map.
    pub fn t_map_submap(&self) -> &Pose {
        &self.t_map_submap
    }

    /// Where its layers have each of its keyframes: base to submap.
    pub fn keyframes(&self) -> &BTreeMap<KeyframeId, Pose> {
        &self.keyframes
    }

    /// Whether nothing is added to it any more.
    pub fn is_frozen(&self) -> bool {
        self.is_frozen
    }

    /// Whether its layers are in memory.
    pub fn is_loaded(&self) -> bool {
        self.slots.is_loaded()
    }

    /// Its layers hold a further keyframe, of this stamp if a robot has made it.
    pub(crate) fn add_keyframe(&mut self, id: KeyframeId, t_submap_base: Pose, seen: Option<Timestamp>) {
        self.seen = self.seen.max(seen);
        self.keyframes.insert(id, t_submap_base);
        let heights = self.keyframes.values().map(|t| t.translation.vector.z);
        self.height_m = heights.sum::<f64>() / self.keyframes.len() as f64;
    }

    /// Where it lies.
    pub(crate) fn place(&self) -> Placement {
        let floor_z_m = self.height_m + self.t_map_submap.translation.vector.z;
        Placement { t_map_submap: self.t_map_submap, floor_z_m }
    }

    /// Boxes of its layers in the map.
    pub(crate) fn boxes_in_map(&self, margin_m: f64) -> LayerBoxes {
        self.in_map(&self.boxes, margin_m)
    }

    /// Boxes in its frame as boxes in the map; a margin makes up for cells that do not lie on the map's.
    pub(crate) fn in_map(&self, boxes: &LayerBoxes, margin_m: f64) -> LayerBoxes {
        let place = self.place();
        if place.is_aligned() {
            return boxes.clone();
        }
        let margin = Vector3::repeat(margin_m);
        boxes.map(|b| {
            let mut out = moved(&place.t_map_submap, b);
            (out.min, out.max) = (out.min - margin, out.max + margin);
            out
        })
    }

    pub(crate) fn part(&self, margin_m: f64) -> Part {
        let (place, boxes) = (self.place(), self.boxes_in_map(margin_m));
        Part { id: self.id, place, boxes, slots: Arc::clone(&self.slots), is_frozen: self.is_frozen }
    }
}

/// The motion that takes poses in one frame nearest to those in another, and so takes what hangs on them along: the mean of
/// what each pair says of the turn, then of the shift.
///
/// Pairs are (in a, in b); the identity without any.
pub(crate) fn best_fit(pairs: &[(Pose, Pose)]) -> Pose {
    let Some((first_a, first_b)) = pairs.first() else { return Pose::identity() };
    let n = pairs.len() as f64;
    let first = first_a.rotation * first_b.rotation.inverse();
    let off = |(a, b): &(Pose, Pose)| (first.inverse() * a.rotation * b.rotation.inverse()).scaled_axis();
    // Turns within a submap differ little, so that their logarithms may be averaged.
    let rotation = first * UnitQuaternion::from_scaled_axis(pairs.iter().map(off).sum::<Vector3<f64>>() / n);
    let shift = |(a, b): &(Pose, Pose)| a.translation.vector - rotation * b.translation.vector;
    let translation = pairs.iter().map(shift).sum::<Vector3<f64>>() / n;
    let t_a_b = Pose::from_parts(translation.into(), rotation);
    // Rounding alone moves nothing: aligned frames stay aligned.
    if se3::log(&t_a_b).norm() < 1e-9 { Pose::identity() } else { t_a_b }
}
