//! The map's z axis points up and its floor is z = 0: found from the first keyframe, and from gravity where an IMU was
//! at rest.
//!
//! An IMU may be mounted otherwise than declared, which shows once the robot turns: too late for a map that was levelled by it.
//! Where the floor is seen where base was declared to stand on it, two agree against the IMU, which then has to be steeper
//! than ramps are to be disbelieved.
//!
//! A base whose origin is on the floor (as on most robots) keeps its frame. A handheld camera, or a lidar
//! whose mount was not declared, gets the tilt and height of the floor that it sees.

use nalgebra::{Unit, UnitQuaternion, Vector3};
use percept_geometry::{KeyframeScan, Pose};
use percept_perception::cloud::{PlaneParams, PlanesParams, segment_planes, voxel_downsample};

/// A floor is looked for within this angle of base's xy plane, radians (40 degrees).
const MAX_TILT: f64 = 0.7;
/// Declared frames this close to the floor found are believed, radians and metres: the fit is no better.
const BELIEVED_TILT: f64 = 0.02;
const BELIEVED_HEIGHT: f64 = 0.05;
/// A floor is this level, radians; where gravity is known, what is steeper is a ramp or no floor.
const MAX_SLOPE: f64 = 0.1;
/// Robots do not start on ramps that are steeper, radians (11 degrees): those of garages reach 15 to 20 %, of buildings 6 to 8.
const STEEPEST_RAMP: f64 = 0.2;
/// A floor that is as near to where base was declared to stand is the one that it stands on, metres.
const STANDS: f64 = 0.1;
/// Of a scan that shows how far down things reach: a share lies lower at most, which mirrors and noise make, and a share there at
/// least: the lowest 0.2 m of walls of 2.5 m are 0.08 of them, seen whole.
const MOST_BELOW: f64 = 0.005;
const LEAST_AT_FEET: f64 = 0.01;
/// A floor holds at least this share of the scan.
const MIN_SHARE: f64 = 0.05;

/// How base stands on the floor.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Level {
    /// Base to a level frame with the floor at z = 0 and its x axis over base's x axis.
    pub(crate) t_map_base: Pose,
    /// Height of base's origin above the floor, metres.
    pub(crate) base_height_m: f64,
}

/// The level of the first keyframe; `gravity_up` in base if it was measured. Identity if the scan is planar, agrees with base,
/// or shows no floor and nothing was measured.
pub(crate) fn level(scan: &KeyframeScan, gravity_up: Option<Unit<Vector3<f64>>>) -> Level {
    let as_declared = Level { t_map_base: Pose::identity(), base_height_m: 0.0 };
    if scan.planar {
        return as_declared;
    }
    let gravity_up = gravity_up.filter(|up| up.angle(&Vector3::z_axis()) <= STEEPEST_RAMP || !stands_as_declared(scan));
    match (floor(scan, gravity_up), gravity_up) {
        (Some((up, height)), _) => standing(up, height),
        (None, Some(up)) => by_gravity(up),
        (None, None) => as_declared,
    }
}

/// Whether the scan shows the floor where base was declared to stand on it; or, by a sensor that was declared to sit above base and
/// hardly looks down, that what stands around ends there, and nothing lies below.
fn stands_as_declared(scan: &KeyframeScan) -> bool {
    let is_level =
        |(up, height): (Unit<Vector3<f64>>, f64)| up.angle(&Vector3::z_axis()) < MAX_SLOPE && height.abs() < STANDS;
    if floor(scan, None).is_some_and(is_level) {
        return true;
    }
    let Ok(cloud) = voxel_downsample(&scan.hits, 0.1) else { return false };
    let share = |holds: fn(f64) -> bool| {
        cloud.positions.iter().filter(|p| holds(p.z.into())).count() as f64 / cloud.len().max(1) as f64
    };
    let is_above = scan.t_base_sensor.translation.z > STANDS;
    is_above && share(|z| z < -STANDS) < MOST_BELOW && share(|z| z.abs() <= STANDS) > LEAST_AT_FEET
}

/// The level by what an IMU at rest measured alone (`up` in base): the height stays as declared.
pub(crate) fn by_gravity(up: Unit<Vector3<f64>>) -> Level {
    standing(up, 0.0)
}

/// The level of a base `height` above the floor; identity where it agrees with what was declared.
fn standing(up: Unit<Vector3<f64>>, height: f64) -> Level {
    if up.angle(&Vector3::z_axis()) < BELIEVED_TILT && height.abs() < BELIEVED_HEIGHT {
        return Level { t_map_base: Pose::identity(), base_height_m: 0.0 };
    }
    // Upside down is half a turn, about any level axis.
    let over = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let rotation = UnitQuaternion::rotation_between(&up, &Vector3::z_axis()).unwrap_or_else(over);
    // Undo the turn about z that the shortest rotation brings along.
    let forward = rotation * Vector3::x();
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -forward.y.atan2(forward.x));
    Level { t_map_base: Pose::from_parts(Vector3::new(0.0, 0.0, height).into(), yaw * rotation), base_height_m: height }
}

