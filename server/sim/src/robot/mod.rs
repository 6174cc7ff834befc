//! The robot: how it drives the lane in time.

mod drive;
mod hand;
mod jet;
mod motion;
pub(crate) mod route;

pub(crate) use drive::Drive;
pub use hand::HandheldParams;
pub(crate) use motion::Motion;

use crate::world::World;
use crate::{SimError, check};
use nalgebra::{Point2, Vector2, Vector3};
use percept_geometry::{Pose, se3};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// How the robot moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RobotParams {
    /// Speed on straight lanes, metres a second, 0.05 to 3.
    pub speed_m_per_s: f64,
    /// Greatest turn rate, radians a second, 0.1 to 3.
    pub turn_rate_rad_per_s: f64,
    /// Greatest acceleration along the lane, metres a second squared, 0.05 to 5.
    pub acceleration_m_per_s2: f64,
    /// Greatest change of turn rate, radians a second squared, 0.1 to 10.
    pub turn_acceleration_rad_per_s2: f64,
    /// Whether it stops once in every room and turns around once on the spot.
    pub look_around: bool,
    /// How base moves in the hand of someone who walks the lane; none for a robot on wheels.
    pub handheld: Option<HandheldParams>,
}

impl Default for RobotParams {
    fn default() -> Self {
        Self {
            speed_m_per_s: 0.6,
            turn_rate_rad_per_s: 0.8,
            acceleration_m_per_s2: 0.5,
            turn_acceleration_rad_per_s2: 1.2,
            look_around: true,
            handheld: None,
        }
    }
}

impl RobotParams {
    /// Checks bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        check("speed_m_per_s", self.speed_m_per_s, 0.05, 3.0, "between 0.05 and 3")?;
        check("turn_rate_rad_per_s", self.turn_rate_rad_per_s, 0.1, 3.0, "between 0.1 and 3")?;
        check("acceleration_m_per_s2", self.acceleration_m_per_s2, 0.05, 5.0, "between 0.05 and 5")?;
        let turn = self.turn_acceleration_rad_per_s2;
        check("turn_acceleration_rad_per_s2", turn, 0.1, 10.0, "between 0.1 and 10")?;
        self.handheld.as_ref().map_or(Ok(()), HandheldParams::validate)
    }
}

/// Where the robot is and how it moves. Base: x forward, y left, z up, origin on the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotState {
    /// Base to world.
    pub t_world_base: Pose,
    /// Velocity along base x, metres a second.
    pub speed_m_per_s: f64,
    /// Angular velocity about base z, radians a second.
    pub yaw_rate_rad_per_s: f64,
    /// Acceleration of the base's origin in base axes, metres a second squared, without gravity.
    pub acceleration_m_per_s2: Vector3<f64>,
}

/// A moment of the lap: between two of them the acceleration along the lane and the curvature are constant.
#[derive(Debug, Clone, PartialEq)]
struct Knot {
    t_s: f64,
    position: Point2<f64>,
    /// Continuous along the lap, so that it may leave (-pi, pi].
    heading: f64,
    speed: f64,
    /// The robot turns on the spot by this angle before it goes on to the next knot.
    turn: f64,
}

/// A drive around the lane that can go on for ever: one lap after the other.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotPath {
    knots: Vec<Knot>,
    turn_rate: f64,
    turn_acceleration: f64,
    hand: Option<HandheldParams>,
}

impl RobotPath {
    /// The lap through `world`.
    ///
    /// # Errors
    /// `OutOfRange` naming a parameter.
    pub fn new(world: &World, params: &RobotParams) -> Result<Self, SimError> {
        params.validate()?;
        let route = world.route();
        let n = route.points.len();
        let heading = headings(&route.points);
        let stops: &[usize] = if params.look_around { &route.stops } else { &[] };
        let position = |i: usize| route.points[i % n];
        let step = |i: usize| (position(i + 1) - position(i)).norm();
        let speed = speeds(params, &heading, step, stops);
        let mut path = Self {
            knots: Vec::with_capacity(n + 1),
            turn_rate: params.turn_rate_rad_per_s,
            turn_acceleration: params.turn_acceleration_rad_per_s2,
            hand: params.handheld,
        };
        let mut t_s = 0.0;
        for i in 0..=n {
            let turn = if i < n && stops.binary_search(&i).is_ok() { TAU } else { 0.0 };
            path.knots.push(Knot { t_s, position: position(i), heading: heading[i], speed: speed[i], turn });
            t_s += path.turn_duration(turn);
            if i < n {
                t_s += 2.0 * step(i) / (speed[i] + speed[i + 1]);
            }
        }
        Ok(path)
    }

    /// Seconds for one lap.
    pub fn lap_duration_s(&self) -> f64 {
        self.knots.last().map_or(0.0, |k| k.t_s)
    }

