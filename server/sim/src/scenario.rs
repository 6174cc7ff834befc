//! Sessions worth measuring SLAM on: a world, a drive, one sensor with wheels and IMU, and what goes wrong.

use crate::rng::{Purpose, stream};
use crate::{
    Blackout, ClockJump, DepthCameraParams, Disturbances, ImuParams, Kidnap, Lidar2dParams, Lidar3dParams,
    OdometryParams, Pause, RobotPath, ScanPattern, SensorSuite, SimError, SimParams, World, WorldParams,
};
use rand::RngExt;

/// The sensor that is to find the poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MainSensor {
    /// Planar lidar, a full turn, 10 Hz.
    Lidar2d,
    /// Spinning lidar of 16 rings, 10 Hz.
    Lidar3d,
    /// Lidar with a rosette pattern ahead, 10 Hz.
    Rosette,
    /// Depth camera with colour, 10 Hz.
    Rgbd,
    /// Depth camera without colour, 10 Hz.
    Depth,
    /// Camera without depth, 15 Hz.
    Camera,
}

impl MainSensor {
    /// The sensor with wheels (20 Hz) and IMU (100 Hz).
    pub fn suite(self) -> SensorSuite {
        let depth = |color| Some(DepthCameraParams { rate_hz: 10.0, color, ..DepthCameraParams::default() });
        let rosette = Lidar3dParams { pattern: ScanPattern::Rosette, ..Lidar3dParams::default() };
        let mut suite = SensorSuite {
            odometry: Some(OdometryParams::default()),
            imu: Some(ImuParams::default()),
            ..SensorSuite::none()
        };
        match self {
            Self::Lidar2d => suite.lidar2d = Some(Lidar2dParams::default()),
            Self::Lidar3d => suite.lidar3d = Some(Lidar3dParams::default()),
            Self::Rosette => suite.lidar3d = Some(rosette),
            Self::Rgbd => suite.depth_camera = depth(true),
            Self::Depth => suite.depth_camera = depth(false),
            Self::Camera => suite.depth_camera = SensorSuite::only_camera().depth_camera,
        }
        suite
    }
}

/// What a session puts to the test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scenario {
    /// Nothing goes wrong: laps through all rooms, every room seen again each lap.
    Loops,
    /// After a lap the robot is carried elsewhere in the rooms it knows, blind for 4 s, `trials` times, 20 s apart.
    Kidnap {
        /// How often.
        trials: usize,
    },
    /// Blind for 5 s in the middle of every minute.
    Blackout,
    /// The clock jumps 30 s ahead after a third of the session.
    Jump,
    /// A corridor of 60 m without features but its ends.
    Corridor,
    /// Standing still for a third of the session.
    Still,
    /// This share of frames is lost.
    Drop {
        /// Of a hundred.
        percent: u32,
    },
    /// A tenth of the frames arrive after the next one.
    Disorder,
    /// Stamps are off by 10 ms (standard deviation).
    Jitter,
    /// A second sensor (depth camera at 2 Hz; a planar lidar beside a camera) is declared 0.2 rad off its true heading.
    Extrinsics,
}

/// How long the robot is carried, seconds.
const CARRIED_S: f64 = 4.0;
/// From one kidnap to the next, seconds.
const BETWEEN_KIDNAPS_S: f64 = 20.0;

impl Scenario {
    /// The session of this scenario in a world of so many rooms (30 to 40 s each and lap), `seconds` long; a session
    /// of kidnaps lasts until all are over.
    ///
    /// # Errors
    /// `OutOfRange` naming a parameter.
    pub fn params(self, sensor: MainSensor, rooms: usize, seconds: f64, seed: u64) -> Result<SimParams, SimError> {
        let mut params = SimParams {
            world: WorldParams { seed, rooms, ..WorldParams::default() },
            sensors: sensor.suite(),
            seed,
            duration_s: Some(seconds),
            ..SimParams::default()
        };
        let wrong = &mut params.disturbances;
        match self {
            Self::Loops => {}
            Self::Kidnap { trials } => {
                let path = RobotPath::new(&World::generate(&params.world)?, &params.robot)?;
                *wrong = kidnaps(trials, path.lap_duration_s(), seed);
                let last = wrong.kidnaps.last().map_or(0.0, |k| k.at_s + CARRIED_S + BETWEEN_KIDNAPS_S);
                params.duration_s = Some(seconds.max(last));
            }
            Self::Blackout => {
                let minutes = (seconds / 60.0).ceil() as u32;
                let dark = |i| Blackout { at_s: 60.0 * f64::from(i) + 30.0, lasts_s: 5.0 };
                wrong.blackouts = (0..minutes).map(dark).collect();
            }
            Self::Jump => wrong.clock_jumps = vec![ClockJump { at_s: seconds / 3.0, by_s: 30.0 }],
            Self::Corridor => {
                params.world.corridor_m = Some(60.0);
                params.robot.look_around = false;
            }
            Self::Still => wrong.pauses = vec![Pause { at_s: seconds / 4.0, lasts_s: seconds / 3.0 }],
            Self::Drop { percent } => wrong.drop_rate = f64::from(percent) / 100.0,
            Self::Disorder => wrong.late_rate = 0.1,
            Self::Jitter => wrong.stamp_jitter_s = 0.01,
            Self::Extrinsics => {
                wrong.mount_yaw_error_rad = 0.2;
                match sensor {
                    MainSensor::Rgbd | MainSensor::Depth | MainSensor::Camera => {
                        params.sensors.lidar2d = Some(Lidar2dParams::default())
                    }
                    _ => {
                        params.sensors.depth_camera =
                            Some(DepthCameraParams { rate_hz: 2.0, color: false, ..DepthCameraParams::default() });
                    }
                }
            }
        }
        params.validate()?;
        Ok(params)
    }
}

/// Kidnaps after the first lap, each to somewhere between a fifth and four fifths of a lap ahead.
fn kidnaps(trials: usize, lap_s: f64, seed: u64) -> Disturbances {
    let mut rng = stream(seed, Purpose::Kidnap, 0, 0);
    let kidnap = |i: usize| Kidnap {
        at_s: lap_s + BETWEEN_KIDNAPS_S * i as f64,
        carried_s: CARRIED_S,
        ahead_s: rng.random_range(0.2..0.8) * lap_s,
    };
    Disturbances { kidnaps: (0..trials).map(kidnap).collect(), ..Disturbances::default() }
}
