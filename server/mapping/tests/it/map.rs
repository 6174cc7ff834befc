use crate::scans::{planar, room};
use percept_geometry::{Correction, KeyframeId, KeyframeScan, Pose, se3};
use percept_mapping::{Map, MapParams, MappingError};
use std::sync::Arc;

fn scans() -> Vec<Arc<KeyframeScan>> {
    (0..12).map(|i| Arc::new(room(0.8, 2.0 + 0.1 * f64::from(i), (i % 3 == 0).then_some(1.2), 0.04))).collect()
}

fn pose(i: usize, bend: f64) -> Pose {
    let s = i as f64;
    se3::from_xy_yaw(0.4 * s, bend * s * s, 2.0 * bend * s)
}

fn built(bend: f64) -> Map {
    let mut map = Map::new(MapParams::default()).unwrap();
    for (i, scan) in scans().into_iter().enumerate() {
        map.insert(KeyframeId(i as u64), pose(i, bend), scan).unwrap();
    }
    map
}

fn correction(bend: f64) -> Correction {
    Correction { t_map_base: (0..12).map(|i| (KeyframeId(i as u64), pose(i, bend))).collect() }
}

#[test]
fn a_corrected_map_is_the_one_built_at_the_corrected_poses_and_undo_restores_the_bytes() {
    let mut map = built(0.01);
    let before = map.layers();
    let report = map.apply(&correction(-0.02)).unwrap();
    assert_eq!((report.num_moved, report.num_unknown), (11, 0), "keyframe 0 stays");
    let (corrected, direct) = (map.layers(), built(-0.02).layers());
    assert_eq!((&corrected.occupancy, &corrected.cloud), (&direct.occupancy, &direct.cloud));
    assert_ne!(corrected.occupancy, before.occupancy);
    assert!(corrected.version > before.version);
    map.apply(&correction(0.01)).unwrap();
    let undone = map.layers();
    assert_eq!((&undone.occupancy, &undone.cloud), (&before.occupancy, &before.cloud));
    assert!(undone.version > corrected.version);
}

#[test]
fn a_revision_built_in_steps_beside_a_growing_map_is_the_map_built_at_once() {
    let (scans, direct) = (scans(), built(-0.02));
    let id = |i: usize| KeyframeId(i as u64);
    let mut map = Map::new(MapParams::default()).unwrap();
    (0..8).for_each(|i| map.insert(id(i), pose(i, 0.01), Arc::clone(&scans[i])).unwrap());
    let moved = Correction { t_map_base: (0..8).map(|i| (id(i), pose(i, -0.02))).collect() };
    let mut revision = map.begin_revision(&moved, &[]).unwrap();
    let mut steps = 0;
    for (i, scan) in scans.iter().enumerate().skip(8) {
        assert!(!revision.advance(scan.hits.len() + 1), "two keyframes a step, one comes meanwhile");
        map.insert(id(i), pose(i, 0.01), Arc::clone(scan)).unwrap();
        revision.insert(id(i), pose(i, -0.02), Arc::clone(scan)).unwrap();
    }
    while !revision.advance(1) {
        steps += 1;
    }
    assert!(steps > 0);
    let (version, shown) = (map.layers().version, built(0.01).layers());
    assert_eq!((&map.layers().occupancy, &map.layers().cloud), (&shown.occupancy, &shown.cloud), "untouched so far");
    map.adopt(revision);
    assert_eq!(map.layers().version, version + 1);
    assert_eq!(map.keyframes(), direct.keyframes());
    let (stepped, direct) = (map.layers(), direct.layers());
    assert_eq!((&stepped.occupancy, &stepped.cloud), (&direct.occupancy, &direct.cloud));
}

#[test]
fn what_a_revision_was_not_told_of_keeps_its_pose_and_what_it_took_out_stays_out() {
    let scans = scans();
    let id = |i: usize| KeyframeId(i as u64);
    let mut map = Map::new(MapParams::default()).unwrap();
    (0..6).for_each(|i| map.insert(id(i), pose(i, 0.01), Arc::clone(&scans[i])).unwrap());
    let revision = map.begin_revision(&Correction::default(), &[id(2)]).unwrap();
    map.insert(id(6), pose(6, 0.01), Arc::clone(&scans[6])).unwrap();
    map.adopt(revision);
    let mut direct = Map::new(MapParams::default()).unwrap();
    [0, 1, 3, 4, 5, 6].into_iter().for_each(|i| direct.insert(id(i), pose(i, 0.01), Arc::clone(&scans[i])).unwrap());
    assert_eq!(map.keyframes(), direct.keyframes());
    assert_eq!(map.layers().cloud, direct.layers().cloud);
}

#[test]
fn the_order_of_insertion_does_not_matter() {
    let forward = built(0.01).layers();
    let mut map = Map::new(MapParams::default()).unwrap();
    for (i, scan) in scans().into_iter().enumerate().rev() {
        map.insert(KeyframeId(i as u64), pose(i, 0.01), scan).unwrap();
    }
    assert_eq!((&map.layers().occupancy, &map.layers().cloud), (&forward.occupancy, &forward.cloud));
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut map = built(0.01);
            map.apply(&correction(0.0)).unwrap();
            map.layers()
        })
    };
    assert_eq!(on(1), on(4));
}

#[test]
fn what_changes_nothing_keeps_the_version_and_what_is_refused_keeps_the_map() {
    let mut map = built(0.01);
    let before = map.layers();
    map.apply(&correction(0.01)).unwrap();
    let unknown = Correction { t_map_base: vec![(KeyframeId(99), Pose::identity())] };
    assert_eq!(map.apply(&unknown).unwrap().num_unknown, 1);
    let broken = Correction {
        t_map_base: vec![(KeyframeId(1), Pose::identity()), (KeyframeId(2), se3::from_xy_yaw(f64::NAN, 0.0, 0.0))],
    };
    assert_eq!(map.apply(&broken), Err(MappingError::PoseNotFinite));
    let scan = Arc::new(planar(&[[1.0, 0.0]], &[]));
    let again = map.insert(KeyframeId(3), Pose::identity(), scan);
    assert_eq!(again, Err(MappingError::DuplicateKeyframe { id: KeyframeId(3) }));
    assert_eq!(map.layers(), before);
    assert_eq!(map.keyframes().len(), 12);
}