    /// Length of one lap, metres.
    pub fn lap_length_m(&self) -> f64 {
        self.knots.windows(2).map(|k| (k[1].position - k[0].position).norm()).sum()
    }

    /// The first time from `t_s` on at which the robot stands, seconds after the start.
    pub(crate) fn next_stop_s(&self, t_s: f64) -> f64 {
        let lap_s = self.lap_duration_s();
        let begun = (t_s / lap_s).floor() * lap_s;
        let stop = self.knots.iter().find(|k| k.speed == 0.0 && begun + k.t_s >= t_s);
        begun + stop.map_or(lap_s, |k| k.t_s)
    }

    /// Base to world at `t_s` seconds after the start; laps repeat.
    pub fn pose_at(&self, t_s: f64) -> Pose {
        self.state_at(t_s).t_world_base
    }

    /// How base moves in the world at `t_s` seconds after the start: exact derivatives of [`Self::pose_at`].
    pub(crate) fn motion_at(&self, t_s: f64) -> Motion {
        let lane = self.lane_motion_at(t_s);
        let Some(hand) = self.hand else { return lane };
        let (r_world_lane, t_walker_base) = (self.lane_state_at(t_s).t_world_base.rotation, hand.t_walker_base(t_s));
        let p = t_walker_base.translation.vector;
        lane.carrying(&r_world_lane, &t_walker_base.rotation, &p, &hand.motion_in_walker(t_s))
    }

    /// Pose of base, and motion on the lane of the robot or of whoever carries base, at `t_s` seconds after the start;
    /// laps repeat.
    pub fn state_at(&self, t_s: f64) -> RobotState {
        let lane = self.lane_state_at(t_s);
        let t_world_base = self.hand.map_or(lane.t_world_base, |hand| lane.t_world_base * hand.t_walker_base(t_s));
        RobotState { t_world_base, ..lane }
    }

    /// The knots around a time, the time since the first, and how long it is turned there.
    fn between(&self, t_s: f64) -> (&Knot, &Knot, f64, f64) {
        let t = t_s.rem_euclid(self.lap_duration_s());
        let i = self.knots.partition_point(|k| k.t_s <= t).clamp(1, self.knots.len() - 1) - 1;
        let (a, b) = (&self.knots[i], &self.knots[i + 1]);
        (a, b, t - a.t_s, self.turn_duration(a.turn))
    }

    fn lane_motion_at(&self, t_s: f64) -> Motion {
        let (a, b, since, turning) = self.between(t_s);
        let about_z = |v: f64| Vector3::new(0.0, 0.0, v);
        if since < turning {
            let (rate, change) = self.turning_rates(a, since);
            return Motion { turn_rate: about_z(rate), turn_acceleration: about_z(change), ..Motion::fixed() };
        }
        let (since, lasts) = (since - turning, b.t_s - a.t_s - turning);
        let length = 0.5 * (a.speed + b.speed) * lasts;
        let along_lane = (b.speed - a.speed) / lasts;
        let f = ((a.speed + 0.5 * along_lane * since) * since / length).clamp(0.0, 1.0);
        let (df, ddf) = ((a.speed + along_lane * since) / length, along_lane / length);
        let (slope, bend) = hermite_derivatives(a, b, length, f);
        let in_world = |v: Vector2<f64>| Vector3::new(v.x, v.y, 0.0);
        Motion {
            turn_rate: about_z((b.heading - a.heading) * df),
            turn_acceleration: about_z((b.heading - a.heading) * ddf),
            velocity: in_world(slope * df),
            acceleration: in_world(bend * (df * df) + slope * ddf),
        }
    }

    fn lane_state_at(&self, t_s: f64) -> RobotState {
        let (a, b, since, turning) = self.between(t_s);
        if since < turning {
            return self.turning_state(a, since);
        }
        let (since, lasts) = (since - turning, b.t_s - a.t_s - turning);
        let length = 0.5 * (a.speed + b.speed) * lasts;
        let along_lane = (b.speed - a.speed) / lasts;
        let speed = a.speed + along_lane * since;
        let f = ((a.speed + 0.5 * along_lane * since) * since / length).clamp(0.0, 1.0);
        let p = hermite(a, b, length, f);
        let yaw_rate = speed * (b.heading - a.heading) / length;
        RobotState {
            t_world_base: se3::from_xy_yaw(p.x, p.y, a.heading + a.turn + f * (b.heading - a.heading)),
            speed_m_per_s: speed,
            yaw_rate_rad_per_s: yaw_rate,
            acceleration_m_per_s2: Vector3::new(along_lane, speed * yaw_rate, 0.0),
        }
    }

