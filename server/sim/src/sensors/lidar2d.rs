//! A planar lidar.

use super::{Scene, check_rate, check_share, mount};
use crate::rng::{Purpose, stream};
use crate::{SimError, check};
use nalgebra::{Point3, Vector3};
use percept_geometry::{LaserScan, Pose, SensorData};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A planar lidar and its faults.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Lidar2dParams {
    /// Scans a second.
    pub rate_hz: f64,
    /// Beams a scan, 2 to 8192.
    pub beams: usize,
    /// Angle seen, centred ahead, radians, 0.1 to one turn.
    pub fov_rad: f64,
    /// Nearest range measured, metres.
    pub range_min_m: f64,
    /// Farthest range measured, metres; beyond it a beam reads +inf.
    pub range_max_m: f64,
    /// Standard deviation of range, metres.
    pub range_noise_m: f64,
    /// Share of beams that read NaN for no reason.
    pub dropout_rate: f64,
    /// Whether beams are taken one after the other within the period while the robot moves on, with
    /// `time_increment_s` saying so; otherwise all at the stamp.
    pub motion_distortion: bool,
    /// Height over the floor, metres, 0.05 to 2.5.
    pub height_m: f64,
    /// How far from the robot's middle it sits, in the direction in which it looks, metres, -0.5 to 0.5.
    pub forward_m: f64,
    /// Where it looks, radians from ahead to the left, -3.2 to 3.2.
    pub yaw_rad: f64,
}

impl Default for Lidar2dParams {
    fn default() -> Self {
        Self {
            rate_hz: 10.0,
            beams: 360,
            fov_rad: TAU,
            range_min_m: 0.1,
            range_max_m: 12.0,
            range_noise_m: 0.01,
            dropout_rate: 0.005,
            motion_distortion: false,
            height_m: 0.3,
            forward_m: 0.0,
            yaw_rad: 0.0,
        }
    }
}

impl Lidar2dParams {
    /// Sensor to base.
    pub fn t_base_sensor(&self) -> Pose {
        mount(self.forward_m, self.height_m, 0.0, self.yaw_rad)
    }

    /// Checks bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        check_rate(self.rate_hz)?;
        check("beams", self.beams as f64, 2.0, 8192.0, "between 2 and 8192")?;
        check("fov_rad", self.fov_rad, 0.1, TAU, "between 0.1 and one turn")?;
        check("range_min_m", self.range_min_m, 0.0, 100.0, "between 0 and 100")?;
        check("range_max_m", self.range_max_m, self.range_min_m, 1000.0, "between range_min_m and 1000")?;
        check("range_noise_m", self.range_noise_m, 0.0, 1.0, "between 0 and 1")?;
        check_share("dropout_rate", self.dropout_rate)?;
        check("height_m", self.height_m, 0.05, 2.5, "between 0.05 and 2.5")?;
        check("forward_m", self.forward_m, -0.5, 0.5, "between -0.5 and 0.5")?;
        check("yaw_rad", self.yaw_rad, -3.2, 3.2, "between -3.2 and 3.2")
    }

    /// Seconds from the first beam to the last while it turns.
    pub(crate) fn sweep_s(&self) -> f64 {
        self.fov_rad / TAU / self.rate_hz
    }

    /// Angle between beams, radians: a full turn has no beam twice.
    pub fn angle_increment_rad(&self) -> f64 {
        let full = self.fov_rad > TAU - 1e-6;
        self.fov_rad / if full { self.beams as f64 } else { (self.beams - 1) as f64 }
    }
}

/// The scan number `frame` that begins at `t_s`.
pub(crate) fn scan(params: &Lidar2dParams, scene: &Scene<'_>, frame: u64, t_s: f64) -> SensorData {
    let increment = params.angle_increment_rad();
    let time_increment = if params.motion_distortion { increment / TAU / params.rate_hz } else { 0.0 };
    let angle_min = -0.5 * params.fov_rad;
    let mut rng = stream(scene.seed, Purpose::Lidar2d, frame, 0);
    let mut view = scene.world.view(t_s);
    let mut t_world_sensor = scene.drive.pose_at(t_s) * params.t_base_sensor();
    let ranges_m = (0..params.beams)
        .map(|i| {
            if params.motion_distortion {
                let t = t_s + i as f64 * time_increment;
                view = scene.world.view(t);
                t_world_sensor = scene.drive.pose_at(t) * params.t_base_sensor();
            }
            let (sin, cos) = (angle_min + i as f64 * increment).sin_cos();
            let direction = t_world_sensor.rotation * Vector3::new(cos, sin, 0.0);
            let origin = Point3::from(t_world_sensor.translation.vector);
            let truth = view.cast(&origin, &direction, 2.0 * params.range_max_m + 1.0).map(|hit| hit.0);
            measure(params, truth, &mut rng)
        })
        .collect();
    SensorData::Scan(LaserScan {
        angle_min_rad: angle_min,
        angle_increment_rad: increment,
        range_min_m: params.range_min_m,
        range_max_m: params.range_max_m,
        time_increment_s: time_increment,
        ranges_m,
        intensities: None,
        later_echoes_m: vec![],
    })
}

fn measure(params: &Lidar2dParams, truth: Option<f64>, rng: &mut impl Rng) -> f32 {
    // Both are drawn for every beam, so that one beam's fate does not move the next one's noise.
    let lost = rng.random_range(0.0..1.0) < params.dropout_rate;
    let gauss: f64 = StandardNormal.sample(rng);
    let Some(truth) = truth else { return if lost { f32::NAN } else { f32::INFINITY } };
    let noisy = truth + params.range_noise_m * gauss;
    if lost || noisy < params.range_min_m {
        f32::NAN
    } else if noisy >= params.range_max_m {
        f32::INFINITY
    } else {
        noisy as f32
    }
}
