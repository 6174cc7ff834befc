//! Whether frames follow their stamps or come at an even pace that their stamps only jitter around.
//!
//! Logs exist whose stamps say when a frame was written, not when it was taken: bursts of frames a millisecond apart,
//! then none for a second. A prediction of constant velocity by such stamps is worse than one by counting frames. Both
//! are made for every frame that is placed, and the one that was nearer lately is believed.

use nalgebra::Vector6;
use percept_geometry::{Pose, se3};

/// Weight of the newest frame in running means. A mean over the last twenty: two seconds at 10 Hz.
const NEWEST: f64 = 0.05;
/// The even pace has to be so much better before it is believed. Times 0.7 and 1.4 as it is on the log with wheels
/// ([`crate::loops::planar`]).
const BETTER: f64 = 0.7;
/// Time constant of the velocities, seconds. As of planar lidars' velocities (`MotionLimits`), whose logs have such
/// stamps.
const SMOOTHING_S: f64 = 0.2;
/// A pause longer than this is one, whatever the pace, seconds. Halved and doubled as it is on the log with wheels
/// ([`crate::loops::planar`]).
const PAUSE_S: f64 = 5.0;

/// A velocity by one notion of time, and how far its predictions are off (metres, with a radian for half a metre).
#[derive(Debug, Clone, Default)]
struct Notion {
    velocity: Vector6<f64>,
    error: f64,
}

impl Notion {
    fn observe(&mut self, dt: f64, step: &Vector6<f64>) {
        let off = step - self.velocity * dt;
        let error = off.fixed_rows::<3>(0).norm() + 0.5 * off.fixed_rows::<3>(3).norm();
        self.error += NEWEST * (error - self.error);
        let now = step / dt.max(1e-4);
        self.velocity += (now - self.velocity) * (dt / (dt + SMOOTHING_S));
    }
}

/// The pace of a sensor's frames.
#[derive(Debug, Clone, Default)]
pub(crate) struct Rhythm {
    /// Running mean of the time between frames, seconds.
    interval: f64,
    stamped: Notion,
    even: Notion,
}

impl Rhythm {
    /// Notes the time since the frame before.
    pub(crate) fn tick(&mut self, dt: f64) {
        let dt = dt.min(PAUSE_S);
        self.interval = if self.interval == 0.0 { dt } else { self.interval + NEWEST * (dt - self.interval) };
    }

    /// Notes how base moved between two placed frames `dt` apart by their stamps.
    pub(crate) fn observe(&mut self, dt: f64, t_last_now: &Pose) {
        if dt > PAUSE_S {
            return;
        }
        let step = se3::log(t_last_now);
        self.stamped.observe(dt, &step);
        self.even.observe(self.interval, &step);
    }

    /// Whether stamps say less about the motion than the count of frames.
    pub(crate) fn is_even(&self) -> bool {
        self.even.error < BETTER * self.stamped.error
    }

    /// The time that passed since the frame before, by whichever notion is believed.
    pub(crate) fn elapsed(&self, dt: f64) -> f64 {
        if self.is_even() && dt <= PAUSE_S { self.interval } else { dt }
    }

    /// How far predictions are off, metres, as far as stamps are not what is believed.
    pub(crate) fn error(&self) -> f64 {
        if self.is_even() { self.even.error } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jittering_stamps_are_not_believed_and_dropped_frames_are() {
        let (mut jittering, mut dropping) = (Rhythm::default(), Rhythm::default());
        for i in 0..300 {
            // Bursts of five, then a second's pause; 0.1 m a frame.
            let dt = if i % 5 == 0 { 0.99 } else { 0.0025 };
            jittering.tick(dt);
            jittering.observe(dt, &se3::from_xy_yaw(0.1, 0.0, 0.0));
            // One or two frames lost in turn: the motion follows the stamps.
            let dt = if i % 2 == 0 { 0.1 } else { 0.3 };
            dropping.tick(dt);
            dropping.observe(dt, &se3::from_xy_yaw(dt, 0.0, 0.0));
        }
        assert!(jittering.is_even() && (jittering.elapsed(0.001) - 0.2).abs() < 0.1);
        assert!(!dropping.is_even() && dropping.elapsed(0.3) == 0.3);
    }
}
