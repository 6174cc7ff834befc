//! One keyframe as layers take it in, with what several of them want to know of it.

use crate::cloud::range_image::RangeImage;
use crate::ground::{Ground, GroundParams};
use nalgebra::{Point3, Vector3};
use percept_geometry::{KeyframeScan, Pose};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// A keyframe's scan, and where it was taken in the frame that is filled, a submap's.
///
/// What follows from both is found once, by whichever layer asks first.
pub struct KeyframeView<'a> {
    /// Base to submap.
    pub t_submap_base: Pose,
    /// What was seen.
    pub scan: &'a KeyframeScan,
    /// Base at the keyframe before, seen from base now, if the way from there was measured.
    pub t_base_before: Option<Pose>,
    ends: OnceLock<Ends>,
    ranges: OnceLock<Arc<RangeImage>>,
    grounds: Mutex<Vec<(GroundParams, Arc<Ground>)>>,
}

/// Where beams end, submap's frame.
struct Ends {
    hits: Vec<Point3<f64>>,
    misses: Vec<Point3<f64>>,
}

impl<'a> KeyframeView<'a> {
    /// Of a scan taken at `t_submap_base`, of which it is not known where base was before.
    pub fn new(t_submap_base: &Pose, scan: &'a KeyframeScan) -> Self {
        Self {
            t_submap_base: *t_submap_base,
            scan,
            t_base_before: None,
            ends: OnceLock::new(),
            ranges: OnceLock::new(),
            grounds: Mutex::default(),
        }
    }

    /// The same, of which it is known.
    pub fn coming_from(self, t_base_before: Option<Pose>) -> Self {
        Self { t_base_before, ..self }
    }

    /// Where the sensor was, submap's frame.
    pub(crate) fn sensor(&self) -> Point3<f64> {
        (self.t_submap_base * self.scan.t_base_sensor).translation.vector.into()
    }

    /// Height of the floor under base, submap's frame, metres.
    pub(crate) fn floor_z(&self) -> f64 {
        self.t_submap_base.translation.vector.z - self.scan.base_height_m
    }

    fn ends(&self) -> &Ends {
        self.ends.get_or_init(|| {
            let placed = |points: &[Point3<f32>]| points.iter().map(|p| self.t_submap_base * p.cast::<f64>()).collect();
            Ends { hits: placed(&self.scan.hits.positions), misses: placed(&self.scan.misses) }
        })
    }

    /// Ends of beams that returned, submap's frame.
    pub(crate) fn hits(&self) -> &[Point3<f64>] {
        &self.ends().hits
    }

    /// Ends of those that did not.
    pub(crate) fn misses(&self) -> &[Point3<f64>] {
        &self.ends().misses
    }

    /// How far it was seen in each direction.
    pub(crate) fn ranges(&self) -> &Arc<RangeImage> {
        let ends = || self.hits().iter().chain(self.misses()).copied();
        self.ranges.get_or_init(|| Arc::new(RangeImage::new(self.sensor(), ends())))
    }

    /// The ground that it shows.
    pub(crate) fn ground(&self, params: &GroundParams) -> Arc<Ground> {
        // Whoever wants it as well waits for it.
        let mut grounds = self.grounds.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, known)) = grounds.iter().find(|(of, _)| of == params) {
            return Arc::clone(known);
        }
        let up = self.t_submap_base * Vector3::z();
        let ground = Arc::new(Ground::new(params, &self.sensor(), (self.floor_z(), &up), self.hits()));
        grounds.push((*params, Arc::clone(&ground)));
        ground
    }
}
