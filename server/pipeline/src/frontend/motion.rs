//! What measures the robot's motion beside the sensor that moves the pose: wheels and IMUs, and how far their clocks are off.

use super::clock_offset::ClockOffsets;
use super::imu_prior::joined;
use super::odometry_prior::OdometryBuffer;
use nalgebra::{Unit, UnitQuaternion, Vector3};
use percept_geometry::{SensorData, SensorId, SensorSpec, Timestamp};
use percept_slam::{ImuBuffer, MotionPrior};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Offsets of an IMU's clock below this are what finding them is good to, seconds.
const CLOCK_IS_OFF_S: f64 = 0.01;

/// Samples of wheels and IMUs. Of several the first by name that covers a stretch is believed.
#[derive(Default)]
pub(super) struct MotionSensors {
    wheels: BTreeMap<SensorId, OdometryBuffer>,
    imus: BTreeMap<SensorId, ImuBuffer>,
    clocks: ClockOffsets,
    clock_offsets: Arc<BTreeMap<SensorId, f64>>,
}

/// What is known of the motion between two frames.
pub(super) struct Prior<'a> {
    pub(super) motion: Option<MotionPrior>,
    /// Whether wheels say something of it.
    pub(super) has_wheels: bool,
    /// The first by name that covers it, or the first.
    pub(super) imu: Option<&'a ImuBuffer>,
}

impl MotionSensors {
    /// Keeps a sample; takes no notice of what sensors of other kinds send.
    pub(super) fn take(&mut self, spec: &SensorSpec, stamp: Timestamp, data: &SensorData) {
        match data {
            SensorData::Odometry(sample) => {
                if let Some((before, angle)) = self.wheels.entry(spec.id.clone()).or_default().push(stamp, sample) {
                    let dt = stamp.seconds_since(before);
                    self.clocks.saw(&spec.id, before.plus_seconds(0.5 * dt), angle / dt);
                }
            }
            SensorData::Imu(sample) => {
                // Where its clock was found to be off, its samples are taken for when they were felt.
                let late = self.clock_offsets.get(&spec.id).copied().filter(|late| late.abs() > CLOCK_IS_OFF_S);
                let felt = stamp.plus_seconds(-late.unwrap_or(0.0));
                self.imus.entry(spec.id.clone()).or_default().push(felt, sample, &spec.t_base_sensor);
                self.clocks.saw(&spec.id, stamp, sample.angular_velocity.norm());
            }
            _ => {}
        }
    }

    /// Drops what waits of a sensor, and what is known of its clock.
    pub(super) fn forget(&mut self, sensor: &SensorId) {
        self.wheels.remove(sensor);
        self.imus.remove(sensor);
        self.clocks.forget(sensor);
        self.clock_offsets = Arc::new(self.clocks.found().clone());
    }

    /// What wheels and IMUs say of the motion from one frame, if there was one before, to another.
    pub(super) fn prior(&self, from: Option<Timestamp>, to: Timestamp) -> Prior<'_> {
        let wheels = from.and_then(|from| self.wheels.values().find_map(|w| w.between(from, to)));
        let felt = from.and_then(|from| self.imus.values().find_map(|i| Some((i, i.between(from, to)?))));
        let imu = felt.as_ref().map(|(imu, _)| *imu).or_else(|| self.imus.values().next());
        Prior { has_wheels: wheels.is_some(), motion: joined(wheels, felt.map(|(_, turn)| turn)), imu }
    }

    /// A turn that was measured otherwise tells a gyro's bias, and how far clocks are off.
    pub(super) fn learn(&mut self, from: Timestamp, to: Timestamp, turn: &UnitQuaternion<f64>) {
        self.imus.values_mut().for_each(|i| i.learn(from, to, turn));
        if self.clocks.turned(from, to, turn.angle()) {
            self.clock_offsets = Arc::new(self.clocks.found().clone());
        }
    }

    /// The direction against gravity in base, if an IMU was at rest just before a stamp.
    pub(super) fn up(&self, stamp: Timestamp) -> Option<Unit<Vector3<f64>>> {
        self.imus.values().find_map(|i| i.up(stamp))
    }

    /// Seconds by which sensors' stamps are late behind the pose sensor's, as far as that is known.
    pub(super) fn clock_offsets(&self) -> Arc<BTreeMap<SensorId, f64>> {
        Arc::clone(&self.clock_offsets)
    }
}
