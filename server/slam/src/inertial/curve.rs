//! How base moved while a sweep was taken, as the IMU felt it.

use super::buffer::{ImuBuffer, Reading};
use super::preintegration::{Gravity, NavState};
use nalgebra::{UnitQuaternion, Vector3};
use percept_geometry::{Pose, Timestamp};

/// Base around a stamp, seen from base at the stamp.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Curve {
    /// Seconds from the stamp, ascending, and base then.
    knots: Vec<(f64, Pose)>,
    /// Seconds of the sweep that no sample covers.
    pub(crate) uncovered_s: f64,
}

impl Curve {
    /// From `first` to `last` seconds after the stamp at which the body was in `state`; beyond the samples the motion goes on
    /// as it was. None where samples are missing or not to be trusted in between.
    pub(crate) fn of(
        imu: &ImuBuffer,
        stamp: Timestamp,
        (first, last): (f64, f64),
        state: &NavState,
        gravity: &Gravity,
    ) -> Option<Self> {
        let newest = imu.newest()?.seconds_since(stamp);
        let end = last.min(newest).max(0.0);
        let mut before = imu.sound_stretch(stamp.plus_seconds(first.min(0.0)), stamp)?;
        before.reverse();
        let after = imu.sound_stretch(stamp, stamp.plus_seconds(end))?;
        let lever = imu.p_base_imu();
        let mut knots = integrate(&before, stamp, state, gravity);
        knots.reverse();
        knots.pop();
        knots.extend(integrate(&after, stamp, state, gravity));
        let (to_body, to_base) = (
            Pose::from_parts((-lever).into(), UnitQuaternion::identity()),
            Pose::from_parts(lever.into(), UnitQuaternion::identity()),
        );
        knots.iter_mut().for_each(|k| k.1 = to_base * k.1 * to_body);
        Some(Self { knots, uncovered_s: (last - end).max(0.0) })
    }

    /// Base so many seconds after the stamp, seen from base at the stamp.
    pub(crate) fn at(&self, t: f64) -> Pose {
        let n = self.knots.len();
        if n < 2 {
            return self.knots.first().map_or_else(Pose::identity, |k| k.1);
        }
        let after = self.knots.partition_point(|k| k.0 < t).clamp(1, n - 1);
        let ((ta, a), (tb, b)) = (&self.knots[after - 1], &self.knots[after]);
        let share = if tb > ta { (t - ta) / (tb - ta) } else { 0.0 };
        // Knots are milliseconds apart: straight between them, and on beyond the last.
        let p = a.translation.vector.lerp(&b.translation.vector, share);
        let turn = (a.rotation.inverse() * b.rotation).scaled_axis() * share;
        Pose::from_parts(p.into(), a.rotation * UnitQuaternion::from_scaled_axis(turn))
    }
}

/// The body at each reading, seen from the body at the stamp, with which the readings begin; time may run backwards.
fn integrate(readings: &[Reading], stamp: Timestamp, state: &NavState, gravity: &Gravity) -> Vec<(f64, Pose)> {
    let back = state.t_odom_body.rotation.inverse();
    let (g, mut v) = (back * gravity.0, back * state.velocity);
    let (mut r, mut p) = (UnitQuaternion::identity(), Vector3::zeros());
    let mut out = vec![(0.0, Pose::identity())];
    for pair in readings.windows(2) {
        let dt = pair[1].stamp.seconds_since(pair[0].stamp);
        let next = r * UnitQuaternion::from_scaled_axis(((pair[0].rate + pair[1].rate) * 0.5 - state.gyro_bias) * dt);
        let force = (r * (pair[0].force - state.accel_bias) + next * (pair[1].force - state.accel_bias)) * 0.5;
        p += v * dt + (force + g) * (0.5 * dt * dt);
        v += (force + g) * dt;
        r = next;
        if dt != 0.0 {
            out.push((pair[1].stamp.seconds_since(stamp), Pose::from_parts(p.into(), r)));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::sensor::ImuSample;

    #[test]
    fn a_hand_that_turns_back_within_a_sweep_is_followed_before_and_after_the_stamp() {
        let at = Timestamp::from_secs_f64;
        // Base turns to and fro about z while it is accelerated along x of odom; the IMU is 0.2 m ahead in it.
        let (amplitude, w, a) = (0.4, 9.0, 3.0);
        let angle = |t: f64| amplitude * (w * t).sin();
        let truth = |t: f64| {
            let r = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle(t));
            Pose::from_parts(Vector3::new(0.5 * t + 0.5 * a * t * t, 0.0, 0.0).into(), r)
        };
        let lever = Vector3::new(0.2, 0.0, 0.1);
        let mut imu = ImuBuffer::default();
        for i in 0..400 {
            let t = 0.005 * f64::from(i);
            let (rate, change) = (amplitude * w * (w * t).cos(), -amplitude * w * w * (w * t).sin());
            let inner = Vector3::z() * change;
            let turn = Vector3::z() * rate;
            let arm = inner.cross(&lever) + turn.cross(&turn.cross(&lever));
            let force = truth(t).rotation.inverse() * Vector3::new(a, 0.0, 9.81) + arm;
            let sample = ImuSample { angular_velocity: turn, linear_acceleration: force };
            imu.push(at(t), &sample, &Pose::from_parts(lever.into(), UnitQuaternion::identity()));
        }
        let stamp = 1.0;
        let body = |t: f64| truth(t) * Pose::from_parts(lever.into(), UnitQuaternion::identity());
        let velocity = (body(stamp + 1e-5).translation.vector - body(stamp - 1e-5).translation.vector) / 2e-5;
        let zero = Vector3::zeros();
        let state = NavState { t_odom_body: body(stamp), velocity, gyro_bias: zero, accel_bias: zero };
        let gravity = Gravity::along(&-Vector3::z());
        let curve = Curve::of(&imu, at(stamp), (-0.1, 0.1), &state, &gravity).unwrap();
        for k in -20..=20 {
            let t = 0.0049 * f64::from(k);
            let off = (truth(stamp).inverse() * truth(stamp + t)).inverse() * curve.at(t);
            assert!(off.translation.vector.norm() < 1e-3 && off.rotation.angle() < 1e-3, "{t}: {off}");
        }
        assert_eq!(curve.uncovered_s, 0.0);
        let late = Curve::of(&imu, at(1.95), (0.0, 0.1), &state, &gravity).unwrap();
        assert!((late.uncovered_s - 0.055).abs() < 1e-6, "{}", late.uncovered_s);
    }
}
