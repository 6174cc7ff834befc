//! Three-dimensional occupancy against closed forms and brute force.

use crate::map::{correction, drifted, drive, id, scans};
use crate::scans::{Block, room, seen};
use nalgebra::{Point3, Unit, Vector3};
use percept_geometry::{Aabb3, Pose, Voxel, se3};
use percept_mapping::voxels::{MAX_RAY_VOXELS, VoxelReader, VoxelState};
use percept_mapping::{BlobId, Map, MapEntry, MapLayers, MapParams, MapStore, MappingError, VoxelGrid, VoxelParams};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

fn params() -> MapParams {
    MapParams { voxels: VoxelParams { enabled: true, ..Default::default() }, ..Default::default() }
}

fn all() -> Aabb3 {
    Aabb3 { min: Point3::new(-50.0, -50.0, -10.0), max: Point3::new(50.0, 50.0, 10.0) }
}

fn voxels(layers: &MapLayers) -> BTreeMap<Voxel, f32> {
    layers.voxels.within(&all(), usize::MAX).unwrap().into_iter().collect()
}

fn one_room() -> Map {
    let mut map = Map::new(params()).unwrap();
    let scan = Arc::new(room(0.5, 3.05, Some(1.5), 0.01));
    (0..3).for_each(|i| map.insert(id(i), &MapEntry::at(Pose::identity()), Arc::clone(&scan)).unwrap());
    map
}

#[test]
fn a_room_is_free_inside_occupied_at_its_walls_and_unknown_behind_them() {
    let layers = one_room().layers();
    let mut reader = VoxelReader::new(&layers.voxels);
    for (p, state) in [
        ([0.5, 0.5, 1.0], VoxelState::Free),
        ([3.05, 1.33, 1.0], VoxelState::Occupied),
        ([-3.04, -2.0, 0.7], VoxelState::Occupied),
        ([0.55, -1.0, 0.01], VoxelState::Occupied),
        ([1.26, 0.0, 0.8], VoxelState::Occupied),
        // The middle of the pillar, what stands behind it, what lies behind the wall.
        ([1.5, 0.0, 0.8], VoxelState::Unknown),
        ([2.1, 0.0, 0.5], VoxelState::Unknown),
        ([3.6, 0.0, 1.0], VoxelState::Unknown),
        ([f64::NAN, 0.0, 1.0], VoxelState::Unknown),
        ([1e300, 0.0, 1.0], VoxelState::Unknown),
    ] {
        assert_eq!(reader.state_at(&p.into()), state, "{p:?}");
    }
}

#[test]
fn a_ray_ends_where_the_wall_is_in_closed_form() {
    let layers = one_room().layers();
    let mut reader = VoxelReader::new(&layers.voxels);
    let from = Point3::new(-1.013, 0.717, 0.9);
    for i in 0..400 {
        let (azimuth, elevation) = (f64::from(i) * 0.0161, (f64::from(i) * 0.37).sin() * 0.3);
        let d = Vector3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
        let wall =
            |i: usize, half: f64| if d[i] == 0.0 { f64::INFINITY } else { (half * d[i].signum() - from[i]) / d[i] };
        let floor = if d.z < 0.0 { -from.z / d.z } else { (2.5 - from.z) / d.z.max(1e-12) };
        let exact = wall(0, 3.05).min(wall(1, 3.05)).min(floor);
        // The pillar's far side was not seen, and rays that graze something end early.
        let aside = (Point3::new(1.5, 0.0, 0.0) - from).xy().perp(&d.xy()).abs() / d.xy().norm();
        if aside < 0.6 && d.x > 0.0 {
            continue;
        }
        let hit = reader.cast(&from, &Unit::new_normalize(d), 20.0, false).unwrap();
        assert_eq!(hit.state, VoxelState::Occupied, "{i}");
        let grazes = (0.15 / d[d.iamax()].abs()).max(0.18 / elevation.abs().max(0.2));
        assert!((hit.distance_m - exact).abs() < grazes + 0.1, "{i}: {} instead of {exact}", hit.distance_m);
    }
    // Nothing ends it, unknown space ends it, and what cannot be followed is refused.
    let up = Unit::new_normalize(Vector3::x());
    let short = reader.cast(&Point3::new(-1.0, 1.0, 1.0), &up, 2.0, true).unwrap();
    assert_eq!((short.state, short.distance_m), (VoxelState::Free, 2.0));
    let behind = reader.cast(&Point3::new(3.3, 1.0, 1.0), &up, 9.0, true).unwrap();
    assert_eq!((behind.state, behind.distance_m), (VoxelState::Unknown, 0.0));
    for (from, range) in [(f64::NAN, 1.0), (0.0, f64::NAN), (0.0, MAX_RAY_VOXELS), (1e300, 1.0), (0.0, -1.0)] {
        assert!(reader.cast(&Point3::new(from, 0.0, 1.0), &up, range, false).is_none(), "{from} {range}");
    }
}

#[test]
fn what_has_gone_is_free_after_it_was_seen_through() {
    let things: [Block; 1] = [([2.0, -0.5, 0.0], [3.0, 0.5, 1.5])];
    let at = |i: usize| se3::from_xy_yaw(0.02 * i as f64, 0.0, 0.0);
    let mut map = Map::new(params()).unwrap();
    let insert = |map: &mut Map, i: usize, things: &[Block]| {
        map.insert(id(i), &MapEntry::at(at(i)), Arc::new(seen(&at(i), things))).unwrap();
    };
    (0..5).for_each(|i| insert(&mut map, i, &things));
    let front = Point3::new(2.05, 0.05, 0.5);
    assert_eq!(VoxelReader::new(&map.layers().voxels).state_at(&front), VoxelState::Occupied);
    // From the most that a voxel keeps it takes nine keyframes of OctoMap's steps.
    (5..14).for_each(|i| insert(&mut map, i, &[]));
    assert_eq!(VoxelReader::new(&map.layers().voxels).state_at(&front), VoxelState::Free);
}

