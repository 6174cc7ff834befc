//! How long a path takes.

use crate::{Costmap, PlanError, Waypoint};
use percept_geometry::se3::wrap_angle;

/// How fast a robot may drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedLimits {
    /// Forwards and backwards, m/s; 0.001 to 100.
    pub max_speed_mps: f64,
    /// Speeding up and slowing down, m/s^2; 0.001 to 100.
    pub max_accel_mps2: f64,
    /// rad/s; 0.001 to 100.
    pub max_turn_rate_radps: f64,
}

impl Default for SpeedLimits {
    /// Those of nav2's default velocity smoother and controller for a small robot, rounded.
    fn default() -> Self {
        Self { max_speed_mps: 0.5, max_accel_mps2: 1.0, max_turn_rate_radps: 1.0 }
    }
}

impl SpeedLimits {
    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), PlanError> {
        let check = |field, value: f64| {
            let remedy = "choose 0.001 to 100";
            let inside = (1e-3..=100.0).contains(&value);
            if inside { Ok(()) } else { Err(PlanError::InvalidParam { field, value, remedy }) }
        };
        check("speed.max_speed_mps", self.max_speed_mps)?;
        check("speed.max_accel_mps2", self.max_accel_mps2)?;
        check("speed.max_turn_rate_radps", self.max_turn_rate_radps)
    }

    /// Seconds from the first waypoint to each: from rest to rest, at rest too where the direction of motion changes, and in
    /// between as fast as allowed. On each leg speed rises, stays and falls: a trapezoid.
    ///
    /// A leg on which the heading turns is driven no faster than the turn rate allows.
    pub(crate) fn times(&self, costmap: &Costmap, waypoints: &[Waypoint]) -> Vec<f64> {
        let legs: Vec<Leg> = waypoints.windows(2).map(|pair| self.leg(costmap, &pair[0], &pair[1])).collect();
        let accel = self.max_accel_mps2;
        let mut speeds = vec![0.0; waypoints.len()];
        for i in 1..legs.len() {
            if waypoints[i - 1].is_reverse == waypoints[i].is_reverse {
                let reachable = (speeds[i - 1] * speeds[i - 1] + 2.0 * accel * legs[i - 1].length).sqrt();
                speeds[i] = legs[i - 1].limit.min(legs[i].limit).min(reachable);
            }
        }
        for i in (1..legs.len()).rev() {
            speeds[i] = speeds[i].min((speeds[i + 1] * speeds[i + 1] + 2.0 * accel * legs[i].length).sqrt());
        }
        let mut out = vec![0.0];
        for (i, leg) in legs.iter().enumerate() {
            out.push(out[i] + leg.seconds(speeds[i], speeds[i + 1], accel));
        }
        out
    }

    fn leg(&self, costmap: &Costmap, a: &Waypoint, b: &Waypoint) -> Leg {
        let chord = (b.position - a.position).norm();
        let half = 0.5 * wrap_angle(b.yaw_rad - a.yaw_rad).abs();
        // Along the arc, if it is one: at a corner between straight legs the difference is small.
        let length = if half > 1e-6 && half < 1.0 { chord * half / half.sin() } else { chord };
        let turning = if half > 0.0 { self.max_turn_rate_radps * length / (2.0 * half) } else { f64::INFINITY };
        let share = costmap.slowest_between(&a.position, &b.position);
        Leg { length, limit: turning.min(self.max_speed_mps * share) }
    }
}

struct Leg {
    length: f64,
    /// m/s.
    limit: f64,
}

impl Leg {
    fn seconds(&self, begin: f64, end: f64, accel: f64) -> f64 {
        if self.length <= 0.0 || self.limit <= 0.0 {
            return 0.0;
        }
        let most = (0.5 * (begin * begin + end * end) + accel * self.length).sqrt().min(self.limit);
        let ramps = ((most * most - begin * begin) + (most * most - end * end)).max(0.0) / (2.0 * accel);
        ((most - begin) + (most - end)).max(0.0) / accel + (self.length - ramps).max(0.0) / most
    }
}
