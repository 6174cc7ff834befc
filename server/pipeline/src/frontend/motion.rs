//! What measures the robot's motion beside the sensor that moves the pose: wheels and IMUs, and how far their clocks are off.

use super::clock_offset::ClockOffsets;
use super::imu_prior::joined;
use super::odometry_prior::OdometryBuffer;
use super::second::fused;
use super::wheels_check::{WheelsCheck, WheelsFault};
use nalgebra::{Unit, Vector3};
use percept_geometry::{Pose, SensorData, SensorId, SensorSpec, Timestamp};
use percept_slam::{ImuBuffer, ImuFault, MotionPrior};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Offsets of an IMU's clock below this are what finding them is good to, seconds.
const CLOCK_IS_OFF_S: f64 = 0.01;

/// An IMU that has sent nothing for so long gives way to another one, seconds.
const SILENT_S: f64 = 1.0;
/// Frames between two looks at what is wrong with IMUs.
const LOOK_EVERY: u32 = 10;

/// Samples of wheels and IMUs. Of several wheels the first by name that covers a stretch is believed; of several IMUs one is
/// used until it falls silent, or something is wrong with it and not with another one.
#[derive(Default)]
pub(super) struct MotionSensors {
    wheels: BTreeMap<SensorId, OdometryBuffer>,
    wheels_checks: BTreeMap<SensorId, WheelsCheck>,
    wheels_faults: Arc<BTreeMap<SensorId, Vec<WheelsFault>>>,
    imus: BTreeMap<SensorId, ImuBuffer>,
    used_imu: Option<SensorId>,
    imu_faults: Arc<BTreeMap<SensorId, Vec<ImuFault>>>,
    num_learned: u32,
    clocks: ClockOffsets,
    clock_offsets: Arc<BTreeMap<SensorId, f64>>,
}

/// What is known of the motion between two frames.
pub(super) struct Prior<'a> {
    pub(super) motion: Option<MotionPrior>,
    /// What wheels say of it.
    pub(super) wheels: Option<ByWheels>,
    /// The one in use.
    pub(super) imu: Option<&'a ImuBuffer>,
}