/// The oracle: all keyframes integrated into one grid, read where it is.
fn direct(pose: impl Fn(usize) -> Pose) -> MapLayers {
    // A map of one submap: keyframes that do not move begin no other.
    let mut map = Map::new(params()).unwrap();
    let still = se3::from_xy_yaw(0.0, 0.0, 0.0);
    for (i, scan) in scans().iter().enumerate() {
        let entry = MapEntry { t_odom_base: still, ..MapEntry::at(pose(i)) };
        map.insert(id(i), &entry, Arc::clone(scan)).unwrap();
    }
    assert_eq!(map.submaps().len(), 1);
    map.layers()
}

#[test]
fn submaps_laid_over_each_other_say_what_one_grid_says_also_after_a_correction() {
    let oracle = voxels(&direct(drive));
    let agreement = |map: &Map| {
        let ours = voxels(&map.layers());
        let occupied = |v: f32| v > 0.0;
        let same = oracle.iter().filter(|(k, v)| ours.get(k).map(|v| occupied(*v)) == Some(occupied(**v))).count();
        same as f64 / oracle.len() as f64
    };
    let mut map = Map::new(params()).unwrap();
    for (i, scan) in scans().iter().enumerate() {
        map.insert(id(i), &MapEntry::at(drive(i)), Arc::clone(scan)).unwrap();
    }
    assert!(map.submaps().len() >= 5);
    assert!(agreement(&map) > 0.99, "{}", agreement(&map));
    // Drifted, then corrected: moved as a whole at once, built anew afterwards.
    let mut map = Map::new(params()).unwrap();
    for (i, scan) in scans().iter().enumerate() {
        map.insert(id(i), &MapEntry::at(drifted(i, 0.004)), Arc::clone(scan)).unwrap();
    }
    let before = agreement(&map);
    map.correct(&correction(drive), &[]).unwrap();
    let at_once = agreement(&map);
    while !map.advance(usize::MAX) {}
    let (corrected, straight) = (agreement(&map), voxels(&map.layers()));
    assert!(before < 0.96 && at_once > before + 0.01 && corrected > 0.99, "{before} {at_once} {corrected}");
    let mut fresh = Map::new(params()).unwrap();
    for (i, scan) in scans().iter().enumerate() {
        let entry = MapEntry { t_map_base: drive(i), ..MapEntry::at(drifted(i, 0.004)) };
        fresh.insert(id(i), &entry, Arc::clone(scan)).unwrap();
    }
    assert!(straight == voxels(&fresh.layers()), "a map that is built anew is the one that its keyframes give");
}

#[derive(Debug, Default)]
struct Shelf(Mutex<BTreeMap<BlobId, Vec<u8>>>);

impl MapStore for Shelf {
    fn put(&self, bytes: &[u8]) -> Option<BlobId> {
        let sum =
            bytes.iter().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3));
        let mut name = BlobId([0; 32]);
        name.0[..8].copy_from_slice(&sum.to_le_bytes());
        self.0.lock().unwrap().insert(name, bytes.to_vec());
        Some(name)
    }

    fn get(&self, id: &BlobId) -> Option<Vec<u8>> {
        self.0.lock().unwrap().get(id).cloned()
    }

    fn max_bytes(&self) -> usize {
        6_000_000
    }
}

#[test]
fn within_a_budget_voxels_are_those_without_one_and_cut_blobs_are_missing_not_a_panic() {
    let fill = |store: Option<Arc<Shelf>>| {
        let mut map = Map::new(params()).unwrap();
        store.into_iter().for_each(|s| map.set_store(s));
        for (i, scan) in scans().iter().enumerate() {
            map.insert(id(i), &MapEntry::at(drive(i)), Arc::clone(scan)).unwrap();
        }
        map
    };
    let shelf = Arc::new(Shelf::default());
    let (bounded, free) = (fill(Some(Arc::clone(&shelf))), fill(None));
    assert!(bounded.submaps().iter().any(|s| !s.is_loaded()));
    assert!(voxels(&bounded.layers()) == voxels(&free.layers()));
    let other = fill(Some(Arc::clone(&shelf)));
    for blob in shelf.0.lock().unwrap().values_mut() {
        blob.truncate(blob.len() - 3);
    }
    voxels(&other.layers());
    assert!(!other.layers().missing().is_empty());
}

#[test]
fn a_layer_that_is_not_enabled_takes_nothing_and_bad_scans_are_refused() {
    let mut map = Map::new(MapParams::default()).unwrap();
    map.insert(id(0), &MapEntry::at(Pose::identity()), Arc::new(room(0.5, 3.0, None, 0.05))).unwrap();
    assert_eq!(map.layers().voxels.tile_keys().count(), 0);
    let mut grid = VoxelGrid::new(params().voxels).unwrap();
    let mut nowhere = Pose::identity();
    nowhere.translation.vector.x = f64::NAN;
    assert_eq!(grid.integrate(&nowhere, &room(0.5, 3.0, None, 0.05)), Err(MappingError::PoseNotFinite));
    // Where no voxel has a number nothing is kept.
    let far = se3::from_xy_yaw(1e300, 0.0, 0.0);
    grid.integrate(&far, &room(0.5, 3.0, None, 0.05)).unwrap();
    assert!(grid == VoxelGrid::new(params().voxels).unwrap());
    let many = one_room().layers().voxels.within(&all(), 1_000);
    assert!(matches!(many, Err(MappingError::RegionTooLarge { limit: 1_000, .. })));
}
