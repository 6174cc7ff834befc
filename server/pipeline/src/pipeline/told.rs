//! Somebody says where the robot is: it was not found, or in a wrong place.

use super::Pipeline;
use crate::frontend::{FoundAt, View};
use crate::map_graph::{Doubt, MapUpdate, UnanchoredView};
use percept_geometry::{Covariance6, Pose, se3};
use percept_slam::{OdometryEstimate, OdometryKind, TrackingState};

/// What became of it that somebody said where the robot is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Told {
    /// What it sees lies there, within what people err by; it is there, tentatively, until what it sees elsewhere agrees.
    Placed,
    /// Nobody has mapped that place, so nothing that it sees can say otherwise: it is there, tentatively, until what it sees agrees with the
    /// map.
    Believed,
    /// What it sees does not fit there, or contradicts what was seen there. Nothing was changed.
    Refuted,
    /// There is no map that it could be in.
    NoMap,
    /// A camera alone cannot be compared with the map, or does not know its scale yet.
    CannotTell,
}

/// So unsure is what a person points out on a map where nothing can be compared with it, standard deviations: RViz' own, metres and
/// radians.
const POINTED_OUT: (f64, f64) = (0.5, 0.26);

impl Pipeline {
    /// With the next view that moves the pose, the robot is looked for around `t_map_base`, base to map, within a metre and half a radian
    /// ([`FrameReport::told`](super::FrameReport::told)). Of a robot in the plane x, y and yaw count. None takes back what was told if no
    /// view has come since.
    pub fn tell_pose(&mut self, t_map_base: Option<Pose>) {
        self.told = t_map_base;
    }

    /// Looks for the robot where it is told to be, and goes on from there if it is.
    pub(super) fn go_where_told(
        &mut self,
        (view, kind): (&View, OdometryKind),
        estimate: &mut OdometryEstimate,
        update: &mut MapUpdate,
    ) -> Option<Told> {
        let t_map_base = self.told.take()?;
        if kind == OdometryKind::Mono || !estimate.scale.is_metric() {
            return Some(Told::CannotTell);
        }
        if self.map_graph.keyframes().is_empty() {
            return Some(Told::NoMap);
        }
        let t_map_base = match kind {
            OdometryKind::Lidar2d => {
                se3::from_xy_yaw(t_map_base.translation.x, t_map_base.translation.y, se3::yaw(&t_map_base))
            }
            _ => t_map_base,
        };
        let t_odom_told = self.map_graph.t_map_odom().inverse() * t_map_base;
        let near = self.map_graph.seen_near(kind, &view.spec.id, &t_odom_told);
        let (told, t_map_base, in_map) = if near.is_empty() {
            let (m, rad) = POINTED_OUT;
            let sigmas = [m, m, m, rad, rad, rad];
            (Told::Believed, t_map_base, Covariance6::from_diagonal(&sigmas.map(|s| s * s).into()))
        } else {
            let Some(placed) = self.frontend.look_at(view, &t_odom_told, &near) else {
                return Some(Told::Refuted);
            };
            (Told::Placed, self.map_graph.t_map_odom() * placed.t_odom_base, placed.covariance)
        };
        let seen = UnanchoredView {
            kind,
            sensor: &view.spec.id,
            pose_sensor: self.frontend.pose_sensor(),
            scan: &view.scan,
            estimate,
            usual_inlier_ratio: self.frontend.usual_inlier_ratio(),
            kept: &|| self.frontend.kept_of(view),
        };
        self.map_graph.go_elsewhere(&seen, &t_map_base, update);
        let near = self.map_graph.seen_near(kind, &view.spec.id, &estimate.t_odom_base);
        estimate.state = TrackingState::Tracking;
        self.frontend.go_on_at(view, estimate, &near);
        self.found_at = Some(FoundAt { t_odom_base: estimate.t_odom_base, of_odometry: estimate.covariance, in_map });
        self.doubt = if told == Told::Placed { Doubt::LooksAlike } else { Doubt::WordAlone };
        Some(told)
    }
}
