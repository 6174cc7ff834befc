//! A simulated drive as keyframes at true poses, and where their beams truly ended.

use crate::Failure;
use nalgebra::{Point3, Vector6};
use percept_geometry::{KeyframeScan, Pose, SensorData};
use percept_sim::{DepthCameraParams, Lidar3dParams, SensorSuite, SimParams, Simulation, World, WorldParams};
use percept_slam::keyframe::keyframe_scan;
use percept_slam::{CloudScan, DepthScan, KeyframeParams, KeyframePolicy, Scan};
use rayon::prelude::*;
use std::sync::Arc;

/// What the robot sees by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sensor {
    Lidar,
    Rgbd,
}

impl Sensor {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Lidar => "lidar",
            Self::Rgbd => "rgbd",
        }
    }

    /// The simulator's defaults, at five frames a second: keyframes are farther apart. A sweep is taken at once, as undoing the motion
    /// during it is odometry's work, and poses are given here.
    fn suite(self) -> SensorSuite {
        let lidar = || Lidar3dParams { rate_hz: 5.0, motion_distortion: false, ..Lidar3dParams::default() };
        let camera = || DepthCameraParams { rate_hz: 5.0, ..DepthCameraParams::default() };
        match self {
            Self::Lidar => SensorSuite { lidar3d: Some(lidar()), ..SensorSuite::none() },
            Self::Rgbd => SensorSuite { depth_camera: Some(camera()), ..SensorSuite::none() },
        }
    }
}

/// Nobody walks in it: what moves is put into it in `moved.rs`.
pub(crate) fn simulation(sensor: Sensor, seed: u64, laps: usize, world: WorldParams) -> Result<Simulation, Failure> {
    let world = WorldParams { seed, person: false, ..world };
    Ok(Simulation::new(SimParams { world, sensors: sensor.suite(), seed, laps, ..SimParams::default() })?)
}

pub(crate) struct Keyframe {
    /// Seconds after the start.
    pub(crate) at_s: f64,
    pub(crate) t_world_base: Pose,
    pub(crate) scan: Arc<KeyframeScan>,
}

impl Keyframe {
    /// Where its beams start.
    pub(crate) fn sensor(&self) -> Point3<f64> {
        (self.t_world_base * self.scan.t_base_sensor).translation.vector.into()
    }
}

/// The frames that the pipeline would keep, and what it would keep of them.
pub(crate) fn drive(simulation: &Simulation, sensor: Sensor) -> Vec<Keyframe> {
    let params = KeyframeParams::default();
    let mut policy = KeyframePolicy::new(params.clone());
    let Some(spec) = simulation.sensors().into_iter().next() else { return vec![] };
    let t_base_sensor = spec.t_base_sensor;
    let mut out = vec![];
    for frame in simulation.frames().filter(|f| policy.consider(&f.t_world_base)) {
        let scan = match (frame.frame.data, spec.intrinsics, sensor) {
            (SensorData::Rgbd(depth, color), Some(intrinsics), Sensor::Rgbd) => Scan::Depth(DepthScan {
                depth: Arc::new(depth),
                color: Some(Arc::new(color)),
                intrinsics,
                t_base_sensor,
            }),
            (SensorData::Cloud(cloud), _, Sensor::Lidar) => {
                Scan::Cloud(CloudScan { cloud: Arc::new(cloud), t_base_sensor })
            }
            _ => continue,
        };
        let scan = keyframe_scan(&params, frame.frame.stamp, &spec.id, &scan, &Vector6::zeros());
        out.push(Keyframe { at_s: frame.measured_s, t_world_base: frame.t_world_base, scan: Arc::new(scan) });
    }
    out
}

/// Where a beam of a keyframe ended.
pub(crate) struct Beam {
    pub(crate) keyframe: u32,
    /// From sensor to where the surface truly is in the beam's direction, metres.
    pub(crate) range_m: f64,
    /// That place, world.
    pub(crate) end: Point3<f64>,
}

/// Beams are followed no farther, metres: farther than a world is wide.
const FAR_M: f64 = 60.0;

/// All that came back, without their noise.
pub(crate) fn beams(world: &World, keyframes: &[Keyframe]) -> Vec<Beam> {
    let of = |(number, k): (usize, &Keyframe)| {
        let sensor = k.sensor();
        let beam = move |p: &Point3<f32>| {
            let direction = (k.t_world_base * p.cast::<f64>() - sensor).try_normalize(1e-6)?;
            let range_m = world.cast(&sensor, &direction, 0.0, FAR_M)?.distance;
            Some(Beam { keyframe: number as u32, range_m, end: sensor + direction * range_m })
        };
        k.scan.hits.positions.iter().filter_map(beam).collect::<Vec<_>>()
    };
    keyframes.par_iter().enumerate().map(of).collect::<Vec<_>>().into_iter().flatten().collect()
}
