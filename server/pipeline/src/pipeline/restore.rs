//! A session goes on from what was stored of it.

use super::Pipeline;
use crate::map_graph::{Doubt, End};
use crate::{PoseEstimate, Restored};
use percept_geometry::Covariance6;
use percept_mapping::given::is_given;
use percept_slam::{OdometryKind, Scale, TrackingState};

/// So many of the distances between keyframes from the last one is far.
const FAR_KEYFRAMES: f64 = 3.0;

impl Pipeline {
    /// Brings back what was stored; sensors must be declared before.
    pub fn restore(&mut self, restored: Restored) {
        for (id, stamp) in &restored.last_stamps {
            self.frontend.set_last_stamp(id, *stamp);
        }
        let own = restored.keyframes.iter().filter(|k| !is_given(k.sensor()));
        own.for_each(|k| self.frontend.go_on_from(k.sensor(), &k.t_odom_base));
        let end = self.map_graph.restore(&restored);
        self.scene.restore(&self.params, &restored.objects, restored.next_object_id);
        match end {
            // A robot that only localises in a map that was given starts where it was.
            Some(end) if is_given(&end.sensor) => {
                self.frontend.wait_to_be_found();
                (self.start, self.doubt) = (Some(end.t_map_base), Doubt::LooksAlike);
            }
            Some(end) => self.resume(&end, &restored),
            None if !restored.keyframes.is_empty() => {
                self.frontend.wait_to_be_found();
                self.start = restored.start;
            }
            None => {}
        }
        self.count_memory();
    }

    /// Takes up odometry where the trajectory ends, with the last keyframes as the local model.
    fn resume(&mut self, end: &End, restored: &Restored) {
        let graph = &self.map_graph;
        // Who maps leaves keyframes behind: a robot that is far from the last was on probation.
        let far_m = FAR_KEYFRAMES * self.params.slam.odometry.keyframe.distance_m;
        let is_doubtful = end.t_anchor_base.translation.vector.norm() > far_m;
        self.doubt = if is_doubtful { Doubt::LooksAlike } else { Doubt::None };
        let recent = match is_doubtful || self.params.slam.localisation_only {
            // The newest ones are where it mapped last.
            true => graph.keyframes_near(&end.sensor, &end.t_odom_base),
            false => graph.recent_keyframes(&end.sensor),
        };
        let Some(kind) = self.frontend.resume(&end.sensor, (end.t_odom_base, end.stamp), &recent) else { return };
        self.map_graph.restore_constraints(kind, &end.sensor, restored);
        self.pose = Some(PoseEstimate {
            stamp: end.stamp,
            state: TrackingState::Initialising,
            t_map_base: end.t_map_base,
            t_odom_base: end.t_odom_base,
            covariance: Covariance6::identity() * 1e-2,
            inlier_ratio: 0.0,
            rmse_m: 0.0,
            degenerate_axes: [false; 6],
            // A camera's own map is not stored: it begins anew.
            scale: if kind == OdometryKind::Mono { Scale::Unknown } else { Scale::Measured },
            waiting: None,
            is_relocalised: false,
            is_tentative: false,
            led_by: None,
            map_version: self.map_graph.map().version(),
        });
    }
}