    /// Speeding up, turning evenly, slowing down.
    fn turning_state(&self, knot: &Knot, since: f64) -> RobotState {
        let ramp = self.ramp(knot.turn);
        let peak = ramp * self.turn_acceleration;
        let total = self.turn_duration(knot.turn);
        let eased = |t: f64| 0.5 * self.turn_acceleration * t * t;
        let (angle, rate) = if since < ramp {
            (eased(since), self.turn_acceleration * since)
        } else if since < total - ramp {
            (eased(ramp) + peak * (since - ramp), peak)
        } else {
            (knot.turn - eased(total - since), self.turn_acceleration * (total - since))
        };
        RobotState {
            t_world_base: se3::from_xy_yaw(knot.position.x, knot.position.y, knot.heading + angle),
            speed_m_per_s: 0.0,
            yaw_rate_rad_per_s: rate,
            acceleration_m_per_s2: Vector3::zeros(),
        }
    }

    /// Turn rate and its change while turning on the spot.
    fn turning_rates(&self, knot: &Knot, since: f64) -> (f64, f64) {
        let (ramp, total) = (self.ramp(knot.turn), self.turn_duration(knot.turn));
        let change = self.turn_acceleration;
        if since < ramp {
            (change * since, change)
        } else if since < total - ramp {
            (change * ramp, 0.0)
        } else {
            (change * (total - since), -change)
        }
    }

    fn ramp(&self, turn: f64) -> f64 {
        (self.turn_rate / self.turn_acceleration).min((turn / self.turn_acceleration).sqrt())
    }

    fn turn_duration(&self, turn: f64) -> f64 {
        let ramp = self.ramp(turn);
        if ramp > 0.0 { ramp + turn / (ramp * self.turn_acceleration) } else { 0.0 }
    }
}

/// Cubic between two knots along their headings; its length is nearly that of the chord.
fn hermite(a: &Knot, b: &Knot, length: f64, f: f64) -> Point2<f64> {
    let tangent = |k: &Knot| Vector2::new(k.heading.cos(), k.heading.sin()) * length;
    let (f2, f3) = (f * f, f * f * f);
    Point2::from(
        a.position.coords * (2.0 * f3 - 3.0 * f2 + 1.0)
            + tangent(a) * (f3 - 2.0 * f2 + f)
            + b.position.coords * (3.0 * f2 - 2.0 * f3)
            + tangent(b) * (f3 - f2),
    )
}

/// First and second derivative of [`hermite`] by `f`, metres.
fn hermite_derivatives(a: &Knot, b: &Knot, length: f64, f: f64) -> (Vector2<f64>, Vector2<f64>) {
    let tangent = |k: &Knot| Vector2::new(k.heading.cos(), k.heading.sin()) * length;
    let (chord, f2) = (b.position - a.position, f * f);
    let slope =
        chord * (6.0 * f - 6.0 * f2) + tangent(a) * (3.0 * f2 - 4.0 * f + 1.0) + tangent(b) * (3.0 * f2 - 2.0 * f);
    let bend = chord * (6.0 - 12.0 * f) + tangent(a) * (6.0 * f - 4.0) + tangent(b) * (6.0 * f - 2.0);
    (slope, bend)
}

/// Direction of travel at each point of a closed line and, last, at the first point again; continuous.
fn headings(points: &[Point2<f64>]) -> Vec<f64> {
    let n = points.len();
    let mut out: Vec<f64> = Vec::with_capacity(n + 1);
    for i in 0..=n {
        let d = points[(i + 1) % n] - points[(i + n - 1) % n];
        let raw = d.y.atan2(d.x);
        out.push(out.last().map_or(raw, |last| last + se3::wrap_angle(raw - last)));
    }
    out
}

/// Speed at each point: within the limits of turning, standing at the ends of the lap and at `stops`,
/// and reachable with the acceleration (a pass forwards, then one backwards).
fn speeds(params: &RobotParams, heading: &[f64], step: impl Fn(usize) -> f64, stops: &[usize]) -> Vec<f64> {
    let n = heading.len() - 1;
    let curvature = |i: usize| (heading[i + 1] - heading[i]) / step(i);
    let mut speed: Vec<f64> = (0..=n)
        .map(|i| {
            if i == 0 || i == n || stops.binary_search(&i).is_ok() {
                return 0.0;
            }
            let (before, after) = (curvature(i - 1), curvature(i.min(n - 1)));
            let turning = params.turn_rate_rad_per_s / before.abs().max(after.abs()).max(1e-9);
            // d(rate)/dt = v^2 d(curvature)/ds while the speed is constant.
            let change = (after - before).abs() / step(i.min(n - 1));
            let swinging = (params.turn_acceleration_rad_per_s2 / change.max(1e-9)).sqrt();
            params.speed_m_per_s.min(turning).min(swinging).max(0.02)
        })
        .collect();
    let reach = |v: f64, i: usize| (v * v + 2.0 * params.acceleration_m_per_s2 * step(i)).sqrt();
    for i in 0..n {
        speed[i + 1] = speed[i + 1].min(reach(speed[i], i));
    }
    for i in (0..n).rev() {
        speed[i] = speed[i].min(reach(speed[i + 1], i));
    }
    speed
}
