//! What goes wrong in a session, beside the faults that its sensors have at all times.

use crate::{SimError, check};
use serde::{Deserialize, Serialize};

/// The robot is lifted and put down elsewhere on its path; on the way no camera or lidar sends, and the wheels stand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kidnap {
    /// When it is lifted, seconds after the start.
    pub at_s: f64,
    /// How long it is carried, seconds.
    pub carried_s: f64,
    /// How much later on its path it would have come to where it is put down, seconds.
    pub ahead_s: f64,
}

/// The robot stands still.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pause {
    /// From the first stop after this time, seconds after the start.
    pub at_s: f64,
    /// For so long, seconds.
    pub lasts_s: f64,
}

/// Cameras and lidars send nothing while the robot drives on; wheels and IMU send.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Blackout {
    /// When it begins, seconds after the start.
    pub at_s: f64,
    /// For so long, seconds.
    pub lasts_s: f64,
}

/// The clock that stamps all messages is set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClockJump {
    /// When, seconds after the start.
    pub at_s: f64,
    /// By how much, seconds; negative is backwards.
    pub by_s: f64,
}

/// Everything that goes wrong. Rates, jitter and mounting errors are of cameras and lidars.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Disturbances {
    /// The robot is carried elsewhere.
    pub kidnaps: Vec<Kidnap>,
    /// The robot stands still.
    pub pauses: Vec<Pause>,
    /// Nothing is seen.
    pub blackouts: Vec<Blackout>,
    /// The clock is set.
    pub clock_jumps: Vec<ClockJump>,
    /// Share of messages that are lost, 0 to 1.
    pub drop_rate: f64,
    /// Share of messages that arrive after the next one of their sensor, 0 to 1.
    pub late_rate: f64,
    /// Standard deviation of stamps about the time of measurement, seconds, 0 to 1.
    pub stamp_jitter_s: f64,
    /// By how much the declared mount of every camera and lidar but the first is turned about z, radians.
    pub mount_yaw_error_rad: f64,
}

impl Disturbances {
    /// Checks bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        let time = |field, value| check(field, value, 0.0, 1e6, "between 0 and 1,000,000");
        for k in &self.kidnaps {
            time("at_s", k.at_s)?;
            time("carried_s", k.carried_s)?;
            time("ahead_s", k.ahead_s)?;
        }
        for (at_s, lasts_s) in self.pauses.iter().map(|p| (p.at_s, p.lasts_s)).chain(self.blackout_times()) {
            time("at_s", at_s)?;
            time("lasts_s", lasts_s)?;
        }
        for jump in &self.clock_jumps {
            time("at_s", jump.at_s)?;
            check("by_s", jump.by_s, -1e6, 1e6, "between -1,000,000 and 1,000,000")?;
        }
        check("drop_rate", self.drop_rate, 0.0, 1.0, "between 0 and 1")?;
        check("late_rate", self.late_rate, 0.0, 1.0, "between 0 and 1")?;
        check("stamp_jitter_s", self.stamp_jitter_s, 0.0, 1.0, "between 0 and 1")?;
        check("mount_yaw_error_rad", self.mount_yaw_error_rad, -3.2, 3.2, "between -3.2 and 3.2")
    }

    /// When cameras and lidars are silent, kidnaps included: beginning and length, seconds.
    fn blackout_times(&self) -> impl Iterator<Item = (f64, f64)> {
        let carried = self.kidnaps.iter().map(|k| (k.at_s, k.carried_s));
        self.blackouts.iter().map(|b| (b.at_s, b.lasts_s)).chain(carried)
    }

    /// Whether cameras and lidars are silent at `t_s`.
    pub(crate) fn is_dark(&self, t_s: f64) -> bool {
        self.blackout_times().any(|(at_s, lasts_s)| t_s >= at_s && t_s < at_s + lasts_s)
    }

    /// What the clock is ahead at `t_s`, seconds.
    pub(crate) fn clock_offset_s(&self, t_s: f64) -> f64 {
        self.clock_jumps.iter().filter(|j| t_s >= j.at_s).map(|j| j.by_s).sum()
    }
}
