//! Second sensors that see: lidars and depth cameras beside the one that moves the pose.
//!
//! Each is registered by an odometry of its own. Where its odom lies in that of the pose sensor is measured whenever both have placed
//! base at one time. So it tells where base is: that is a prior of the pose sensor's next frame, it places its own keyframes, and it
//! leads while the pose sensor is silent or sees nothing. Its word counts only while its motion is that of the pose sensor.
//! Start with [`SecondSensors::register`] and [`SecondSensors::lead`].

mod agreement;
mod fusion;
mod sensor;
mod track;

pub(super) use fusion::fused;

use percept_geometry::{Covariance6, KeyframeScan, Pose, SensorId, Timestamp, se3};
use percept_slam::{MotionPrior, OdometryEstimate, OdometryKind, OdometryNoise, OdometryParams, Scan};
use sensor::{SecondSensor, Word};
use std::collections::BTreeMap;
use track::{Placed, Track};

/// A pose of either sensor says for so long where base is, seconds.
const REACH_S: f64 = 0.5;
/// The pose sensor is silent after so long at least, seconds, and after so many times as long as usual.
const SILENT: (f64, f64) = (0.3, 2.5);
/// Variance of height and tilt for a sensor that supposes a plane, m^2 and rad^2.
const FLAT: f64 = 1e-6;
/// A time without the pose sensor counts up to this for what is usual, seconds, and the weight of the newest in that.
const USUAL: (f64, f64) = (1.0, 0.1);

/// Where base is by a second sensor.
#[derive(Debug, Clone)]
pub(super) struct Led {
    pub(super) sensor: SensorId,
    pub(super) t_odom_base: Pose,
    /// Of what it says, right perturbation in base; open along axes that it has not measured.
    pub(super) covariance: Covariance6,
    /// The same since the start, drift included.
    pub(super) covariance_since_start: Covariance6,
    /// Axes of base that it has not measured.
    pub(super) open: [bool; 6],
    /// Whether its motion has shown to be that of the pose sensor.
    pub(super) is_proven: bool,
}

impl Led {
    /// Whether it can stand in for the pose sensor: it has shown what it is worth, and measured all of the pose.
    pub(super) fn can_stand_in(&self) -> bool {
        self.is_proven && !self.open.contains(&true)
    }

    /// As a sensor takes it that supposes that the robot moves in a plane.
    pub(super) fn flattened(mut self) -> Self {
        let t = &self.t_odom_base;
        self.t_odom_base = se3::from_xy_yaw(t.translation.x, t.translation.y, se3::yaw(t));
        for k in 2..5 {
            self.open[k] = false;
            self.covariance[(k, k)] = FLAT;
        }
        self
    }
}

/// All that are registered, and what they are laid over.
#[derive(Default)]
pub(super) struct SecondSensors {
    sensors: BTreeMap<SensorId, SecondSensor>,
    /// By the pose sensor, and the noise of that one's odometry.
    ours: Track,
    noise: Option<OdometryNoise>,
    /// The newest frame of the pose sensor, whether it was placed or not, base to odom.
    newest: Option<(Timestamp, Pose)>,
    /// The newest one that was placed, and its covariance since the start.
    placed: Option<(Pose, Covariance6)>,
    /// Whether the newest was placed.
    is_placed: bool,
    /// Newest stamp of any second sensor.
    heard: Option<Timestamp>,
    /// How long the pose sensor usually is behind second sensors, seconds.
    usually_behind_s: f64,
}

impl SecondSensors {
    /// Places a frame of a second sensor. `measured`: what wheels and gyro say of the motion between two times.
    pub(super) fn register(
        &mut self,
        sensor: &SensorId,
        (stamp, scan): (Timestamp, &Scan),
        (kind, params): (OdometryKind, &OdometryParams),
        measured: impl Fn(Option<Timestamp>, Timestamp) -> Option<MotionPrior>,
    ) {
        let second = self.sensors.entry(sensor.clone()).or_insert_with(|| SecondSensor::new(kind, params.clone()));
        let last = second.newest().map(|e| e.stamp);
        let prior = last.and_then(|last| motion_of(&self.ours, last, stamp)).or_else(|| measured(last, stamp));
        second.register(stamp, scan, prior.as_ref());
        if let Some(noise) = &self.noise {
            second.compare(&self.ours, noise);
        }
        self.heard = self.heard.max(Some(stamp));
    }

    /// The pose sensor, of this kind, has placed a frame, or has not. `follows`: whether its pose follows on the one before.
    pub(super) fn follow(&mut self, kind: OdometryKind, estimate: &OdometryEstimate, follows: bool) {
        let noise = *self.noise.insert(OdometryNoise::of(kind));
        let (stamp, t_odom_base) = (estimate.stamp, estimate.t_odom_base);
        if let (Some(heard), Some((before, _))) = (self.heard, self.newest) {
            let behind_s = heard.seconds_since(before).clamp(0.0, USUAL.0);
            self.usually_behind_s += USUAL.1 * (behind_s - self.usually_behind_s);
        }
        self.newest = Some((stamp, t_odom_base));
        self.is_placed = estimate.state.is_tracking();
        if !estimate.state.is_lost() {
            self.placed = Some((t_odom_base, estimate.covariance));
        }
        if !follows || estimate.state.is_lost() {
            self.ours.clear();
        }
        if !follows {
            self.sensors.values_mut().for_each(SecondSensor::pose_jumped);
        }
        if !estimate.state.is_lost() {
            self.ours.push(Placed { stamp, t_odom_base, open: estimate.degenerate_axes });
            self.sensors.values_mut().for_each(|s| s.compare(&self.ours, &noise));
        }
    }

