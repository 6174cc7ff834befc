//! A simulated session: the robot drives, its sensors send.

use crate::rng::{Purpose, stream};
use crate::robot::Drive;
use crate::sensors::{Imu, Scene, Wheels, capture, scan, sweep};
use crate::{Disturbances, RobotParams, RobotPath, SensorSuite, SimError, TrueObject, World, WorldParams, check};
use nalgebra::{UnitQuaternion, Vector3};
use percept_geometry::{
    GeometryError, Pose, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Stamped, Timestamp,
};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A whole simulated session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimParams {
    /// The world.
    pub world: WorldParams,
    /// How the robot drives.
    pub robot: RobotParams,
    /// What it carries.
    pub sensors: SensorSuite,
    /// What goes wrong.
    pub disturbances: Disturbances,
    /// Seed of all sensor noise.
    pub seed: u64,
    /// Laps through all rooms, 1 to 1000, unless `duration_s` is given.
    pub laps: usize,
    /// Seconds to simulate, 0 to 1,000,000; none for whole laps.
    pub duration_s: Option<f64>,
    /// Stamp of the start.
    pub start_stamp: Timestamp,
}

impl Default for SimParams {
    fn default() -> Self {
        Self {
            world: WorldParams::default(),
            robot: RobotParams::default(),
            sensors: SensorSuite::default(),
            disturbances: Disturbances::default(),
            seed: 1,
            laps: 1,
            duration_s: None,
            start_stamp: Timestamp::from_nanos(1_700_000_000_000_000_000),
        }
    }
}

impl SimParams {
    /// Checks every part.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        self.world.validate()?;
        self.robot.validate()?;
        self.sensors.validate()?;
        self.disturbances.validate()?;
        check("laps", self.laps as f64, 1.0, 1000.0, "between 1 and 1000")?;
        check("duration_s", self.duration_s.unwrap_or(0.0), 0.0, 1e6, "between 0 and 1,000,000")
    }
}

/// One message and where the robot truly was when it was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct SimFrame {
    /// The message.
    pub frame: SensorFrame,
    /// When it was measured, seconds after the start.
    pub measured_s: f64,
    /// Base to world at the time of measurement, which is the stamp but for disturbances.
    pub t_world_base: Pose,
}

/// A world, a drive through it and sensors: cheap to clone, the same at every call.
#[derive(Debug, Clone)]
pub struct Simulation {
    params: SimParams,
    world: Arc<World>,
    path: Arc<RobotPath>,
    drive: Drive,
}

impl Simulation {
    /// Generates the world and plans the drive.
    ///
    /// # Errors
    /// `OutOfRange` naming a parameter.
    pub fn new(params: SimParams) -> Result<Self, SimError> {
        params.validate()?;
        let world = World::generate(&params.world)?;
        let path = Arc::new(RobotPath::new(&world, &params.robot)?);
        let drive = Drive::new(Arc::clone(&path), &params.disturbances);
        Ok(Self { params, world: Arc::new(world), path, drive })
    }

    /// What was asked for.
    pub fn params(&self) -> &SimParams {
        &self.params
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The path that is driven, without interruptions.
    pub fn path(&self) -> &RobotPath {
        &self.path
    }

    /// The sensors as a session declares them, errors of the declared mounts included.
    pub fn sensors(&self) -> Vec<SensorSpec> {
        let mut specs = self.params.sensors.specs();
        let error = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.params.disturbances.mount_yaw_error_rad);
        for spec in specs.iter_mut().filter(|s| sees(s.kind)).skip(1) {
            spec.t_base_sensor.rotation = error * spec.t_base_sensor.rotation;
        }
        specs
    }

    /// Base to world at the start: a map that begins there is the world moved by the inverse.
    pub fn t_world_start(&self) -> Pose {
        self.path.pose_at(0.0)
    }

    /// How long the session lasts, seconds.
    pub fn duration_s(&self) -> f64 {
        self.params.duration_s.unwrap_or(self.params.laps as f64 * self.path.lap_duration_s())
    }

    /// Seconds after the start at `stamp`.
    pub fn seconds_at(&self, stamp: Timestamp) -> f64 {
        stamp.seconds_since(self.params.start_stamp)
    }

    /// Base to world at `stamp` of a clock that nobody sets, exact.
    pub fn pose_at(&self, stamp: Timestamp) -> Pose {
        self.drive.pose_at(self.seconds_at(stamp))
    }

    /// Every object at `stamp`, world frame.
    pub fn objects_at(&self, stamp: Timestamp) -> Vec<TrueObject> {
        self.world.objects_at(self.seconds_at(stamp))
    }

    /// The true trajectory, base to world, at `rate_hz` samples a second from start to end.
    pub fn truth(&self, rate_hz: f64) -> Vec<Stamped<Pose>> {
        let count = if rate_hz > 0.0 { (self.duration_s() * rate_hz).floor() as u64 + 1 } else { 0 };
        (0..count)
            .map(|i| {
                let stamp = self.params.start_stamp.plus_seconds(i as f64 / rate_hz);
                Stamped { stamp, value: self.pose_at(stamp) }
            })
            .collect()
    }

    /// All messages in the order in which they are complete, made as they are asked for: see [`Frames`].
    pub fn frames(&self) -> Frames {
        let specs = self.sensors();
        let sources = specs
            .into_iter()
            .map(|spec| Source {
                rate_hz: self.params.sensors.rate_hz(spec.kind),
                lasts_s: self.params.sensors.lasts_s(spec.kind),
                id: spec.id,
                kind: spec.kind,
                next: 0,
                late: None,
            })
            .collect();
        let seed = self.params.seed;
        Frames {
            simulation: self.clone(),
            sources,
            wheels: self.params.sensors.odometry.clone().map(|p| Wheels::new(p, seed)),
            imu: self.params.sensors.imu.clone().map(|p| Imu::new(p, seed)),
            arrived: None,
        }
    }
}

