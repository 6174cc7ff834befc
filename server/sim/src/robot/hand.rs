//! A sensor head carried by hand: it sways with the steps, tilts, and is swung from side to side.

use super::jet::Jet;
use super::motion::Motion;
use crate::{SimError, check};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use percept_geometry::Pose;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Steps a second, and the swings of roll, pitch and yaw: without a common period.
const STEP_HZ: f64 = 1.8;
const TILT_HZ: [f64; 2] = [0.71, 0.93];
const SWING_HZ: f64 = 0.37;
/// The motion grows from nothing during this time, as sessions begin at rest, seconds.
const EASE_IN_S: f64 = 2.0;

/// How the head moves in the carrier's hand, who walks as the robot would drive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HandheldParams {
    /// Height of base over the floor, metres, 0 to 2.5.
    pub height_m: f64,
    /// How far it sways with every step, metres, 0 to 0.3.
    pub sway_m: f64,
    /// How far it rolls and pitches, radians, 0 to 1.
    pub tilt_rad: f64,
    /// How far it is swung to each side, radians, 0 to 3: 1 rad makes up to 2.3 rad/s.
    pub swing_rad: f64,
}

impl Default for HandheldParams {
    fn default() -> Self {
        Self { height_m: 0.6, sway_m: 0.03, tilt_rad: 0.2, swing_rad: 0.8 }
    }
}

impl HandheldParams {
    /// Checks bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        check("height_m", self.height_m, 0.0, 2.5, "between 0 and 2.5")?;
        check("sway_m", self.sway_m, 0.0, 0.3, "between 0 and 0.3")?;
        check("tilt_rad", self.tilt_rad, 0.0, 1.0, "between 0 and 1")?;
        check("swing_rad", self.swing_rad, 0.0, 3.0, "between 0 and 3")
    }

    /// Head to the place on the floor where the carrier walks, `t_s` seconds after the start.
    pub(crate) fn t_walker_base(&self, t_s: f64) -> Pose {
        let (sway, [roll, pitch, yaw]) = self.waves(t_s);
        let rotation = UnitQuaternion::from_euler_angles(roll.value, pitch.value, yaw.value);
        Pose::from_parts(Translation3::from(sway.map(|s| s.value)), rotation)
    }

    /// How the head moves there: turn rate and its change in the head's axes, velocity and acceleration in the walker's.
    pub(crate) fn motion_in_walker(&self, t_s: f64) -> Motion {
        let (sway, [roll, pitch, yaw]) = self.waves(t_s);
        // Rates of roll, pitch and yaw (turned about z first) in the axes of the head.
        let (d_roll, d_pitch, d_yaw) = (roll.derivative(), pitch.derivative(), yaw.derivative());
        let turning = [
            d_roll - d_yaw * pitch.sin(),
            d_pitch * roll.cos() + d_yaw * roll.sin() * pitch.cos(),
            d_yaw * roll.cos() * pitch.cos() - d_pitch * roll.sin(),
        ];
        let [x, y, z] = turning;
        Motion {
            turn_rate: Vector3::new(x.value, y.value, z.value),
            turn_acceleration: Vector3::new(x.rate, y.rate, z.rate),
            velocity: sway.map(|s| s.rate),
            acceleration: sway.map(|s| s.bend),
        }
    }

    /// Where the head is on the walker's axes, metres, and its roll, pitch and yaw.
    fn waves(&self, t_s: f64) -> (Vector3<Jet>, [Jet; 3]) {
        let t = Jet::time(t_s);
        // Third derivative and below are continuous: inertial sensors see no jumps.
        let ease = (t * (1.0 / EASE_IN_S)).eased();
        let wave = |hz: f64, phase: f64| ease * (t * (TAU * hz) + Jet::constant(phase)).sin();
        let sway = Vector3::new(
            wave(STEP_HZ, 0.5) * (0.3 * self.sway_m),
            wave(0.5 * STEP_HZ, 0.0) * self.sway_m,
            wave(STEP_HZ, 1.0) * self.sway_m + Jet::constant(self.height_m),
        );
        let angles = [
            wave(TILT_HZ[0], 0.3) * self.tilt_rad,
            wave(TILT_HZ[1], 1.7) * self.tilt_rad,
            wave(SWING_HZ, 0.0) * self.swing_rad,
        ];
        (sway, angles)
    }
}
