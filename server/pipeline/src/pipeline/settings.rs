//! Parameters that may change while a session lives, and how they take effect.

use super::Pipeline;
use crate::{ParamsError, PipelineParams, SlamParams};
use percept_slam::{KeyframeParams, OdometryParams};
use std::sync::Arc;

/// Sections whose parameters may change.
const CHANGEABLE: [&str; 8] = [
    "slam.odometry.keyframe.",
    "slam.localisation_only",
    "live.",
    "detection.",
    "tracker.",
    "relations.",
    "rooms.",
    "planning.",
];

/// Those in them that stay: keyframes that are there are known by it.
const FIXED: [&str; 1] = ["slam.odometry.keyframe.features"];

/// Whether the parameter at a dotted path may change while a session lives. Those of the map layers and of odometry may
/// not: the map is rebuilt from its keyframes time and again, and has to come out the same.
pub fn may_change(path: &str) -> bool {
    CHANGEABLE.iter().any(|section| path.starts_with(section)) && !FIXED.contains(&path)
}

impl PipelineParams {
    /// These, with all that may change taken from `other`.
    fn changed_as(&self, other: &Self) -> Self {
        let features = self.slam.odometry.keyframe.features;
        let keyframe = KeyframeParams { features, ..other.slam.odometry.keyframe.clone() };
        let odometry = OdometryParams { keyframe, ..self.slam.odometry.clone() };
        let slam = SlamParams { odometry, localisation_only: other.slam.localisation_only, ..self.slam.clone() };
        Self { slam, map: self.map, preset: self.preset, ..other.clone() }
    }
}

impl Pipeline {
    /// The parameters in force.
    pub fn params(&self) -> &PipelineParams {
        &self.params
    }

    /// Changes parameters, from the next frame on: how objects are found, followed and related, how paths are planned, when
    /// keyframes are made and what they keep.
    ///
    /// # Errors
    /// A parameter out of bounds, or one that may not change; nothing was changed.
    pub fn set_params(&mut self, params: PipelineParams) -> Result<(), ParamsError> {
        params.validate()?;
        if self.params.changed_as(&params) != params {
            let message = "a parameter that is fixed once a session is there was changed".to_owned();
            return Err(ParamsError { section: "map or slam", message });
        }
        self.scene.set_params(&params)?;
        self.frontend.set_params(params.slam.clone());
        self.map_graph.set_params(params.slam.clone());
        self.params = Arc::new(params);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changed(change: impl FnOnce(&mut PipelineParams)) -> (PipelineParams, bool) {
        let mut params = PipelineParams::default();
        change(&mut params);
        let is_taken = Pipeline::new(PipelineParams::default()).unwrap().set_params(params.clone()).is_ok();
        (params, is_taken)
    }

    #[test]
    fn what_may_change_is_taken_and_shown_and_what_may_not_is_refused() {
        let mut pipeline = Pipeline::new(PipelineParams::default()).unwrap();
        let (params, is_taken) = changed(|p| {
            p.slam.odometry.keyframe.distance_m = 0.7;
            p.slam.localisation_only = true;
            p.detection.enabled = false;
            p.tracker.confirm_observations = 7;
            p.relations.max_distance_m = 3.0;
            p.planning.robot_radius_m = 0.3;
        });
        assert!(is_taken);
        pipeline.set_params(params.clone()).unwrap();
        assert_eq!(*pipeline.snapshot().params, params);
        assert!(!changed(|p| p.map.cloud.voxel_size_m = 0.2).1);
        assert!(!changed(|p| p.slam.pose_sensor = "laser".to_owned()).1);
        assert!(!changed(|p| p.slam.odometry.tracking.max_gap_s += 0.5).1);
        assert!(!changed(|p| p.planning.robot_radius_m = -1.0).1);
    }
}
