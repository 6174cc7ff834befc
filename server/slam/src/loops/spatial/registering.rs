//! Submaps registered a step a keyframe: all at once takes seconds, and no frame shall wait for that.

use super::submap::{Placed, Surface};
use nalgebra::Translation3;
use percept_geometry::{KeyframeId, KeyframeScan, Pose};
use percept_perception::registration::{GlobalOutcome, GlobalParams, GlobalResult, GlobalSearch};
use std::borrow::Cow;
use std::sync::Arc;

/// What a submap's keyframes saw, and where they are believed to be, base to map.
#[derive(Debug)]
pub(super) struct Views {
    /// Base to map at the keyframe that the map is tied by.
    pub(super) t_map_anchor: Pose,
    pub(super) keyframes: Vec<(KeyframeId, Arc<KeyframeScan>, Pose)>,
}

impl Views {
    pub(super) fn surface(&self) -> Option<Surface> {
        let placed: Vec<Placed<'_>> = self.keyframes.iter().map(|(id, scan, t)| (*id, scan.as_ref(), *t)).collect();
        Surface::around(&self.t_map_anchor, &placed)
    }
}

/// The later of two submaps being laid over the earlier one.
#[derive(Debug)]
pub(super) struct Registering {
    from: Views,
    to: Views,
    /// From the first step on.
    search: Option<GlobalSearch<'static>>,
}

/// How far that is.
#[derive(Debug)]
pub(super) enum Step {
    /// There is more to do.
    GoesOn,
    /// Base at the later map's anchor, seen from base at the earlier one's; none unless that is certain.
    Done(Option<Pose>),
}

impl Registering {
    pub(super) fn new(from: Views, to: Views) -> Self {
        Self { from, to, search: None }
    }

    /// One step.
    pub(super) fn step(&mut self) -> Step {
        let Some(search) = &mut self.search else {
            let surfaces = self.to.surface().zip(self.from.surface());
            self.search = surfaces.and_then(|(to, from)| {
                let params = params(&to, &from);
                GlobalSearch::new(Cow::Owned(to.cloud), Cow::Owned(from.cloud), &params).ok()
            });
            return if self.search.is_some() { Step::GoesOn } else { Step::Done(None) };
        };
        let Some(answer) = search.step() else { return Step::GoesOn };
        // Both surfaces have the axes of the session's map, and each its origin at its anchor.
        let turned = |v: &Views| Pose::from_parts(Translation3::identity(), v.t_map_anchor.rotation);
        let between = |found: GlobalResult| turned(&self.from).inverse() * found.t_target_source * turned(&self.to);
        Step::Done(answer.ok().filter(is_certain).map(between))
    }
}

/// For laying one surface over another.
pub(super) fn params(source: &Surface, target: &Surface) -> GlobalParams {
    GlobalParams { voxel_size_m: source.voxel_m.max(target.voxel_m), ..GlobalParams::default() }
}

/// Whether it is a measurement: what the clouds leave open (the length of a corridor) is none.
pub(super) fn is_certain(found: &GlobalResult) -> bool {
    found.outcome == GlobalOutcome::Found && !found.degenerate_axes.contains(&true)
}