    /// The pose sensor goes on elsewhere.
    pub(super) fn pose_jumped(&mut self) {
        self.ours.clear();
        (self.newest, self.placed) = (None, None);
        self.sensors.values_mut().for_each(SecondSensor::pose_jumped);
    }

    /// Forgets a sensor: it is declared otherwise, or moves the pose from now on.
    pub(super) fn forget(&mut self, sensor: &SensorId) {
        self.sensors.remove(sensor);
    }

    /// Where base is at a time, by the second sensor that knows it best: it has placed base without an interruption since the pose
    /// sensor's newest frame. Where that left an axis open, or base, one that has shown nothing yet is better than none.
    pub(super) fn lead(&self, stamp: Timestamp) -> Option<Led> {
        let (from, _) = self.newest?;
        let (t_odom_placed, covariance) = self.placed?;
        let moved = |t: &Pose| {
            let t = t_odom_placed.inv_mul(t);
            t.translation.vector.norm() + t.rotation.angle()
        };
        let has_say = |s: &SecondSensor| s.is_believed() || (!s.is_doubted() && !self.is_pose_known());
        let covering = self.sensors.iter().filter(|(_, s)| has_say(s) && s.covers(from));
        let words = covering.filter_map(|(id, s)| Some((id, s, s.word(stamp, moved)?)));
        let num_open = |w: &Word| w.open.iter().filter(|open| **open).count();
        let rank = |s: &SecondSensor, w: &Word| (!s.is_believed(), num_open(w));
        let best = words.min_by(|(_, a, at_a), (_, b, at_b)| {
            rank(a, at_a).cmp(&rank(b, at_b)).then(a.difference2().total_cmp(&b.difference2()))
        });
        best.map(|(id, s, word)| Led {
            is_proven: s.is_believed(),
            sensor: id.clone(),
            t_odom_base: word.t_odom_base,
            covariance: word.covariance,
            covariance_since_start: se3::compose_covariance(
                &covariance,
                &t_odom_placed.inv_mul(&word.t_odom_base),
                &word.covariance,
            ),
            open: word.open,
        })
    }

    /// What a second sensor's pose says of the motion since the pose sensor's newest frame.
    pub(super) fn motion_to(&self, led: &Led) -> Option<MotionPrior> {
        let (_, t_odom_last) = self.newest?;
        // The pose sensor's next pose is the last one by this, and so on: what rounding makes of a rotation's length would double with
        // every frame.
        let t_prev_now = track::normalized(&t_odom_last.inv_mul(&led.t_odom_base));
        Some(MotionPrior { t_prev_now, covariance: led.covariance })
    }

    /// How far base moved between two times, and by how much it turned, by the pose sensor.
    pub(super) fn moved(&self, from: Timestamp, to: Timestamp) -> Option<(f64, f64)> {
        let at = |stamp| Some(self.ours.at_or_ahead(stamp, REACH_S)?.t_odom_base);
        let moved = at(from)?.inv_mul(&at(to)?);
        Some((moved.translation.vector.norm(), moved.rotation.angle()))
    }

    /// Whether the pose sensor has been silent at a time for longer than it usually is.
    pub(super) fn is_silent(&self, stamp: Timestamp) -> bool {
        let most = SILENT.0.max(SILENT.1 * self.usually_behind_s);
        self.newest.is_some_and(|(newest, _)| stamp.seconds_since(newest) > most)
    }

    /// Whether the pose sensor placed its newest frame, with no axis open.
    pub(super) fn is_pose_known(&self) -> bool {
        self.is_placed && self.ours.newest().is_some_and(|p| !p.open.contains(&true))
    }

    /// Where base is at a frame of a second sensor, base to odom: by its own motion, if that is to be believed, else by the pose
    /// sensor's. Its newest frame has that stamp.
    pub(super) fn place(&self, sensor: &SensorId, stamp: Timestamp) -> Option<Pose> {
        let ours = self.ours.at_or_ahead(stamp, REACH_S);
        let own = self.sensors.get(sensor).filter(|s| s.is_believed());
        own.and_then(|s| s.place(stamp, ours.as_ref())).or_else(|| Some(ours?.t_odom_base))
    }

    /// The odometry of a second sensor's newest frame.
    pub(super) fn newest(&self, sensor: &SensorId) -> Option<&OdometryEstimate> {
        self.sensors.get(sensor)?.newest()
    }

    /// What a keyframe keeps of the newest frame of a second sensor.
    pub(super) fn keyframe_scan(&self, sensor: &SensorId, stamp: Timestamp, scan: &Scan) -> Option<KeyframeScan> {
        Some(self.sensors.get(sensor)?.odometry().keyframe_scan(stamp, sensor, scan))
    }

    /// What their local models take in memory.
    pub(super) fn memory_bytes(&self) -> usize {
        self.sensors.values().map(|s| s.odometry().memory_bytes()).sum()
    }

    pub(super) fn set_keyframe_params(&mut self, params: &percept_slam::KeyframeParams) {
        self.sensors.values_mut().for_each(|s| s.odometry_mut().set_keyframe_params(params.clone()));
    }
}

/// The motion between two times by the pose sensor, if it has measured it.
fn motion_of(ours: &Track, from: Timestamp, to: Timestamp) -> Option<MotionPrior> {
    let (a, b) = (ours.at_or_ahead(from, REACH_S)?, ours.at_or_ahead(to, REACH_S)?);
    if track::either(&a.open, &b.open).contains(&true) {
        return None;
    }
    Some(fusion::extrapolated(a.t_odom_base.inv_mul(&b.t_odom_base), &b))
}
