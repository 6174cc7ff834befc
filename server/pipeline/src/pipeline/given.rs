//! A session begins with a map that was given.

use super::Pipeline;
use crate::NewKeyframe;
use crate::frontend::View;
use crate::map_graph::Doubt;
use percept_geometry::Pose;
use percept_mapping::given::GivenView;
use percept_slam::ToldPlace;

/// A map was given to a session that has one, or whose robot is under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("there is a map already")]
pub struct NotEmpty;

impl Pipeline {
    /// Begins with a map that was given, as views of it; the map's frame is theirs. A robot that comes is lost in it until it is
    /// found, or starts at `start` (base to map) if that is told.
    ///
    /// # Errors
    /// [`NotEmpty`]; nothing was changed.
    pub fn take_given(&mut self, views: Vec<GivenView>, start: Option<Pose>) -> Result<Vec<NewKeyframe>, NotEmpty> {
        // A robot that only localises has been nowhere before there is a map.
        let has_begun = self.pose.is_some() && self.frontend.tracking().unanchored().is_none();
        if !self.map_graph.keyframes().is_empty() || has_begun {
            return Err(NotEmpty);
        }
        self.pose = None;
        let keyframes = self.map_graph.take_given(views);
        self.frontend.wait_to_be_found();
        self.start = start;
        self.count_memory();
        Ok(keyframes)
    }

    /// Before the first frame of the sensor that moves the pose: what it can be found by, and where it starts if that was told.
    pub(super) fn come_into_given(&mut self, view: &View) {
        let kind = view.kind();
        self.map_graph.prepare_over_given(kind, &view.spec.id);
        let Some(start) = self.start.take() else { return };
        let t_odom_base = self.map_graph.t_map_odom().inverse() * start;
        let near = self.map_graph.given_near(kind, &t_odom_base);
        if self.frontend.start_at(view, &t_odom_base, &near) == Some(ToldPlace::Likely) {
            self.doubt = Doubt::LooksAlike;
        }
    }
}
