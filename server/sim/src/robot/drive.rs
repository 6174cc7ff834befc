//! A drive in time: along the path, but for the times when the robot stands still or is carried away.

use super::{Motion, RobotPath, RobotState};
use crate::Disturbances;
use nalgebra::Vector3;
use percept_geometry::Pose;
use std::sync::Arc;

/// From `from_s` on the robot is at `path_s` of its path, and stays there or goes on.
#[derive(Debug, Clone, PartialEq)]
struct Leg {
    from_s: f64,
    path_s: f64,
    moves: bool,
    /// The leg begins where somebody put the robot down.
    put_down: bool,
}

/// The path as it is driven, interruptions included. Times are seconds after the start of the session.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Drive {
    path: Arc<RobotPath>,
    legs: Vec<Leg>,
}

/// An interruption of the drive, by when it is due.
enum Event {
    Pause { lasts_s: f64 },
    Kidnap { carried_s: f64, ahead_s: f64 },
}

impl Drive {
    /// The path with these interruptions. One that is due while another lasts begins when that is over.
    pub(crate) fn new(path: Arc<RobotPath>, disturbances: &Disturbances) -> Self {
        let pauses = disturbances.pauses.iter().map(|p| (p.at_s, Event::Pause { lasts_s: p.lasts_s }));
        let carried = |k: &crate::Kidnap| Event::Kidnap { carried_s: k.carried_s, ahead_s: k.ahead_s };
        let mut events: Vec<(f64, Event)> =
            pauses.chain(disturbances.kidnaps.iter().map(|k| (k.at_s, carried(k)))).collect();
        events.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut legs = vec![Leg { from_s: 0.0, path_s: 0.0, moves: true, put_down: false }];
        for (due_s, event) in events {
            let Some(last) = legs.last().cloned() else { break };
            let begin_s = due_s.max(last.from_s);
            let path_s = last.path_s + begin_s - last.from_s;
            match event {
                Event::Pause { lasts_s } => {
                    // Only where it stands anyway: robots brake.
                    let stop_s = path.next_stop_s(path_s);
                    let from_s = begin_s + stop_s - path_s;
                    legs.push(Leg { from_s, path_s: stop_s, moves: false, put_down: false });
                    legs.push(Leg { from_s: from_s + lasts_s, path_s: stop_s, moves: true, put_down: false });
                }
                Event::Kidnap { carried_s, ahead_s } => {
                    legs.push(Leg { from_s: begin_s, path_s, moves: false, put_down: false });
                    let path_s = path_s + ahead_s;
                    legs.push(Leg { from_s: begin_s + carried_s, path_s, moves: true, put_down: true });
                }
            }
        }
        Self { path, legs }
    }

    /// Base to world.
    pub(crate) fn pose_at(&self, t_s: f64) -> Pose {
        self.state_at(t_s).t_world_base
    }

    fn leg_at(&self, t_s: f64) -> &Leg {
        &self.legs[self.legs.partition_point(|l| l.from_s <= t_s).max(1) - 1]
    }

    /// Pose and motion. A robot that is being carried is said to stand where it was taken.
    pub(crate) fn state_at(&self, t_s: f64) -> RobotState {
        let leg = self.leg_at(t_s);
        let path_s = if leg.moves { leg.path_s + t_s - leg.from_s } else { leg.path_s };
        let state = self.path.state_at(path_s);
        if leg.moves {
            return state;
        }
        RobotState { speed_m_per_s: 0.0, yaw_rate_rad_per_s: 0.0, acceleration_m_per_s2: Vector3::zeros(), ..state }
    }

    /// What an inertial sensor fixed to base feels: turn rate (rad/s) and acceleration without gravity (m/s^2), both in
    /// the sensor's axes.
    pub(crate) fn inertial_at(&self, t_s: f64, t_base_sensor: &Pose) -> (Vector3<f64>, Vector3<f64>) {
        let leg = self.leg_at(t_s);
        if !leg.moves {
            return (Vector3::zeros(), Vector3::zeros());
        }
        let path_s = leg.path_s + t_s - leg.from_s;
        let r_world_base = self.path.pose_at(path_s).rotation;
        let base = self.path.motion_at(path_s);
        let (r, p) = (t_base_sensor.rotation, t_base_sensor.translation.vector);
        let sensor = base.carrying(&r_world_base, &r, &p, &Motion::fixed());
        (sensor.turn_rate, (r_world_base * r).inverse() * sensor.acceleration)
    }

    /// What the wheels turned between two times: without the way on which somebody carried the robot.
    pub(crate) fn driven(&self, from_s: f64, to_s: f64) -> Pose {
        let put_down = self.legs.iter().rev().find(|l| l.put_down && l.from_s > from_s && l.from_s <= to_s);
        let begin = put_down.map_or(from_s, |l| l.from_s);
        self.pose_at(begin).inverse() * self.pose_at(to_s)
    }
}
