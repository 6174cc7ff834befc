//! The extrinsics check: a second sensor is mounted as declared if what it sees fits the map that the pose sensor made.
//!
//! Each of its keyframes is laid over what the pose sensor saw around. If most of it fits once it is moved, by the same
//! amount again and again, its mount is off by that.

use nalgebra::{Point3, Vector3};
use percept_geometry::{KeyframeScan, PointCloud, Pose, SensorId};
use percept_perception::registration::{IcpMethod, IcpOutcome, IcpParams, RegisterParams, RobustKernel, register};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Measurements that are kept; so many, and this share of them, have to agree. Where little of the map is known yet, or one
/// wall is in view, a keyframe fits in more than one way.
const KEPT: usize = 30;
const ENOUGH: usize = 5;
const SHARE: f64 = 0.4;
/// So many keyframes are measured one by one, whether they fit or not, and every so many from then on.
const FIRST: u32 = 40;
const EVERY: u32 = 10;
/// So much is worth telling: metres and radians. Poses, levelling and noise are off by less.
const TELLING: (f64, f64) = (0.08, 0.05);
/// Measurements agree within this, metres and radians.
const AGREE: (f64, f64) = (0.05, 0.03);
/// Least share of what the sensor sees that lies on the map once it is moved.
const MIN_INLIERS: f64 = 0.7;
/// Half height of the slice of a cloud that a planar scan is compared with, metres.
const SLICE_M: f64 = 0.1;
/// Fewest points of either side.
const MIN_POINTS: usize = 50;

/// How far a sensor's mount is off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MountOffset {
    /// Between where the sensor is declared to be and where it seems to be, metres.
    pub distance_m: f64,
    /// Between the directions, radians.
    pub angle_rad: f64,
}

#[derive(Debug, Clone, Default)]
struct Measured {
    /// What moves the sensor's points, in base, onto the map.
    offsets: VecDeque<Pose>,
    keyframes: u32,
}

/// Extrinsics of the sensors that do not move the pose, as measured.
#[derive(Debug, Clone, Default)]
pub(crate) struct ExtrinsicsCheck {
    measured: BTreeMap<SensorId, Measured>,
    told: Arc<BTreeMap<SensorId, MountOffset>>,
}

impl ExtrinsicsCheck {
    /// Mounts that are off.
    pub(crate) fn told(&self) -> Arc<BTreeMap<SensorId, MountOffset>> {
        Arc::clone(&self.told)
    }

    /// Whether this keyframe of the sensor should be measured.
    pub(crate) fn is_due(&mut self, sensor: &SensorId) -> bool {
        let measured = self.measured.entry(sensor.clone()).or_default();
        measured.keyframes += 1;
        measured.keyframes <= FIRST || measured.keyframes.is_multiple_of(EVERY)
    }

    /// Measures a keyframe of a sensor against others around it, with their base seen from base now.
    pub(crate) fn measure(&mut self, scan: &KeyframeScan, others: &[(Pose, Arc<KeyframeScan>)]) {
        let Some(offset) = offset(scan, others) else { return };
        let measured = self.measured.entry(scan.sensor.clone()).or_default();
        measured.offsets.push_back(offset);
        if measured.offsets.len() > KEPT {
            measured.offsets.pop_front();
        }
        let off = believed(&measured.offsets).map(|o| moved(&o, &scan.t_base_sensor));
        let off = off.filter(|o| o.distance_m > TELLING.0 || o.angle_rad > TELLING.1);
        if off != self.told.get(&scan.sensor).copied() {
            let told = Arc::make_mut(&mut self.told);
            match off {
                Some(off) => told.insert(scan.sensor.clone(), off),
                None => told.remove(&scan.sensor),
            };
        }
    }
}

fn moved(offset: &Pose, t_base_sensor: &Pose) -> MountOffset {
    let way = (offset * t_base_sensor).translation.vector - t_base_sensor.translation.vector;
    MountOffset { distance_m: way.norm(), angle_rad: offset.rotation.angle() }
}

/// The measurement that most others agree with, if those are enough.
fn believed(offsets: &VecDeque<Pose>) -> Option<Pose> {
    let agree = |a: &Pose, b: &Pose| {
        let off = a.inv_mul(b);
        off.translation.vector.norm() < AGREE.0 && off.rotation.angle() < AGREE.1
    };
    let count = |a: &Pose| offsets.iter().filter(|b| agree(a, b)).count();
    let best = offsets.iter().max_by_key(|a| count(a))?;
    let most = count(best);
    (most >= ENOUGH && most as f64 >= SHARE * offsets.len() as f64).then_some(*best)
}

/// What moves the scan's points onto those of the others, if most of them fit then. Directions that the surfaces leave
/// open stay as they are.
fn offset(scan: &KeyframeScan, others: &[(Pose, Arc<KeyframeScan>)]) -> Option<Pose> {
    let seen = |t: &Pose, k: &KeyframeScan| -> Vec<Point3<f64>> {
        k.hits.positions.iter().map(|p| t * p.cast::<f64>()).collect()
    };
    let mut source = seen(&Pose::identity(), scan);
    let mut target: Vec<Point3<f64>> = others.iter().flat_map(|(t, k)| seen(t, k)).collect();
    let plane = match (scan.planar, others.first()?.1.planar) {
        (true, _) => Some(scan.t_base_sensor.translation.z),
        (false, true) => others.first().map(|(_, k)| k.t_base_sensor.translation.z),
        (false, false) => None,
    };
    if let Some(z) = plane {
        source = slice(&source, z);
        target = slice(&target, z);
    }
    if source.len() < MIN_POINTS || target.len() < MIN_POINTS {
        return None;
    }
    let icp = IcpParams {
        method: IcpMethod::PointToPlane,
        max_distance_m: 0.3,
        kernel: RobustKernel::Huber(0.05),
        num_neighbours: 12,
        ..IcpParams::lidar(IcpMethod::PointToPlane)
    };
    let params = RegisterParams { voxel_sizes_m: vec![0.2, 0.1], icp };
    let cloud = |points: &[Point3<f64>]| PointCloud::from_positions(points.iter().map(|p| p.cast()).collect());
    let found = register(&cloud(&source), &cloud(&target), &Pose::identity(), &params).ok()?;
    let ended = matches!(found.outcome, IcpOutcome::Converged | IcpOutcome::Degenerate);
    (ended && found.inlier_ratio >= MIN_INLIERS).then_some(found.t_target_source)
}

/// The points at a height, as walls: upright surfaces that a planar scan and a cloud have in common.
fn slice(points: &[Point3<f64>], z: f64) -> Vec<Point3<f64>> {
    let at = points.iter().filter(|p| (p.z - z).abs() < SLICE_M);
    at.flat_map(|p| (-2..=2).map(move |k| Point3::new(p.x, p.y, z) + Vector3::z() * (0.1 * f64::from(k)))).collect()
}
