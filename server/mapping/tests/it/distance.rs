//! Distance fields against brute force.

use crate::map::{drive, id, scans};
use crate::scans::{Block, seen};
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{Aabb3, Pose, Voxel, se3};
use percept_mapping::{Map, MapEntry, MapLayers, MapParams, MappingError, Occupancy, VoxelParams};
use std::sync::Arc;

fn params() -> MapParams {
    MapParams { voxels: VoxelParams { enabled: true, ..Default::default() }, ..Default::default() }
}

fn filled(num: usize) -> Map {
    let mut map = Map::new(params()).unwrap();
    for (i, scan) in scans().iter().take(num).enumerate() {
        map.insert(id(i), &MapEntry::at(drive(i)), Arc::clone(scan)).unwrap();
    }
    map
}

/// Points all over the room, and above and below it.
fn points() -> impl Iterator<Item = Point3<f64>> {
    (0..400u32).map(|i| {
        let spread = |m: u32| f64::from(i.wrapping_mul(m) >> 8) / f64::from(1u32 << 24) - 0.5;
        Point3::new(16.0 * spread(2_654_435_761), 16.0 * spread(2_246_822_519), 5.0 * spread(3_266_489_917) + 1.0)
    })
}

fn occupied(layers: &MapLayers) -> Vec<Voxel> {
    let all = Aabb3 { min: Point3::new(-50.0, -50.0, -9.0), max: Point3::new(50.0, 50.0, 9.0) };
    let known = layers.voxels.within(&all, usize::MAX).unwrap();
    known.into_iter().filter(|(_, l)| *l > 0.0).map(|(v, _)| v).collect()
}

#[test]
fn distances_of_voxels_are_exact_to_half_a_voxel_and_grow_along_their_gradient() {
    let layers = filled(24).layers();
    let (all, mut field) = (occupied(&layers), layers.voxel_distances());
    let (size, mut near, mut along) = (layers.voxels.params().voxel_size_m, 0, 0);
    for p in points() {
        let found = field.at(&p).unwrap();
        let exact = all.iter().map(|v| (v.center(size) - p).norm()).fold(f64::INFINITY, f64::min) - 0.5 * size;
        if exact > field.max_distance_m() - size {
            assert!(found.distance_m > field.max_distance_m() - 2.0 * size, "{p}: {found:?} instead of {exact}");
            continue;
        }
        near += 1;
        assert!((found.distance_m - exact).abs() < 0.5 * size, "{p}: {found:?} instead of {exact}");
        if exact > 0.3 {
            let ahead = field.at(&(p + found.gradient * 0.05)).unwrap();
            along += usize::from(ahead.distance_m > found.distance_m && (0.6..1.1).contains(&found.gradient.norm()));
        }
    }
    assert!(near > 150 && along > 60, "{near} {along}");
}

#[test]
fn distances_of_the_grid_are_exact_to_half_a_cell() {
    let layers = filled(24).layers();
    let grid = &layers.occupancy;
    let (min, max) = grid.bounds().unwrap();
    let dense = grid.region(min, max, 1 << 22).unwrap();
    let cells = (0..dense.cells.len()).filter(|i| dense.cells[*i] > 50);
    let centers: Vec<Point2<f64>> = cells
        .map(|i| dense.geometry.center(percept_geometry::Cell::new((i % dense.width) as i32, (i / dense.width) as i32)))
        .collect();
    let (mut field, mut near) = (layers.grid_distances(), 0);
    for p in points().map(|p| p.xy()) {
        let found = field.at(&p).unwrap().distance_m;
        let exact = centers.iter().map(|c| (c - p).norm()).fold(f64::INFINITY, f64::min) - 0.05;
        if exact < field.max_distance_m() - 0.1 {
            near += 1;
            // Inside of an obstacle brute force knows no depth.
            let is_right = if found < 0.0 { exact < 0.03 } else { (found - exact).abs() < 0.05 };
            assert!(is_right, "{p}: {found} instead of {exact}");
        }
    }
    assert!(near > 200, "{near}");
    assert_eq!(field.at(&Point2::new(f64::NAN, 0.0)), Err(MappingError::PointTooFar));
    assert_eq!(field.at(&Point2::new(0.0, 1e300)), Err(MappingError::PointTooFar));
    assert_eq!(field.at(&Point2::new(4_000.0, -90.0)).unwrap().distance_m, field.max_distance_m());
}

#[test]
fn what_changes_changes_the_distances_around_it_and_older_moments_keep_theirs() {
    let things: [Block; 1] = [([2.0, -0.5, 0.0], [3.0, 0.5, 1.5])];
    let mut map = Map::new(params()).unwrap();
    map.insert(id(0), &MapEntry::at(Pose::identity()), Arc::new(seen(&Pose::identity(), &[]))).unwrap();
    let (before, p) = (map.layers(), Point3::new(1.5, 0.0, 1.0));
    let at = |layers: &MapLayers| layers.voxel_distances().at(&p).unwrap().distance_m;
    assert!(at(&before) > 0.8);
    for i in 1..5 {
        let pose = se3::from_xy_yaw(0.01 * i as f64, 0.0, 0.0);
        map.insert(id(i), &MapEntry::at(pose), Arc::new(seen(&pose, &things))).unwrap();
    }
    let after = map.layers();
    assert!((at(&after) - 0.5).abs() < 0.06, "{}", at(&after));
    assert!(at(&before) > 0.8 && (at(&after) - 0.5).abs() < 0.06);
}

#[test]
fn inside_of_an_obstacle_distances_are_negative() {
    let layers = filled(24).layers();
    let voxel = occupied(&layers)[17];
    let p = voxel.center(layers.voxels.params().voxel_size_m) + Vector3::zeros();
    assert!(layers.voxel_distances().at(&p).unwrap().distance_m < 0.0);
    let none = Map::new(MapParams::default()).unwrap().layers();
    let (mut voxels, mut grid) = (none.voxel_distances(), none.grid_distances());
    assert_eq!(voxels.at(&p).unwrap().distance_m, voxels.max_distance_m());
    assert_eq!(grid.at(&p.xy()).unwrap().distance_m, grid.max_distance_m());
}
