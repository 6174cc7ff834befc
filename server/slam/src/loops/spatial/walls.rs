//! What stands upright, seen from above: the part of a scan that looks the same wherever it was taken from.

use super::submap::{range, voxel_for};
use nalgebra::{Point2, UnitQuaternion, Vector2, Vector3};
use percept_geometry::{KeyframeScan, Pose, se3};
use rustc_hash::FxHashMap;

/// Voxels above each other that make a wall: a floor and a ceiling have up to four, two each where they lie on an
/// edge.
const TALL: u32 = 5;

/// What turns base level and leaves the direction of its x axis.
pub(super) fn leveling(t_map_base: &Pose) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -se3::yaw(t_map_base)) * t_map_base.rotation
}

/// Places of the columns in which many voxels lie above each other, in base turned by `r_level_base`, metres.
pub(super) fn of(scan: &KeyframeScan, r_level_base: &UnitQuaternion<f64>) -> Vec<Point2<f32>> {
    let voxel_m = voxel_for(range(scan));
    let turn = r_level_base.to_rotation_matrix();
    let mut columns: FxHashMap<(i32, i32), Column> = FxHashMap::default();
    for p in &scan.hits.positions {
        let p = turn * p.cast::<f64>();
        let [x, y, z] = (p / voxel_m).coords.map(|v| v.floor() as i32).into();
        let column = columns.entry((x, y)).or_default();
        column.heights |= 1 << (z.rem_euclid(64));
        column.sum += p.coords.xy();
        column.count += 1.0;
    }
    let mut tall: Vec<((i32, i32), Column)> =
        columns.into_iter().filter(|(_, c)| c.heights.count_ones() >= TALL).collect();
    tall.sort_unstable_by_key(|(at, _)| *at);
    tall.into_iter().map(|(_, c)| Point2::from(c.sum / c.count).cast()).collect()
}

/// What was seen above one place.
#[derive(Debug, Clone, Copy, Default)]
struct Column {
    /// The heights that are filled, a bit each, of 64: columns are not higher, or start again from the bottom.
    heights: u64,
    sum: Vector2<f64>,
    count: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use percept_geometry::{PointCloud, Timestamp};

    #[test]
    fn walls_are_found_where_the_floor_is_tilted_and_floors_are_none() {
        let r_level_base = UnitQuaternion::from_euler_angles(0.2, -0.1, 0.0);
        let mut level = vec![];
        for (i, k) in (0..60).flat_map(|i| (0..60).map(move |k| (i, k))) {
            let (a, b) = (0.1 * f64::from(i) - 3.0, 0.1 * f64::from(k) - 3.0);
            level.push(Point3::new(a, b, 0.01));
            level.push(Point3::new(2.5, a, 0.04 * f64::from(k)));
        }
        let hits = level.iter().map(|p| (r_level_base.inverse() * p).cast()).collect();
        let scan = KeyframeScan {
            stamp: Timestamp(0),
            sensor: "lidar".into(),
            t_base_sensor: Pose::identity(),
            hits: PointCloud::from_positions(hits),
            misses: vec![],
            base_height_m: 0.0,
            planar: false,
            features: None,
        };
        let walls = of(&scan, &r_level_base);
        assert!(walls.len() > 40 && walls.iter().all(|p| (p.x - 2.5).abs() < 0.13), "{walls:?}");
    }
}
