//! An inertial sensor over the robot's turning axis: exact motion, gravity, noise, and biases that wander.

use super::{Scene, check_rate, mount};
use crate::rng::{Purpose, stream};
use crate::{SimError, check};
use nalgebra::Vector3;
use percept_geometry::sensor::ImuSample;
use percept_geometry::{Pose, SensorData};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// Standard gravity rounded as is usual in robotics, metres a second squared.
const GRAVITY: f64 = 9.81;
const HEIGHT_M: f64 = 0.2;

/// An inertial sensor and its faults.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImuParams {
    /// Samples a second.
    pub rate_hz: f64,
    /// Standard deviation of a sample of angular velocity, rad/s.
    pub gyro_noise_rad_per_s: f64,
    /// Standard deviation of the error of angular velocity with which the session begins, rad/s.
    pub gyro_bias_rad_per_s: f64,
    /// How far that error wanders in a second, rad/s / sqrt(s).
    pub gyro_walk_rad_per_s: f64,
    /// Standard deviation of a sample of specific force, m/s^2.
    pub accel_noise_m_per_s2: f64,
    /// Standard deviation of the error of specific force with which the session begins, m/s^2.
    pub accel_bias_m_per_s2: f64,
    /// How far that error wanders in a second, m/s^2 / sqrt(s).
    pub accel_walk_m_per_s2: f64,
}

impl Default for ImuParams {
    /// A small sensor of the kind that phones, drones and lidars have; its walks are those of the ADIS16448 in Burri et
    /// al., "The EuRoC micro aerial vehicle datasets", 2016, rounded.
    fn default() -> Self {
        Self {
            rate_hz: 100.0,
            gyro_noise_rad_per_s: 0.003,
            gyro_bias_rad_per_s: 0.003,
            gyro_walk_rad_per_s: 2e-5,
            accel_noise_m_per_s2: 0.03,
            accel_bias_m_per_s2: 0.03,
            accel_walk_m_per_s2: 3e-3,
        }
    }
}

impl ImuParams {
    /// Checks bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        check_rate(self.rate_hz)?;
        check("gyro_noise_rad_per_s", self.gyro_noise_rad_per_s, 0.0, 1.0, "between 0 and 1")?;
        check("gyro_bias_rad_per_s", self.gyro_bias_rad_per_s, 0.0, 1.0, "between 0 and 1")?;
        check("accel_noise_m_per_s2", self.accel_noise_m_per_s2, 0.0, 10.0, "between 0 and 10")?;
        check("accel_bias_m_per_s2", self.accel_bias_m_per_s2, 0.0, 10.0, "between 0 and 10")?;
        check("gyro_walk_rad_per_s", self.gyro_walk_rad_per_s, 0.0, 0.1, "between 0 and 0.1")?;
        check("accel_walk_m_per_s2", self.accel_walk_m_per_s2, 0.0, 1.0, "between 0 and 1")
    }
}

/// Sensor to base.
pub(crate) fn t_base_sensor() -> Pose {
    mount(0.0, HEIGHT_M, 0.0, 0.0)
}

/// The sensor with the errors that this one has.
#[derive(Debug, Clone)]
pub(crate) struct Imu {
    params: ImuParams,
    gyro_bias: Vector3<f64>,
    accel_bias: Vector3<f64>,
}

impl Imu {
    pub(crate) fn new(params: ImuParams, seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::Imu, u64::MAX, 0);
        let gyro_bias = gauss(&mut rng) * params.gyro_bias_rad_per_s;
        let accel_bias = gauss(&mut rng) * params.accel_bias_m_per_s2;
        Self { params, gyro_bias, accel_bias }
    }

    /// The sample number `frame` at `t_s`; samples have to be taken in order.
    pub(crate) fn sample(&mut self, scene: &Scene<'_>, frame: u64, t_s: f64) -> SensorData {
        let (turning, acceleration) = scene.drive.inertial_at(t_s, &t_base_sensor());
        let up = scene.drive.pose_at(t_s).rotation.inverse() * Vector3::z();
        let mut rng = stream(scene.seed, Purpose::Imu, frame, 0);
        let force = acceleration + up * GRAVITY;
        let sample = ImuSample {
            angular_velocity: turning + self.gyro_bias + gauss(&mut rng) * self.params.gyro_noise_rad_per_s,
            linear_acceleration: force + self.accel_bias + gauss(&mut rng) * self.params.accel_noise_m_per_s2,
        };
        let step = (1.0 / self.params.rate_hz).sqrt();
        self.gyro_bias += gauss(&mut rng) * (self.params.gyro_walk_rad_per_s * step);
        self.accel_bias += gauss(&mut rng) * (self.params.accel_walk_m_per_s2 * step);
        SensorData::Imu(sample)
    }
}

fn gauss(rng: &mut impl Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| StandardNormal.sample(rng))
}