/// A sensor and the number of its next message.
#[derive(Debug, Clone)]
struct Source {
    id: SensorId,
    kind: SensorKind,
    rate_hz: f64,
    /// From a message's stamp to when it is sent: a sweep is complete with its last point.
    lasts_s: f64,
    next: u64,
    /// A message that arrives after the next one.
    late: Option<SimFrame>,
}

/// Whether a sensor sees the surroundings.
fn sees(kind: SensorKind) -> bool {
    !matches!(kind, SensorKind::Odometry | SensorKind::Imu)
}

impl Source {
    fn next_s(&self) -> f64 {
        self.next as f64 / self.rate_hz
    }

    fn sent_s(&self) -> f64 {
        self.next_s() + self.lasts_s
    }
}

/// The messages of a simulation in the order in which they are complete, but for those that arrive late: a sweep follows
/// what was measured while it lasted. At equal times in the order of the sensors.
#[derive(Debug, Clone)]
pub struct Frames {
    simulation: Simulation,
    sources: Vec<Source>,
    wheels: Option<Wheels>,
    imu: Option<Imu>,
    /// A late message that comes now.
    arrived: Option<SimFrame>,
}

/// What becomes of a message on its way.
struct Transport {
    dropped: bool,
    late: bool,
    jitter_s: f64,
}

impl Frames {
    /// How many messages are measured in all, those taken already and those that get lost included.
    pub fn total(&self) -> u64 {
        let duration = self.simulation.duration_s();
        self.sources.iter().map(|s| (duration * s.rate_hz).ceil() as u64).sum()
    }

    fn measure(&mut self, kind: SensorKind, frame: u64, t_s: f64) -> Option<Result<SensorData, GeometryError>> {
        let Self { simulation, wheels, imu, .. } = self;
        let sensors = &simulation.params.sensors;
        let scene = Scene { world: &simulation.world, drive: &simulation.drive, seed: simulation.params.seed };
        match kind {
            SensorKind::Depth | SensorKind::Rgbd | SensorKind::Camera => {
                sensors.depth_camera.as_ref().map(|p| capture(p, &scene, frame, t_s))
            }
            SensorKind::Lidar3d => sensors.lidar3d.as_ref().map(|p| Ok(sweep(p, &scene, frame, t_s))),
            SensorKind::Lidar2d => sensors.lidar2d.as_ref().map(|p| Ok(scan(p, &scene, frame, t_s))),
            SensorKind::Odometry => wheels.as_mut().map(|w| Ok(w.sample(&scene, frame, t_s))),
            SensorKind::Imu => imu.as_mut().map(|i| Ok(i.sample(&scene, frame, t_s))),
        }
    }
}

impl Frames {
    /// Chance decides about each message of a sensor that sees, by its number alone.
    fn transport(&self, kind: SensorKind, frame: u64) -> Transport {
        let wrong = &self.simulation.params.disturbances;
        if !sees(kind) {
            return Transport { dropped: false, late: false, jitter_s: 0.0 };
        }
        let mut rng = stream(self.simulation.params.seed, Purpose::Transport, frame, kind as u64);
        let mut share = || rng.random_range(0.0..1.0);
        let (dropped, late) = (share() < wrong.drop_rate, share() < wrong.late_rate);
        let gauss: f64 = StandardNormal.sample(&mut rng);
        Transport { dropped, late, jitter_s: wrong.stamp_jitter_s * gauss }
    }

    /// The next message to be measured; none at the end. The inner none is one that gets lost.
    fn advance(&mut self) -> Option<Option<SimFrame>> {
        // `min_by` keeps the first of equals: the order of the sensors.
        let by_time = |a: &(usize, &Source), b: &(usize, &Source)| a.1.sent_s().total_cmp(&b.1.sent_s());
        let end_s = self.simulation.duration_s();
        let due = self.sources.iter().enumerate().filter(|(_, s)| s.next_s() < end_s);
        let (index, source) = due.min_by(by_time)?;
        let t_s = source.next_s();
        let (sensor, kind, frame) = (source.id.clone(), source.kind, source.next);
        self.sources[index].next += 1;
        let transport = self.transport(kind, frame);
        let wrong = &self.simulation.params.disturbances;
        if transport.dropped || (sees(kind) && wrong.is_dark(t_s)) {
            return Some(None);
        }
        let start = self.simulation.params.start_stamp;
        let sent = start.plus_seconds(t_s + transport.jitter_s + wrong.clock_offset_s(t_s));
        // Truth is that of the stamp as sent but for what goes wrong, to the nanosecond.
        let t_s = self.simulation.seconds_at(start.plus_seconds(t_s));
        // Sizes were checked with the parameters, so that a shape can not fail to fit here.
        let data = self.measure(kind, frame, t_s)?.ok()?;
        let t_world_base = self.simulation.drive.pose_at(t_s);
        let frame = SensorFrame { sensor, stamp: sent, data };
        let measured = SimFrame { frame, measured_s: t_s, t_world_base };
        let source = &mut self.sources[index];
        if transport.late && source.late.is_none() {
            source.late = Some(measured);
            return Some(None);
        }
        self.arrived = source.late.take();
        Some(Some(measured))
    }
}

impl Iterator for Frames {
    type Item = SimFrame;

    fn next(&mut self) -> Option<SimFrame> {
        if let Some(late) = self.arrived.take() {
            return Some(late);
        }
        loop {
            if let Some(frame) = self.advance()? {
                return Some(frame);
            }
        }
    }
}
