//! How the camera moved from view to view by other sources: what keeps lengths metres.

use super::map::ViewId;
use percept_geometry::Pose;
use std::collections::BTreeMap;

/// How the camera moved from one view to another by another source.
#[derive(Debug, Clone, Copy)]
pub(super) struct KnownStep {
    /// Metres.
    pub(super) t_a_b: Pose,
    /// Of its translation, each axis, square metres.
    pub(super) variance: f64,
}

/// Steps by the views that they join.
#[derive(Debug, Clone, Default)]
pub(super) struct KnownSteps(pub(super) BTreeMap<(ViewId, ViewId), KnownStep>);

impl KnownSteps {
    /// A view goes: the step to it and the one from it become one.
    pub(super) fn bridge(&mut self, gone: ViewId) {
        let to = self.0.iter().find(|((_, b), _)| *b == gone).map(|(&k, &s)| (k, s));
        let from = self.0.iter().find(|((a, _), _)| *a == gone).map(|(&k, &s)| (k, s));
        self.0.retain(|&(a, b), _| a != gone && b != gone);
        if let (Some(((a, _), first)), Some(((_, b), second))) = (to, from) {
            let step = KnownStep { t_a_b: first.t_a_b * second.t_a_b, variance: first.variance + second.variance };
            self.0.insert((a, b), step);
        }
    }
}
