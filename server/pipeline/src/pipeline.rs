//! One robot's state and the path of a frame through it.

mod atlas;
mod keyframes;
mod loops;
mod merging;
mod register;
mod report;
mod restore;
mod revising;
mod settings;

pub use report::{FrameReport, NewKeyframe};
pub use restore::{Restored, RestoredContent, RestoredKeyframe};
use revising::Decision;
pub use revising::MapChange;
pub use settings::may_change;

use crate::frontend::clock_offset::ClockOffsets;
use crate::frontend::extrinsics::ExtrinsicsCheck;
use crate::frontend::odometry_prior::OdometryBuffer;
use crate::frontend::scale_hints::ScaleHints;
use crate::frontend::sensors::{Sensors, scan_of};
use crate::map_graph::worker::{Executor, GraphWorker, Relocated};
use crate::recovery::Anchoring;
use crate::scene::Scene;
use crate::{Chunks, FrameError, KeyframeInfo, ParamsError, PipelineParams, PoseEstimate, Snapshot, TrajectoryEntry};
use nalgebra::{Unit, Vector3};
use percept_geometry::{Correction, Pose, SensorData, SensorFrame, SensorId, SensorSpec, Timestamp};
use percept_mapping::{Map, MapMemory, MapStore, Submap};
use percept_slam::{ImuBuffer, KeyframePolicy, Loop, Odometry};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Offsets of an IMU's clock below this are what finding them is good to, seconds.
const CLOCK_IS_OFF_S: f64 = 0.01;