/// The lowest large plane that is nearly horizontal, by gravity or in base: its upward normal, and base's height above it.
fn floor(scan: &KeyframeScan, gravity_up: Option<Unit<Vector3<f64>>>) -> Option<(Unit<Vector3<f64>>, f64)> {
    let (expected, most_tilt) = gravity_up.map_or((Vector3::z_axis(), MAX_TILT), |up| (up, MAX_SLOPE));
    let cloud = voxel_downsample(&scan.hits, 0.1).ok()?;
    let n = cloud.len();
    let min_points = ((n as f64 * MIN_SHARE) as usize).max(30);
    let plane = PlaneParams { distance_m: 0.05, min_points, ..PlaneParams::default() };
    let params = PlanesParams { plane, max_planes: 6, ..PlanesParams::default() };
    let planes = segment_planes(&cloud.positions, &expected, &params).ok()?;
    let candidates = planes.iter().map(|s| {
        let plane = s.segment.plane;
        if plane.normal.dot(&expected) < 0.0 { (-plane.normal, -plane.offset) } else { (plane.normal, plane.offset) }
    });
    candidates
        .filter(|(up, _)| up.angle(&expected) < most_tilt)
        // Base stands on the floor or is carried above it; a little below is the fit's noise.
        .filter(|(_, height)| *height > -BELIEVED_HEIGHT)
        // Most of the scan lies above a floor; a ceiling or a table top fails this.
        .filter(|(up, height)| {
            let below = cloud.positions.iter().filter(|p| up.dot(&p.coords.cast()) + height < -0.15).count();
            (below as f64) < 0.05 * n as f64
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use percept_geometry::{PointCloud, Timestamp};

    /// Points of a plane through `center` along two directions, 4 m wide, seen from a base turned by `r_world_base`.
    fn patch(center: Vector3<f64>, a: Vector3<f64>, b: Vector3<f64>, r: &UnitQuaternion<f64>) -> Vec<Point3<f32>> {
        let at = |i: i32, j: i32| center + a * (0.1 * f64::from(i)) + b * (0.1 * f64::from(j));
        let grid = (-20..=20).flat_map(|i| (-20..=20).map(move |j| (i, j)));
        grid.map(|(i, j)| Point3::from(r.inverse() * at(i, j)).cast()).collect()
    }

    fn seen(positions: Vec<Point3<f32>>) -> KeyframeScan {
        KeyframeScan {
            stamp: Timestamp(0),
            sensor: "lidar".into(),
            t_base_sensor: Pose::identity(),
            base_height_m: 0.0,
            hits: PointCloud::from_positions(positions),
            misses: vec![],
            planar: false,
            features: None,
        }
    }

    #[test]
    fn gravity_levels_a_base_that_sees_no_floor() {
        let tilted = UnitQuaternion::from_euler_angles(0.3, -0.9, 0.0);
        let wall = seen(patch(Vector3::new(3.0, 0.0, 0.0), Vector3::y(), Vector3::z(), &tilted));
        let up = Unit::new_normalize(tilted.inverse() * Vector3::z());
        let known = level(&wall, Some(up)).t_map_base;
        assert!((known.rotation * up.into_inner() - Vector3::z()).norm() < 1e-9);
        assert!((known.rotation * Vector3::x()).y.abs() < 1e-9);
        // Declared level and measured level: nothing is turned.
        let straight =
            seen(patch(Vector3::new(3.0, 0.0, 0.0), Vector3::y(), Vector3::z(), &UnitQuaternion::identity()));
        assert_eq!(level(&straight, Some(Vector3::z_axis())).t_map_base, Pose::identity());
    }

    /// The IMU of a robot that stands on the floor which it sees hangs otherwise than declared. A handheld sensor is as it is.
    #[test]
    fn gravity_that_a_floor_under_base_contradicts_is_not_believed() {
        let upright = UnitQuaternion::identity();
        let floor = |z: f64| seen(patch(Vector3::new(0.0, 0.0, z), Vector3::x(), Vector3::y(), &upright));
        let up =
            |pitch: f64| Some(Unit::new_normalize(UnitQuaternion::from_euler_angles(0.0, pitch, 0.0) * Vector3::z()));
        for pitch in [0.3, 1.5, std::f64::consts::PI] {
            assert_eq!(level(&floor(0.0), up(pitch)).t_map_base, Pose::identity(), "{pitch}");
            assert!(level(&floor(-1.3), up(pitch)).t_map_base.rotation.angle() > 0.29, "{pitch}");
        }
        // A lidar on it that sees walls alone, down to where they end; held in a hand it sees the same, from where base is.
        let wall = |z: f64| {
            let mut scan = seen(patch(Vector3::new(3.0, 0.0, z + 1.95), Vector3::y(), Vector3::z(), &upright));
            scan.t_base_sensor = Pose::translation(0.0, 0.0, 1.2);
            scan
        };
        assert_eq!(level(&wall(0.0), up(0.35)).t_map_base, Pose::identity());
        assert!(level(&wall(-1.2), up(0.35)).t_map_base.rotation.angle() > 0.34);
        // A robot on a ramp.
        assert!((level(&floor(0.0), up(0.15)).t_map_base.rotation.angle() - 0.15).abs() < 1e-6);
    }

    #[test]
    fn a_ramp_is_no_floor_where_gravity_is_known() {
        let slope = UnitQuaternion::from_euler_angles(0.0, 0.3, 0.0);
        let (along, across) = (slope * Vector3::x(), Vector3::y());
        let ramp = seen(patch(Vector3::new(2.0, 0.0, -1.0), along, across, &UnitQuaternion::identity()));
        assert!(level(&ramp, None).t_map_base.rotation.angle() > 0.25);
        assert_eq!(level(&ramp, Some(Vector3::z_axis())).t_map_base, Pose::identity());
        let floor = seen(patch(Vector3::new(2.0, 0.0, -1.0), Vector3::x(), across, &UnitQuaternion::identity()));
        assert!((level(&floor, Some(Vector3::z_axis())).base_height_m - 1.0).abs() < 0.02);
    }
}
