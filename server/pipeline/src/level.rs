//! The map's z axis points up and its floor is z = 0: found from the first keyframe.
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

/// The level of the first keyframe. Identity if the scan is planar, shows no floor, or agrees with base.
pub(crate) fn level(scan: &KeyframeScan) -> Level {
    let as_declared = Level { t_map_base: Pose::identity(), base_height_m: 0.0 };
    if scan.planar {
        return as_declared;
    }
    let Some((up, height)) = floor(scan) else { return as_declared };
    if up.angle(&Vector3::z_axis()) < BELIEVED_TILT && height.abs() < BELIEVED_HEIGHT {
        return as_declared;
    }
    let rotation = UnitQuaternion::rotation_between(&up, &Vector3::z_axis()).unwrap_or_default();
    // Undo the turn about z that the shortest rotation brings along.
    let forward = rotation * Vector3::x();
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -forward.y.atan2(forward.x));
    Level { t_map_base: Pose::from_parts(Vector3::new(0.0, 0.0, height).into(), yaw * rotation), base_height_m: height }
}

/// The lowest large plane that is nearly horizontal in base: its upward normal, and base's height above it.
fn floor(scan: &KeyframeScan) -> Option<(Unit<Vector3<f64>>, f64)> {
    let cloud = voxel_downsample(&scan.hits, 0.1).ok()?;
    let n = cloud.len();
    let min_points = ((n as f64 * MIN_SHARE) as usize).max(30);
    let plane = PlaneParams { distance_m: 0.05, min_points, ..PlaneParams::default() };
    let params = PlanesParams { plane, max_planes: 6, ..PlanesParams::default() };
    let planes = segment_planes(&cloud.positions, &Vector3::z_axis(), &params).ok()?;
    let candidates = planes.iter().map(|s| {
        let plane = s.segment.plane;
        if plane.normal.z < 0.0 { (-plane.normal, -plane.offset) } else { (plane.normal, plane.offset) }
    });
    candidates
        .filter(|(up, _)| up.angle(&Vector3::z_axis()) < MAX_TILT)
        // Base stands on the floor or is carried above it; a little below is the fit's noise.
        .filter(|(_, height)| *height > -BELIEVED_HEIGHT)
        // Most of the scan lies above a floor; a ceiling or a table top fails this.
        .filter(|(up, height)| {
            let below = cloud.positions.iter().filter(|p| up.dot(&p.coords.cast()) + height < -0.15).count();
            (below as f64) < 0.05 * n as f64
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))
}