/// One robot's SLAM, maps, objects. A single writer; readers use [`Pipeline::snapshot`].
pub struct Pipeline {
    params: Arc<PipelineParams>,
    sensors: Sensors,
    /// By sensor; of several the first by name that covers a stretch is believed.
    wheels: BTreeMap<SensorId, OdometryBuffer>,
    imus: BTreeMap<SensorId, ImuBuffer>,
    clocks: ClockOffsets,
    clock_offsets: Arc<BTreeMap<SensorId, f64>>,
    extrinsics: ExtrinsicsCheck,
    odometry: Option<Odometry>,
    scale_hints: ScaleHints,
    anchoring: Anchoring,
    executor: Option<Arc<dyn Executor>>,
    graph: Option<GraphWorker>,
    loops: Arc<Vec<Loop>>,
    floating: loops::FloatingPart,
    /// Parts of the map that hang on nothing and wait to be recognised in it.
    atlas: atlas::Atlas,
    /// Where the robot was found to be at an earlier frame, until a frame makes use of it.
    relocated: Option<Relocated>,
    /// Whether nothing measured ties the next keyframe to the one before.
    after_gap: bool,
    keyframe_policies: BTreeMap<SensorId, KeyframePolicy>,
    map: Map,
    scene: Scene,
    /// Odom to map: found level at the first keyframe, moved by corrections.
    t_map_odom: Pose,
    pose: Option<PoseEstimate>,
    last_registered: Option<Timestamp>,
    trajectory: Chunks<TrajectoryEntry>,
    keyframes: Arc<Vec<KeyframeInfo>>,
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
            wheels: BTreeMap::new(),
            imus: BTreeMap::new(),
            clocks: ClockOffsets::default(),
            clock_offsets: Arc::default(),
            extrinsics: ExtrinsicsCheck::default(),
            odometry: None,
            scale_hints: ScaleHints::default(),
            anchoring: Anchoring::default(),
            executor: None,
            graph: None,
            loops: Arc::default(),
            floating: loops::FloatingPart::default(),
            atlas: atlas::Atlas::default(),
            relocated: None,
            after_gap: false,
            keyframe_policies: BTreeMap::new(),
            map: Map::new(params.map).map_err(|e| ParamsError::of("map", e))?,
            scene: Scene::new(&params)?,
            base_height_m: 0.0,
            params: Arc::new(params),
            t_map_odom: Pose::identity(),
            pose: None,
            last_registered: None,
            trajectory: Chunks::default(),
            keyframes: Arc::default(),
            newest_keyframe_t_odom_base: Pose::identity(),
        })
    }

    /// Recognises places and solves the graph beside frames, on threads of the executor's; without one, frames do it when
    /// they need what comes of it, which is the same.
    pub fn work_beside_frames(&mut self, executor: Arc<dyn Executor>) {
        if let Some(graph) = &mut self.graph {
            graph.set_executor(Arc::clone(&executor));
        }
        self.executor = Some(executor);
    }

    /// Adds a sensor, or replaces its declaration. What waits of one whose clock or mount is another now is dropped.
    pub fn declare_sensor(&mut self, spec: SensorSpec) {
        let is_other = |before: &SensorSpec| {
            before.time_offset_s != spec.time_offset_s || before.t_base_sensor != spec.t_base_sensor
        };
        if self.sensors.spec(&spec.id).is_some_and(is_other) {
            self.wheels.remove(&spec.id);
            self.imus.remove(&spec.id);
            self.clocks.forget(&spec.id);
            self.clock_offsets = Arc::new(self.clocks.found().clone());
        }
        self.sensors.declare(spec);
    }

    /// Takes one frame in. Parallel work runs on the current rayon pool.
    ///
    /// # Errors
    /// Bad input, by variant; nothing was changed.
    pub fn process(&mut self, frame: &SensorFrame) -> Result<FrameReport, FrameError> {
        let (spec, stamp) = self.sensors.admit(frame)?;
        let nothing = FrameReport::default();
        if let SensorData::Odometry(sample) = &frame.data {
            if let Some((before, angle)) = self.wheels.entry(spec.id.clone()).or_default().push(stamp, sample) {
                let dt = stamp.seconds_since(before);
                self.clocks.saw(&spec.id, before.plus_seconds(0.5 * dt), angle / dt);
            }
            return Ok(nothing);
        }
        if let SensorData::Imu(sample) = &frame.data {
            // Where its clock was found to be off, its samples are taken for when they were felt.
            let late = self.clock_offsets.get(&spec.id).copied().filter(|late| late.abs() > CLOCK_IS_OFF_S);
            let felt = stamp.plus_seconds(-late.unwrap_or(0.0));
            self.imus.entry(spec.id.clone()).or_default().push(felt, sample, &spec.t_base_sensor);
            self.clocks.saw(&spec.id, stamp, sample.angular_velocity.norm());
            return Ok(nothing);
        }
        let Some(mut scan) = scan_of(&spec, &frame.data) else { return Ok(nothing) };
        let mut change = self.take_answers(stamp);
        self.build_on();
        let mut report = if self.sensors.is_pose_sensor(&frame.sensor, &self.params.slam.pose_sensor, stamp) {
            if !self.is_metric() {
                self.scale_hints.see_image(stamp, &mut scan);
            }
            self.register(&spec, stamp, &scan)
        } else {
            self.tell_scale(stamp, &scan);
            self.map_only(&spec, stamp, &scan).unwrap_or(nothing)
        };
        change.extend(std::mem::take(&mut report.map));
        Ok(FrameReport { map: change, ..report })
    }

    /// Moves keyframes, and all that hangs on them: trajectory, map layers, objects, and where the robot is now.
    /// Corrections for keyframes that do not exist are ignored.
    pub fn apply(&mut self, correction: &Correction) {
        self.finish_revision();
        let mut decision = Decision { poses: correction.t_map_base.iter().copied().collect(), ..Decision::default() };
        // Where the newest keyframe goes, odom goes.
        let newest = self.keyframes.last().and_then(|k| Some((decision.poses.get(&k.id)?, k.t_odom_base)));
        decision.t_map_odom = newest.map(|(t_map_base, t_odom_base)| t_map_base * t_odom_base.inverse());
        self.decide(decision, &mut MapChange::default());
        self.finish_revision();
    }

    /// What map, keyframes and trajectory take, bytes. What odometry and loop closing hold beside them is not counted.
    pub fn memory_bytes(&self) -> usize {
        let trajectory = self.trajectory.len() * size_of::<TrajectoryEntry>();
        self.map.memory().total() + trajectory + self.keyframes.len() * size_of::<KeyframeInfo>()
    }

    /// What the map takes, by part.
    pub fn map_memory(&self) -> MapMemory {
        self.map.memory()
    }

    /// Sets where submaps go that are not in memory, and how many bytes the map may take before they do.
    pub fn set_map_store(&mut self, store: Arc<dyn MapStore>, max_bytes: usize) {
        self.map.set_store(store, max_bytes);
    }

    /// The submaps that the map is made of, in the order in which they were begun.
    pub fn submaps(&self) -> &[Submap] {
        self.map.submaps()
    }

    /// The state as it is now; cheap, and unaffected by what comes later.
    pub fn snapshot(&self) -> Snapshot {
        Snapshot {
            map_version: self.map.version(),
            pose: self.pose.clone(),
            trajectory: self.trajectory.clone(),
            keyframes: Arc::clone(&self.keyframes),
            layers: self.map.layers(),
            map_memory: self.map.memory(),
            clock_offsets: Arc::clone(&self.clock_offsets),
            mount_offsets: self.extrinsics.told(),
            loops: Arc::clone(&self.loops),
            objects: self.scene.objects(),
            next_object_id: self.scene.next_object_id(),
            params: Arc::clone(&self.params),
        }
    }

    /// The direction against gravity in base, if an IMU was at rest just before a stamp.
    fn up(&self, stamp: Timestamp) -> Option<Unit<Vector3<f64>>> {
        self.imus.values().find_map(|i| i.up(stamp))
    }

    /// The declaration of a sensor.
    pub fn sensor(&self, id: &SensorId) -> Option<&SensorSpec> {
        self.sensors.spec(id)
    }
}
