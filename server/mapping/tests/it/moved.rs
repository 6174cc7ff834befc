//! A thing that moved is gone from its old place in every layer once that was seen again often enough.

use crate::map::id;
use crate::scans::room;
use nalgebra::{Point2, Point3};
use percept_geometry::{Aabb3, Pose};
use percept_mapping::voxels::{VoxelReader, VoxelState};
use percept_mapping::{Map, MapEntry, MapParams, MeshOptions};
use std::sync::Arc;

/// Keyframes that take away the most log-odds that cells and voxels keep: 3.5 by 0.4 each.
const NUM_LOOKS: usize = 9;

/// The pillar of [`room`] two metres away, and a box around it.
const PILLAR_M: f64 = 2.0;

fn old_place() -> Aabb3 {
    Aabb3 { min: Point3::new(PILLAR_M - 0.3, -0.3, 0.15), max: Point3::new(PILLAR_M + 0.3, 0.3, 1.65) }
}

/// Points of the cloud, occupied voxels, whether a cell of the grid is occupied, triangles of the mesh in the old place.
fn left(map: &Map) -> (usize, usize, bool, usize) {
    let (layers, place) = (map.layers(), old_place());
    let cloud = layers.cloud.to_cloud();
    let points = cloud.positions.iter().filter(|p| place.contains(&p.cast())).count();
    let mut reader = VoxelReader::new(&layers.voxels);
    let at = |i: i32, n: i32, low: f64, high: f64| low + (high - low) * (f64::from(i) + 0.5) / f64::from(n);
    let (mut voxels, mut stands) = (0, false);
    for (x, y, z) in (0..6).flat_map(|x| (0..6).flat_map(move |y| (0..15).map(move |z| (x, y, z)))) {
        let p = Point3::new(
            at(x, 6, place.min.x, place.max.x),
            at(y, 6, place.min.y, place.max.y),
            at(z, 15, place.min.z, place.max.z),
        );
        voxels += usize::from(reader.state_at(&p) == VoxelState::Occupied);
        stands |= layers.occupancy.log_odds_at(&Point2::new(p.x, p.y)).is_some_and(|v| v > 0.405);
    }
    let mesh = layers.surface.mesh(&MeshOptions { region: Some(place), ..Default::default() }).unwrap();
    (points, voxels, stands, mesh.triangles.len())
}

#[test]
fn a_thing_that_moved_is_gone_from_its_old_place_after_nine_looks() {
    let mut params = MapParams::default();
    (params.voxels.enabled, params.surface.enabled) = (true, true);
    let (with, without) = (room(0.8, 4.0, Some(PILLAR_M), 0.01), room(0.8, 4.0, None, 0.01));
    let (with, without) = (Arc::new(with), Arc::new(without));
    // In a submap of its own, and in the one that saw it stand.
    for after_gap in [false, true] {
        let mut map = Map::new(params).unwrap();
        for i in 0..NUM_LOOKS {
            map.insert(id(i), &MapEntry::at(Pose::identity()), Arc::clone(&with)).unwrap();
        }
        let (points, voxels, stands, triangles) = left(&map);
        assert!(points > 200 && voxels > 20 && stands && triangles > 200, "{points} {voxels} {stands} {triangles}");
        for i in NUM_LOOKS..2 * NUM_LOOKS {
            let entry = MapEntry { after_gap: after_gap && i == NUM_LOOKS, ..MapEntry::at(Pose::identity()) };
            map.insert(id(i), &entry, Arc::clone(&without)).unwrap();
        }
        let (points_left, voxels_left, stands, triangles_left) = left(&map);
        let found = format!(
            "after gap {after_gap}: {points_left} of {points} points, {voxels_left} of {voxels} voxels, cell {stands}, \
             {triangles_left} of {triangles} triangles"
        );
        assert!(!stands, "{found}");
        // Beams are a voxel apart and more: some pass by what was hit.
        assert!(8 * points_left < points && 8 * voxels_left < voxels && 8 * triangles_left < triangles, "{found}");
    }
}
