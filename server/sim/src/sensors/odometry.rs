//! Wheel odometry: motion added up with a wrong scale and noise, so that it drifts.

use super::{Scene, check_rate};
use crate::rng::{Purpose, stream};
use crate::{SimError, check};
use nalgebra::Vector6;
use percept_geometry::sensor::OdometrySample;
use percept_geometry::{Covariance6, Pose, SensorData, se3};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// What is known of directions in which wheels do not move, standard deviation a step, m and rad.
const OFF_PLANE_SIGMA: f64 = 1e-5;
/// Sideways slip against noise along the drive.
const SLIP_SHARE: f64 = 0.3;

/// Wheel odometry and its faults.
///
/// Source of the noise growing with the square root of motion: Thrun, Burgard, Fox, "Probabilistic
/// Robotics", 2005, section 5.4.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OdometryParams {
    /// Samples a second.
    pub rate_hz: f64,
    /// Standard deviation of the constant relative error of distance (wheel radius).
    pub distance_scale_sigma: f64,
    /// Standard deviation of the constant relative error of angle (wheel base).
    pub angle_scale_sigma: f64,
    /// Standard deviation of distance after one metre, m / sqrt(m).
    pub distance_noise: f64,
    /// Standard deviation of angle after one radian of turning, rad / sqrt(rad).
    pub angle_noise: f64,
    /// Standard deviation of angle after one metre, rad / sqrt(m).
    pub angle_noise_per_distance: f64,
}

impl Default for OdometryParams {
    fn default() -> Self {
        Self {
            rate_hz: 20.0,
            distance_scale_sigma: 0.01,
            angle_scale_sigma: 0.005,
            distance_noise: 0.01,
            angle_noise: 0.01,
            angle_noise_per_distance: 0.004,
        }
    }
}

impl OdometryParams {
    /// Checks bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        check_rate(self.rate_hz)?;
        check("distance_scale_sigma", self.distance_scale_sigma, 0.0, 0.2, "between 0 and 0.2")?;
        check("angle_scale_sigma", self.angle_scale_sigma, 0.0, 0.2, "between 0 and 0.2")?;
        check("distance_noise", self.distance_noise, 0.0, 1.0, "between 0 and 1")?;
        check("angle_noise", self.angle_noise, 0.0, 1.0, "between 0 and 1")?;
        check("angle_noise_per_distance", self.angle_noise_per_distance, 0.0, 1.0, "between 0 and 1")
    }
}

/// The state of the odometry: its own drifting pose and the time of the sample before.
#[derive(Debug, Clone)]
pub(crate) struct Wheels {
    params: OdometryParams,
    distance_scale: f64,
    angle_scale: f64,
    t_odom_base: Pose,
    last_s: Option<f64>,
}

impl Wheels {
    pub(crate) fn new(params: OdometryParams, seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::Odometry, u64::MAX, 0);
        let mut gauss = || -> f64 { StandardNormal.sample(&mut rng) };
        let distance_scale = 1.0 + params.distance_scale_sigma * gauss();
        let angle_scale = 1.0 + params.angle_scale_sigma * gauss();
        Self { params, distance_scale, angle_scale, t_odom_base: Pose::identity(), last_s: None }
    }

    /// The sample number `frame` at `t_s`; samples have to be taken in order.
    pub(crate) fn sample(&mut self, scene: &Scene<'_>, frame: u64, t_s: f64) -> SensorData {
        let step = self.last_s.map_or_else(Pose::identity, |last_s| scene.drive.driven(last_s, t_s));
        self.last_s = Some(t_s);
        let (distance, angle) = (step.translation.vector.norm(), se3::yaw(&step));
        let p = &self.params;
        let sigma_along = p.distance_noise * distance.sqrt();
        let sigma_slip = SLIP_SHARE * sigma_along;
        let sigma_turn = (p.angle_noise.powi(2) * angle.abs() + p.angle_noise_per_distance.powi(2) * distance).sqrt();
        let mut rng = stream(scene.seed, Purpose::Odometry, frame, 0);
        let mut gauss = || -> f64 { StandardNormal.sample(&mut rng) };
        let along = step.translation.vector * self.distance_scale;
        let measured = se3::from_xy_yaw(
            along.x + sigma_along * gauss(),
            along.y + sigma_slip * gauss(),
            angle * self.angle_scale + sigma_turn * gauss(),
        );
        self.t_odom_base *= measured;
        let floor = OFF_PLANE_SIGMA.powi(2);
        let variance = Vector6::new(
            floor + sigma_along.powi(2) + (p.distance_scale_sigma * distance).powi(2),
            floor + sigma_slip.powi(2),
            floor,
            floor,
            floor,
            floor + sigma_turn.powi(2) + (p.angle_scale_sigma * angle).powi(2),
        );
        SensorData::Odometry(OdometrySample {
            t_odom_base: self.t_odom_base,
            covariance: Some(Covariance6::from_diagonal(&variance)),
        })
    }
}