/// What wheels say of a motion.
pub(super) struct ByWheels {
    pub(super) t_prev_now: Pose,
    /// Whether enough was driven to say that they tell it well.
    pub(super) are_proven: bool,
    /// Whether they have contradicted what was measured.
    pub(super) are_blamed: bool,
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
        self.wheels_checks.remove(sensor);
        if self.wheels_faults.contains_key(sensor) {
            Arc::make_mut(&mut self.wheels_faults).remove(sensor);
        }
        self.imus.remove(sensor);
        if self.imu_faults.contains_key(sensor) {
            Arc::make_mut(&mut self.imu_faults).remove(sensor);
        }
        self.clocks.forget(sensor);
        self.clock_offsets = Arc::new(self.clocks.found().clone());
    }

    /// Chooses the IMU for a frame; whether that is another one than before.
    pub(super) fn choose_imu(&mut self, stamp: Timestamp) -> bool {
        let rank = |(id, imu): &(&SensorId, &ImuBuffer)| {
            let is_silent = imu.newest().is_none_or(|newest| stamp.seconds_since(newest) > SILENT_S);
            let num_faults = self.imu_faults.get(*id).map_or(0, Vec::len);
            (is_silent, imu.spoils_turns(), !imu.has_proven_turns(), num_faults, self.used_imu.as_ref() != Some(id))
        };
        let best = self.imus.iter().min_by_key(rank).map(|(id, _)| id);
        if best == self.used_imu.as_ref() {
            return false;
        }
        let was_used = self.used_imu.is_some();
        self.used_imu = best.cloned();
        was_used
    }

    /// What wheels, a second sensor and the chosen IMU say of the motion from one frame, if there was one before, to another.
    pub(super) fn prior(&self, from: Option<Timestamp>, to: Timestamp, second: Option<MotionPrior>) -> Prior<'_> {
        let wheels = from.and_then(|from| self.wheels.iter().find_map(|(id, w)| Some((id, w.between(from, to)?))));
        let told = wheels.as_ref().map(|(id, told)| {
            let check = self.wheels_checks.get(id);
            ByWheels {
                t_prev_now: told.t_prev_now,
                are_proven: check.is_some_and(WheelsCheck::is_proven),
                are_blamed: check.is_some_and(|check| !check.faults().is_empty()),
            }
        });
        let wheels = wheels.map(|(_, told)| told);
        let imu = self.used_imu.as_ref().and_then(|id| self.imus.get(id));
        // Where others tell the turn, too, nothing is lost by waiting until the gyro has shown to be right.
        let is_told = wheels.is_some() || second.is_some();
        let is_welcome = |i: &&ImuBuffer| if is_told { i.has_proven_turns() } else { !i.spoils_turns() };
        let turn = imu.filter(is_welcome).zip(from).and_then(|(i, from)| i.between(from, to));
        let motion = if second.is_some() { fused(turn, fused(wheels, second)) } else { joined(wheels, turn) };
        Prior { wheels: told, motion, imu }
    }

    /// A motion that was measured otherwise tells a gyro's bias, what is wrong with it and with wheels, and how far clocks are
    /// off. `is_planar`: it turned about base's z alone; `is_metric`: it is in metres. `num_unbelieved`: for how many frames in
    /// a row the IMU in use was of no use.
    pub(super) fn learn(
        &mut self,
        (from, to): (Timestamp, Timestamp),
        motion: &Pose,
        (is_planar, is_metric): (bool, bool),
        num_unbelieved: u32,
    ) {
        let turn = &motion.rotation;
        self.imus.values_mut().for_each(|i| i.learn(from, to, turn, is_planar));
        for (id, wheels) in &self.wheels {
            let check = self.wheels_checks.entry(id.clone()).or_default();
            // A pose in a unit of its own says nothing of metres, also once its unit is known.
            match wheels.between(from, to).filter(|_| is_metric) {
                Some(told) => check.add(&told.t_prev_now, motion),
                None => check.interrupt(),
            }
        }
        if let Some(imu) = self.used_imu.as_ref().and_then(|id| self.imus.get_mut(id)) {
            imu.note_unbelieved(num_unbelieved);
        }
        self.num_learned = self.num_learned.wrapping_add(1);
        if self.num_learned.is_multiple_of(LOOK_EVERY) && !self.imus.is_empty() {
            let faults = self.imus.iter().map(|(id, imu)| (id.clone(), imu.faults()));
            self.imu_faults = Arc::new(faults.filter(|(_, faults)| !faults.is_empty()).collect());
        }
        if self.num_learned.is_multiple_of(LOOK_EVERY) && !self.wheels_checks.is_empty() {
            let faults = self.wheels_checks.iter().map(|(id, check)| (id.clone(), check.faults()));
            self.wheels_faults = Arc::new(faults.filter(|(_, faults)| !faults.is_empty()).collect());
        }
        if self.clocks.turned(from, to, turn.angle()) {
            self.clock_offsets = Arc::new(self.clocks.found().clone());
        }
    }

    /// The direction against gravity in base, if an IMU was at rest just before a stamp.
    pub(super) fn up(&self, stamp: Timestamp) -> Option<Unit<Vector3<f64>>> {
        let used = self.used_imu.as_ref().and_then(|id| self.imus.get(id));
        used.into_iter().chain(self.imus.values()).find_map(|i| i.up(stamp))
    }

    /// A frame was not placed: what wheels tell cannot be compared over it.
    pub(super) fn was_lost(&mut self) {
        self.wheels_checks.values_mut().for_each(WheelsCheck::interrupt);
    }

    /// How wheels contradict the pose sensor, as far as that is known.
    pub(super) fn wheels_faults(&self) -> Arc<BTreeMap<SensorId, Vec<WheelsFault>>> {
        Arc::clone(&self.wheels_faults)
    }

    /// What is wrong with IMUs, as far as that is known.
    pub(super) fn imu_faults(&self) -> Arc<BTreeMap<SensorId, Vec<ImuFault>>> {
        Arc::clone(&self.imu_faults)
    }

    /// Seconds by which sensors' stamps are late behind the pose sensor's, as far as that is known.
    pub(super) fn clock_offsets(&self) -> Arc<BTreeMap<SensorId, f64>> {
        Arc::clone(&self.clock_offsets)
    }
}
