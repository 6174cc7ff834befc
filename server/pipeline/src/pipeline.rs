//! One robot's state and the path of a frame through it.

mod loops;
mod merging;

pub use loops::VetoReport;

use crate::clock_offset::ClockOffsets;
use crate::imu_prior::{ImuBuffer, joined};
use crate::level::{by_gravity, level};
use crate::odometry_prior::OdometryBuffer;
use crate::recovery::Anchoring;
use crate::scale_hints::ScaleHints;
use crate::sensors::{Sensors, scan_of};
use crate::visibility::RangeImage;
use crate::{
    Chunks, FrameError, KeyframeInfo, Merged, ParamsError, PipelineParams, PoseEstimate, Snapshot, TrajectoryEntry,
};
use percept_geometry::{
    Correction, KeyframeId, KeyframeScan, Pose, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Timestamp,
    se3,
};
use percept_mapping::Map;
use percept_perception::detection::Detector;
use percept_scene::{Object, ObjectChange, Observation, Tracker, Visibility};
use percept_slam::{
    BackEnd, KeyframePolicy, Loop, LoopId, LostReason, Odometry, OdometryEstimate, OdometryKind, Scale, Scan,
    TrackingState, keyframe,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Objects this near to the edge of the searched part of the map may be cut by it, metres.
const SEARCH_EDGE_M: f64 = 1.5;

/// A keyframe this near says that the robot has been there, metres.
const MAPPED_M: f64 = 1.0;

/// Keyframes that odometry starts again from.
const NUM_RECENT: usize = 20;

/// What a frame did.
#[derive(Debug, Clone, Default)]
pub struct FrameReport {
    /// Pose after it; none for sensors that do not move the pose.
    pub pose: Option<PoseEstimate>,
    /// Set if the frame was added to the trajectory.
    pub trajectory: Option<TrajectoryEntry>,
    /// Set if it became a keyframe.
    pub keyframe: Option<NewKeyframe>,
    /// What it changed about objects.
    pub changes: Vec<ObjectChange>,
    /// Keyframes of a part of the map that joined it with this frame, older than `keyframe`.
    pub joined: Vec<NewKeyframe>,
    /// Loops that were found or changed their state.
    pub loops: Vec<Loop>,
    /// Keyframes that a correction moved, with their new poses, base to map.
    pub corrected: Vec<(KeyframeId, Pose)>,
    /// Keyframes that others stand for from now on, or through yet others than before.
    pub merged: Vec<(KeyframeInfo, Merged)>,
    /// Loops that went with them.
    pub dissolved: Vec<LoopId>,
}

/// A keyframe as it is stored.
#[derive(Debug, Clone)]
pub struct NewKeyframe {
    /// Number, stamp, sensor, pose in the map.
    pub info: KeyframeInfo,
    /// Base to odom at the keyframe.
    pub t_odom_base: Pose,
    /// What it saw.
    pub scan: Arc<KeyframeScan>,
}

/// A keyframe as it was stored.
#[derive(Debug, Clone)]
pub struct RestoredKeyframe {
    /// Base to map, corrected.
    pub t_map_base: Pose,
    /// Base to odom at the keyframe.
    pub t_odom_base: Pose,
    /// What it saw, or what stands for it.
    pub content: RestoredContent,
}

/// What is left of a stored keyframe.
#[derive(Debug, Clone)]
pub enum RestoredContent {
    /// All.
    Scan(Arc<KeyframeScan>),
    /// Where it was, and when.
    Merged {
        /// Stamp, session's clock.
        stamp: Timestamp,
        /// Sensor.
        sensor: SensorId,
        /// What stands for it.
        merged: Merged,
    },
}

impl RestoredKeyframe {
    fn scan(&self) -> Option<&Arc<KeyframeScan>> {
        match &self.content {
            RestoredContent::Scan(scan) => Some(scan),
            RestoredContent::Merged { .. } => None,
        }
    }

    fn sensor(&self) -> &SensorId {
        match &self.content {
            RestoredContent::Scan(scan) => &scan.sensor,
            RestoredContent::Merged { sensor, .. } => sensor,
        }
    }
}

/// A session as it was stored.
#[derive(Debug, Clone, Default)]
pub struct Restored {
    /// Keyframes from number 0 on.
    pub keyframes: Vec<RestoredKeyframe>,
    /// Registered frames, oldest first.
    pub trajectory: Vec<TrajectoryEntry>,
    /// Loops, in the order of finding.
    pub loops: Vec<Loop>,
    /// Objects, those gone included.
    pub objects: Vec<Object>,
    /// Number that the next object gets.
    pub next_object_id: u64,
    /// Newest accepted stamp of each sensor, its own clock.
    pub last_stamps: BTreeMap<SensorId, Timestamp>,
}

/// One robot's SLAM, maps, objects. A single writer; readers use [`Pipeline::snapshot`].
pub struct Pipeline {
    params: Arc<PipelineParams>,
    sensors: Sensors,
    wheel: OdometryBuffer,
    imu: ImuBuffer,
    clocks: ClockOffsets,
    clock_offsets: Arc<BTreeMap<SensorId, f64>>,
    odometry: Option<Odometry>,
    scale_hints: ScaleHints,
    anchoring: Anchoring,
    back_end: Option<BackEnd>,
    loops: Arc<Vec<Loop>>,
    /// Keyframes made while adrift.
    floating: Vec<loops::Floating>,
    /// Whether nothing measured ties the next keyframe to the one before.
    after_gap: bool,
    keyframe_policies: BTreeMap<SensorId, KeyframePolicy>,
    map: Map,
    detector: Detector,
    tracker: Tracker,
    /// Odom to map: found level at the first keyframe, moved by corrections.
    t_map_odom: Pose,
    pose: Option<PoseEstimate>,
    last_registered: Option<Timestamp>,
    trajectory: Chunks<TrajectoryEntry>,
    keyframes: Arc<Vec<KeyframeInfo>>,
    objects: Arc<Vec<Object>>,
    /// Height of base above the floor, found with the level.
    base_height_m: f64,
    /// Odom pose of the newest keyframe: corrections are seen relative to it.
    newest_keyframe_t_odom_base: Pose,
}

impl Pipeline {
    /// An empty session.
    ///
    /// # Errors
    /// A parameter out of bounds.
    pub fn new(params: PipelineParams) -> Result<Self, ParamsError> {
        params.validate()?;
        Ok(Self {
            sensors: Sensors::default(),
            wheel: OdometryBuffer::default(),
            imu: ImuBuffer::default(),
            clocks: ClockOffsets::default(),
            clock_offsets: Arc::default(),
            odometry: None,
            scale_hints: ScaleHints::default(),
            anchoring: Anchoring::default(),
            back_end: None,
            loops: Arc::default(),
            floating: vec![],
            after_gap: false,
            keyframe_policies: BTreeMap::new(),
            map: Map::new(params.map).map_err(|e| failed("map", e))?,
            detector: Detector::new(params.detection.detector).map_err(|e| failed("detection.detector", e))?,
            tracker: Tracker::new(params.tracker.clone()).map_err(|e| failed("tracker", e))?,
            base_height_m: 0.0,
            params: Arc::new(params),
            t_map_odom: Pose::identity(),
            pose: None,
            last_registered: None,
            trajectory: Chunks::default(),
            keyframes: Arc::default(),
            objects: Arc::default(),
            newest_keyframe_t_odom_base: Pose::identity(),
        })
    }

    /// Adds a sensor, or replaces its declaration.
    pub fn declare_sensor(&mut self, spec: SensorSpec) {
        self.sensors.declare(spec);
    }

    /// Brings back what was stored; sensors must be declared before.
    pub fn restore(&mut self, restored: Restored) {
        for (id, stamp) in &restored.last_stamps {
            self.sensors.set_last_stamp(id, *stamp);
        }
        let mut infos = Vec::with_capacity(restored.keyframes.len());
        for (i, k) in restored.keyframes.iter().enumerate() {
            let (id, sensor) = (KeyframeId(i as u64), k.sensor().clone());
            let t_map_base = k.t_map_base;
            self.policy(&sensor).resume(&k.t_odom_base);
            infos.push(match &k.content {
                RestoredContent::Scan(scan) => {
                    self.insert(id, t_map_base, scan);
                    self.base_height_m = scan.base_height_m;
                    let (stamp, num_points) = (scan.stamp, scan.hits.len());
                    KeyframeInfo { id, stamp, sensor, t_map_base, num_points, merged: None }
                }
                RestoredContent::Merged { stamp, merged, .. } => {
                    let (stamp, merged) = (*stamp, Some(*merged));
                    KeyframeInfo { id, stamp, sensor, t_map_base, num_points: 0, merged }
                }
            });
        }
        merging::carry(&mut infos);
        self.keyframes = Arc::new(infos);
        restored.trajectory.iter().for_each(|e| self.trajectory.push(*e));
        if let Ok(tracker) = Tracker::restore(self.params.tracker.clone(), &restored.objects, restored.next_object_id) {
            self.tracker = tracker;
        }
        self.objects = Arc::new(self.tracker.objects());
        self.restore_odometry(&restored);
    }

    /// Takes up odometry where the trajectory ends, with the last keyframes as the local model.
    fn restore_odometry(&mut self, restored: &Restored) {
        // Frames that were not tracked have guessed poses.
        let anchored = |e: &TrajectoryEntry| Some((*e, e.anchor.filter(|_| e.tracked)?));
        let entry = restored.trajectory.iter().rev().find_map(anchored);
        let (Some(newest), Some((entry, anchor))) = (restored.keyframes.last(), entry) else { return };
        self.newest_keyframe_t_odom_base = newest.t_odom_base;
        self.t_map_odom = newest.t_map_base * newest.t_odom_base.inverse();
        let Some(anchor) = restored.keyframes.get(anchor.0 as usize) else { return };
        // The trajectory hangs on keyframes of the sensor that moves the pose.
        let sensor = anchor.sensor().clone();
        let t_odom_base = anchor.t_odom_base * entry.t_anchor_base;
        let recent = self.recent_keyframes(&sensor);
        let Some(spec) = self.sensors.spec(&sensor).cloned() else { return };
        let Some(kind) = odometry_kind(spec.kind) else { return };
        let mut odometry = Odometry::new(kind, self.params.slam.odometry.clone());
        odometry.seed(&t_odom_base, &recent, entry.stamp);
        self.odometry = Some(odometry);
        self.anchoring = Anchoring::at(t_odom_base, entry.stamp);
        self.last_registered = Some(entry.stamp);
        self.restore_back_end(kind, &sensor, restored);
        self.sensors.set_pose_sensor(sensor);
        self.pose = Some(PoseEstimate {
            stamp: entry.stamp,
            state: TrackingState::Initialising,
            t_map_base: anchor.t_map_base * entry.t_anchor_base,
            t_odom_base,
            covariance: percept_geometry::Covariance6::identity() * 1e-2,
            inlier_ratio: 0.0,
            rmse_m: 0.0,
            degenerate_axes: [false; 6],
            // A camera's own map is not stored: it begins anew.
            scale: if kind == OdometryKind::Mono { Scale::Unknown } else { Scale::Measured },
            waiting: None,
            is_relocalised: false,
            map_version: self.map.layers().version,
        });
    }

    /// Takes one frame in. Parallel work runs on the current rayon pool.
    ///
    /// # Errors
    /// Bad input, by variant; nothing was changed.
    pub fn process(&mut self, frame: &SensorFrame) -> Result<FrameReport, FrameError> {
        let (spec, stamp) = self.sensors.admit(frame)?;
        let nothing = FrameReport::default();
        if let SensorData::Odometry(sample) = &frame.data {
            if let Some((before, angle)) = self.wheel.push(stamp, sample) {
                let dt = stamp.seconds_since(before);
                self.clocks.saw(&spec.id, before.plus_seconds(0.5 * dt), angle / dt);
            }
            return Ok(nothing);
        }
        if let SensorData::Imu(sample) = &frame.data {
            self.imu.push(stamp, sample, &spec.t_base_sensor);
            self.clocks.saw(&spec.id, stamp, sample.angular_velocity.norm());
            return Ok(nothing);
        }
        let Some(mut scan) = scan_of(&spec, &frame.data) else { return Ok(nothing) };
        if self.sensors.is_pose_sensor(&frame.sensor, &self.params.slam.pose_sensor, stamp) {
            if !self.is_metric() {
                self.scale_hints.see_image(stamp, &mut scan);
            }
            Ok(self.register(&spec, stamp, &scan))
        } else {
            self.tell_scale(stamp, &scan);
            Ok(self.map_only(&spec, stamp, &scan).unwrap_or(nothing))
        }
    }

    /// Whether the newest pose is in metres.
    fn is_metric(&self) -> bool {
        self.pose.as_ref().is_some_and(|p| p.scale.is_metric())
    }

    /// A frame of another sensor tells a camera its scale, perhaps.
    fn tell_scale(&mut self, stamp: Timestamp, scan: &Scan) {
        if self.is_metric() {
            self.scale_hints.clear();
        } else if let (Some(hint), Some(odometry)) = (self.scale_hints.see_other(stamp, scan), &mut self.odometry) {
            odometry.tell_scale(&hint);
        }
    }

    /// A frame that moves the pose.
    fn register(&mut self, spec: &SensorSpec, stamp: Timestamp, scan: &Scan) -> FrameReport {
        let since = self.last_registered;
        let wheels = since.and_then(|last| self.wheel.between(last, stamp));
        let prior = joined(wheels.clone(), since.and_then(|last| self.imu.between(last, stamp)));
        let kind = match scan {
            Scan::Depth(_) => OdometryKind::Rgbd,
            Scan::Cloud(_) => OdometryKind::Lidar3d,
            Scan::Planar(_) => OdometryKind::Lidar2d,
            Scan::Image(_) => OdometryKind::Mono,
        };
        let odometry = self.odometry.get_or_insert_with(|| Odometry::new(kind, self.params.slam.odometry.clone()));
        let (t_odom_last, was_tracking) = (*odometry.t_odom_base(), odometry.is_tracking());
        let mut estimate = odometry.register(stamp, scan, prior.as_ref());
        let moved = odometry.take_moved();
        if let Some(last) = since.filter(|_| was_tracking && estimate.state.is_tracking()) {
            let turn = t_odom_last.rotation.inverse() * estimate.t_odom_base.rotation;
            self.imu.learn(last, stamp, &turn);
            if self.clocks.turned(last, stamp, turn.angle()) {
                self.clock_offsets = Arc::new(self.clocks.found().clone());
            }
        }
        self.last_registered = Some(stamp);
        self.prepare_back_end(kind);
        if !moved.is_empty() {
            self.move_unanchored(&moved);
        }
        if !estimate.scale.is_metric() {
            return self.answer_without_scale(stamp, &estimate, wheels.is_some());
        }
        let mut report = FrameReport::default();
        let is_mapped = self.is_mapped(&spec.id, &estimate.t_odom_base);
        let mut tracked = self.anchoring.judge(&estimate, wheels.as_ref(), is_mapped);
        if self.anchoring.is_adrift() {
            (estimate, tracked) = self.recover(kind, spec, scan, estimate, &mut report);
        }
        let t_odom_base = estimate.t_odom_base;
        if tracked && self.policy(&spec.id).consider(&t_odom_base) {
            let kept = self.kept_of(spec, stamp, scan, true);
            let mut keyframe = self.add_keyframe(spec, kept, t_odom_base);
            self.close_loops(&mut keyframe, true, &mut report);
            report.changes = self.observe(&keyframe);
            report.keyframe = Some(keyframe);
        }
        let pose = self.pose_of(stamp, &estimate);
        self.pose = Some(pose.clone());
        report.trajectory = self.extend_trajectory(spec, stamp, tracked, &pose.t_map_base, report.keyframe.as_ref());
        report.pose = Some(pose);
        report
    }

    /// A frame whose pose is in no known unit: it is answered and said so, and no map is built from it.
    fn answer_without_scale(&mut self, stamp: Timestamp, estimate: &OdometryEstimate, has_wheels: bool) -> FrameReport {
        self.anchoring.judge_without_scale(estimate, has_wheels);
        // The camera's map has begun anew: what was gathered in the one before hangs on nothing any more.
        self.floating.clear();
        // Before anything hangs on it the map is turned upright.
        if self.trajectory.is_empty()
            && self.keyframes.is_empty()
            && let Some(up) = self.imu.up(stamp)
        {
            self.t_map_odom = by_gravity(up).t_map_base * estimate.t_odom_base.inverse();
        }
        let mut pose = self.pose_of(stamp, estimate);
        if self.anchoring.is_adrift() && pose.state.is_tracking() {
            pose.state = TrackingState::Lost { reason: LostReason::Adrift };
            pose.is_relocalised = false;
        }
        self.pose = Some(pose.clone());
        let tracked = pose.state.is_tracking();
        // Before the first pose that was measured there is no trajectory.
        let entry = (tracked || !self.trajectory.is_empty()).then_some(TrajectoryEntry {
            stamp,
            tracked,
            anchor: None,
            t_anchor_base: pose.t_map_base,
            is_keyframe: false,
        });
        entry.iter().for_each(|e| self.trajectory.push(*e));
        FrameReport { pose: Some(pose), trajectory: entry, ..FrameReport::default() }
    }

    /// Poses in a unit of their own hang on no keyframe: they follow the camera's own map when that closes a loop. Where they
    /// are stored they stay as they were said.
    fn move_unanchored(&mut self, moved: &[(Timestamp, Pose)]) {
        let (Some(first), t_map_odom) = (moved.first(), self.t_map_odom) else { return };
        let nearest = |stamp: Timestamp| {
            let after = moved.partition_point(|m| m.0 < stamp);
            let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| moved.get(i));
            around.min_by_key(|m| m.0.nanos().abs_diff(stamp.nanos())).map(|m| m.1)
        };
        let mut trajectory = Chunks::default();
        for entry in self.trajectory.iter() {
            let mut entry = *entry;
            if let Some(t_new_old) = nearest(entry.stamp).filter(|_| entry.anchor.is_none() && entry.stamp >= first.0) {
                entry.t_anchor_base = t_map_odom * t_new_old * t_map_odom.inverse() * entry.t_anchor_base;
            }
            trajectory.push(entry);
        }
        self.trajectory = trajectory;
    }

    /// Whether a sensor has been where odometry is now: a keyframe of its is near.
    fn is_mapped(&self, sensor: &SensorId, t_odom_base: &Pose) -> bool {
        let here = (self.t_map_odom * t_odom_base).translation.vector;
        let near = |k: &KeyframeInfo| {
            k.merged.is_none() && k.sensor == *sensor && (k.t_map_base.translation.vector - here).norm() < MAPPED_M
        };
        self.keyframes.iter().any(near)
    }

    /// Odometry runs on from a guess: back into the map if the frame is found there, else lost and said so. Where places
    /// can be recognised the whole map is looked through; else only the place where the robot was last known to be is
    /// tried: elsewhere rooms that resemble it would do as well.
    fn recover(
        &mut self,
        kind: OdometryKind,
        spec: &SensorSpec,
        scan: &Scan,
        estimate: OdometryEstimate,
        report: &mut FrameReport,
    ) -> (OdometryEstimate, bool) {
        if self.back_end.is_some() {
            if self.look_around(spec, scan, &estimate, report) {
                return (OdometryEstimate { state: TrackingState::Tracking, ..estimate }, true);
            }
        } else {
            let params = Arc::clone(&self.params);
            let mut anchoring = std::mem::take(&mut self.anchoring);
            let method = (kind, &params.slam.odometry);
            let near = |t_odom_base: &Pose| self.keyframes_near(&spec.id, t_odom_base);
            let found = anchoring.recover(method, &estimate, near, scan);
            self.anchoring = anchoring;
            if let Some((odometry, estimate)) = found {
                self.odometry = Some(odometry);
                return (estimate, true);
            }
        }
        (OdometryEstimate { state: TrackingState::Lost { reason: LostReason::Adrift }, ..estimate }, false)
    }

    /// Keyframes of a sensor around a place, with their odom poses, oldest first.
    fn keyframes_near(&self, sensor: &SensorId, t_odom_base: &Pose) -> Vec<(Pose, Arc<KeyframeScan>)> {
        let here = (self.t_map_odom * t_odom_base).translation.vector;
        let of_sensor = self.map.keyframes().iter().filter(|(_, k)| k.scan.sensor == *sensor);
        let mut by_distance: Vec<_> =
            of_sensor.map(|(id, k)| ((k.t_map_base.translation.vector - here).norm(), *id, k)).collect();
        by_distance.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        by_distance.truncate(NUM_RECENT);
        by_distance.sort_by_key(|(_, id, _)| *id);
        let t_odom_map = self.t_map_odom.inverse();
        by_distance.into_iter().map(|(_, _, k)| (t_odom_map * k.t_map_base, Arc::clone(&k.scan))).collect()
    }

    /// The newest keyframes of a sensor with their odom poses, oldest first: what odometry starts again from.
    fn recent_keyframes(&self, sensor: &SensorId) -> Vec<(Pose, Arc<KeyframeScan>)> {
        let t_odom_map = self.t_map_odom.inverse();
        let of_sensor = self.map.keyframes().values().filter(|k| k.scan.sensor == *sensor);
        let newest = of_sensor.rev().take(NUM_RECENT).map(|k| (t_odom_map * k.t_map_base, Arc::clone(&k.scan)));
        let mut recent: Vec<_> = newest.collect();
        recent.reverse();
        recent
    }

    fn pose_of(&self, stamp: Timestamp, estimate: &OdometryEstimate) -> PoseEstimate {
        let was_lost = self.pose.as_ref().is_some_and(|p| p.state.is_lost());
        PoseEstimate {
            stamp,
            state: estimate.state,
            t_map_base: self.t_map_odom * estimate.t_odom_base,
            t_odom_base: estimate.t_odom_base,
            covariance: estimate.covariance,
            inlier_ratio: estimate.inlier_ratio,
            rmse_m: estimate.rmse_m,
            degenerate_axes: estimate.degenerate_axes,
            scale: estimate.scale,
            waiting: estimate.waiting,
            is_relocalised: was_lost && estimate.state.is_tracking(),
            map_version: self.map.layers().version,
        }
    }

    /// A frame of another sensor: seen from where the pose sensor says the robot is, it adds to the map.
    fn map_only(&mut self, spec: &SensorSpec, stamp: Timestamp, scan: &Scan) -> Option<FrameReport> {
        let pose = self.pose.as_ref().filter(|p| !p.state.is_lost() && p.scale.is_metric())?;
        if matches!(scan, Scan::Image(_)) {
            return None;
        }
        // Too long after the last pose the robot may be anywhere.
        let ahead = stamp.seconds_since(pose.stamp);
        if ahead.abs() > 0.5 {
            return None;
        }
        let odometry = self.odometry.as_ref()?;
        let t_odom_base = odometry.t_odom_base() * se3::exp(&(odometry.velocity() * ahead));
        if !self.policy(&spec.id).consider(&t_odom_base) {
            return None;
        }
        let mut report = FrameReport::default();
        let kept = self.kept_of(spec, stamp, scan, false);
        let mut keyframe = self.add_keyframe(spec, kept, t_odom_base);
        self.close_loops(&mut keyframe, false, &mut report);
        report.changes = self.observe(&keyframe);
        report.keyframe = Some(keyframe);
        Some(report)
    }

    /// Adds a keyframe to the map layers. Poses and scans are our own: a refusal is a fault of ours.
    fn insert(&mut self, id: KeyframeId, t_map_base: Pose, scan: &Arc<KeyframeScan>) {
        if let Err(error) = self.map.insert(id, t_map_base, Arc::clone(scan)) {
            debug_assert!(false, "{error}");
        }
    }

    fn policy(&mut self, sensor: &SensorId) -> &mut KeyframePolicy {
        let params = &self.params.slam.odometry.keyframe;
        self.keyframe_policies.entry(sensor.clone()).or_insert_with(|| KeyframePolicy::new(params.clone()))
    }

    /// What a keyframe keeps; of the pose sensor's odometry knows more than the scan says.
    fn kept_of(&self, spec: &SensorSpec, stamp: Timestamp, scan: &Scan, is_pose_sensor: bool) -> KeyframeScan {
        let odometry = self.odometry.as_ref();
        if let Some(odometry) = odometry.filter(|_| is_pose_sensor) {
            return odometry.keyframe_scan(stamp, &spec.id, scan);
        }
        let velocity = odometry.map(Odometry::velocity).unwrap_or_default();
        keyframe::keyframe_scan(&self.params.slam.odometry.keyframe, stamp, &spec.id, scan, &velocity)
    }

    fn add_keyframe(&mut self, spec: &SensorSpec, mut scan: KeyframeScan, t_odom_base: Pose) -> NewKeyframe {
        let stamp = scan.stamp;
        // A camera's few points show no floor to be trusted, and its map begins before lengths are metres: it was levelled
        // then, where an IMU was at rest.
        if self.keyframes.is_empty() && spec.kind != SensorKind::Camera {
            let level = level(&scan, self.imu.up(stamp));
            self.t_map_odom = level.t_map_base * t_odom_base.inverse();
            self.base_height_m = level.base_height_m;
        }
        scan.base_height_m = self.base_height_m;
        self.enter(stamp, &spec.id, t_odom_base, Arc::new(scan))
    }

    /// Puts a keyframe into the map where odometry says.
    fn enter(
        &mut self,
        stamp: Timestamp,
        sensor: &SensorId,
        t_odom_base: Pose,
        scan: Arc<KeyframeScan>,
    ) -> NewKeyframe {
        let id = KeyframeId(self.keyframes.len() as u64);
        let t_map_base = self.t_map_odom * t_odom_base;
        self.insert(id, t_map_base, &scan);
        self.newest_keyframe_t_odom_base = t_odom_base;
        let num_points = scan.hits.len();
        let info = KeyframeInfo { id, stamp, sensor: sensor.clone(), t_map_base, num_points, merged: None };
        Arc::make_mut(&mut self.keyframes).push(info.clone());
        NewKeyframe { info, t_odom_base, scan }
    }

    /// Looks for objects in the map around a new keyframe.
    fn observe(&mut self, keyframe: &NewKeyframe) -> Vec<ObjectChange> {
        let is_sparse = self.sensors.spec(&keyframe.info.sensor).is_some_and(|s| s.kind == SensorKind::Camera);
        if !self.params.detection.enabled || keyframe.scan.planar || is_sparse {
            return vec![];
        }
        let layers = self.map.layers();
        let center = nalgebra::Point3::from(keyframe.info.t_map_base.translation.vector);
        let cloud = layers.cloud.points_within(&center, self.params.detection.range_m);
        // The fused cloud is sound by construction; a detector that refuses it finds nothing.
        let found = self.detector.detect(&cloud).unwrap_or_default();
        let observations: Vec<Observation> = found
            .iter()
            .map(|d| Observation { class: d.class, confidence: d.confidence, bbox: d.bbox, num_points: d.num_points })
            .collect();
        let range_image = RangeImage::new(&keyframe.info.t_map_base, &keyframe.scan);
        let stamp = keyframe.info.stamp;
        // The detector sees all of the map around the robot: what it does not find there is no thing of its own.
        let searched_m = self.params.detection.range_m - SEARCH_EDGE_M;
        let changes = self.tracker.update(stamp, &observations, &|b| match range_image.visibility(b) {
            Visibility::SeenThrough => Visibility::SeenThrough,
            _ if (b.center() - center).norm() < searched_m => Visibility::Refuted,
            unsure => unsure,
        });
        self.objects = Arc::new(self.tracker.objects());
        changes
    }

    fn extend_trajectory(
        &mut self,
        spec: &SensorSpec,
        stamp: Timestamp,
        tracked: bool,
        t_map_base: &Pose,
        keyframe: Option<&NewKeyframe>,
    ) -> Option<TrajectoryEntry> {
        let anchor = match keyframe {
            Some(k) => k.info.clone(),
            None => self.newest_anchor(&spec.id)?.clone(),
        };
        let entry = TrajectoryEntry {
            stamp,
            tracked,
            anchor: Some(anchor.id),
            t_anchor_base: anchor.t_map_base.inverse() * t_map_base,
            is_keyframe: keyframe.is_some(),
        };
        self.trajectory.push(entry);
        Some(entry)
    }

    /// The newest keyframe of the sensor that moves the pose.
    fn newest_anchor(&self, sensor: &SensorId) -> Option<&KeyframeInfo> {
        match self.trajectory.last()?.anchor {
            Some(anchor) => self.keyframes.get(usize::try_from(anchor.0).ok()?),
            None => self.keyframes.iter().rev().find(|k| k.sensor == *sensor),
        }
    }

    /// Moves keyframes, and all that hangs on them: trajectory, map layers, objects, and where the robot is now.
    /// Corrections for keyframes that do not exist are ignored.
    pub fn apply(&mut self, correction: &Correction) {
        self.revise(correction, &[]);
    }

    /// The same, with keyframes that leave the map.
    fn revise(&mut self, correction: &Correction, gone: &[KeyframeId]) {
        let mut moved: BTreeMap<KeyframeId, Pose> = BTreeMap::new();
        for (id, t_map_base) in &correction.t_map_base {
            let Some(info) = Arc::make_mut(&mut self.keyframes).get_mut(id.0 as usize) else { continue };
            moved.insert(*id, t_map_base * info.t_map_base.inverse());
            info.t_map_base = *t_map_base;
        }
        if moved.is_empty() && gone.is_empty() {
            return;
        }
        moved.extend(merging::carry(Arc::make_mut(&mut self.keyframes).as_mut_slice()));
        if let Err(error) = self.map.revise(correction, gone) {
            // Poses were checked when they came in; a map that refuses them keeps its old state.
            debug_assert!(false, "{error}");
        }
        if let Some(newest) = self.keyframes.last() {
            self.t_map_odom = newest.t_map_base * self.newest_keyframe_t_odom_base.inverse();
        }
        self.move_objects(&moved);
        let version = self.map.layers().version;
        if let Some(pose) = &mut self.pose {
            pose.t_map_base = self.t_map_odom * pose.t_odom_base;
            pose.map_version = version;
        }
    }

    /// Objects follow the keyframe nearest in time to when they were last seen.
    fn move_objects(&mut self, moved: &BTreeMap<KeyframeId, Pose>) {
        let keyframes = Arc::clone(&self.keyframes);
        let nearest = |stamp: Timestamp| {
            let after = keyframes.partition_point(|k| k.stamp < stamp);
            let around = [after.checked_sub(1), Some(after)].into_iter().flatten().filter_map(|i| keyframes.get(i));
            around.min_by_key(|k| k.stamp.nanos().abs_diff(stamp.nanos())).map(|k| k.id)
        };
        let t_new_old = |last_seen| nearest(last_seen).and_then(|id| moved.get(&id).copied());
        self.tracker.correct(&|_, last_seen| t_new_old(last_seen).unwrap_or_else(Pose::identity));
        self.objects = Arc::new(self.tracker.objects());
    }

    /// The state as it is now; cheap, and unaffected by what comes later.
    pub fn snapshot(&self) -> Snapshot {
        Snapshot {
            map_version: self.map.layers().version,
            pose: self.pose.clone(),
            trajectory: self.trajectory.clone(),
            keyframes: Arc::clone(&self.keyframes),
            layers: self.map.layers(),
            clock_offsets: Arc::clone(&self.clock_offsets),
            loops: Arc::clone(&self.loops),
            objects: Arc::clone(&self.objects),
            next_object_id: self.tracker.next_id(),
            params: Arc::clone(&self.params),
        }
    }

    /// The declaration of a sensor.
    pub fn sensor(&self, id: &SensorId) -> Option<&SensorSpec> {
        self.sensors.spec(id)
    }
}

fn failed(section: &'static str, e: impl std::fmt::Display) -> ParamsError {
    ParamsError { section, message: e.to_string() }
}

/// The method for a kind of sensor; none for kinds that cannot carry the pose.
fn odometry_kind(kind: SensorKind) -> Option<OdometryKind> {
    match kind {
        SensorKind::Depth | SensorKind::Rgbd => Some(OdometryKind::Rgbd),
        SensorKind::Lidar3d => Some(OdometryKind::Lidar3d),
        SensorKind::Lidar2d => Some(OdometryKind::Lidar2d),
        SensorKind::Camera => Some(OdometryKind::Mono),
        SensorKind::Imu | SensorKind::Odometry => None,
    }
}
