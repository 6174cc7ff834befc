use crate::scans::{Block, planar, seen, seen_planar};
use percept_geometry::{Cell, Correction, KeyframeId, KeyframeScan, Pose, se3};
use percept_mapping::{
    FusedCloud, Map, MapEntry, MapLayers, MapParams, MappingError, Occupancy, OccupancyGrid, RebuildStep,
};
use std::sync::Arc;

/// A cupboard, a box, a pillar.
const THINGS: [Block; 3] =
    [([2.0, 3.0, 0.0], [3.2, 3.6, 1.5]), ([-4.0, -2.0, 0.0], [-3.4, -1.2, 0.8]), ([0.3, -4.4, 0.0], [0.7, -4.0, 2.5])];

/// Keyframes along a loop of 24 m through the room, and back to its beginning: five submaps and more.
pub(crate) fn drive(i: usize) -> Pose {
    let angle = 0.13 * i as f64;
    se3::from_xy_yaw(4.0 * angle.cos(), 4.2 * angle.sin(), angle + 1.5)
}

const NUM: usize = 48;

pub(crate) fn scans() -> Vec<Arc<KeyframeScan>> {
    let scan = |i: usize| if i.is_multiple_of(3) { seen_planar(&drive(i), &THINGS) } else { seen(&drive(i), &THINGS) };
    (0..NUM).map(|i| Arc::new(scan(i))).collect()
}

/// Where odometry would have put a keyframe that drifts by so much.
pub(crate) fn drifted(i: usize, drift: f64) -> Pose {
    let s = i as f64;
    drive(i) * se3::from_xy_yaw(drift * s, 0.3 * drift * s, 0.2 * drift * s)
}

pub(crate) fn id(i: usize) -> KeyframeId {
    KeyframeId(i as u64)
}

pub(crate) fn built(scans: &[Arc<KeyframeScan>], pose: impl Fn(usize) -> Pose) -> Map {
    let mut map = Map::new(MapParams::default()).unwrap();
    scans.iter().enumerate().for_each(|(i, scan)| map.insert(id(i), &MapEntry::at(pose(i)), Arc::clone(scan)).unwrap());
    map
}

pub(crate) fn correction(pose: impl Fn(usize) -> Pose) -> Correction {
    Correction { t_map_base: (0..NUM).map(|i| (id(i), pose(i))).collect() }
}

/// The oracle: all keyframes integrated into one grid and one cloud.
fn direct(scans: &[Arc<KeyframeScan>], pose: impl Fn(usize) -> Pose) -> (OccupancyGrid, FusedCloud) {
    let params = MapParams::default();
    let mut layers = (OccupancyGrid::new(params.occupancy).unwrap(), FusedCloud::new(params.cloud).unwrap());
    for (i, scan) in scans.iter().enumerate() {
        layers.0.integrate(&pose(i), scan).unwrap();
        layers.1.integrate(&pose(i), scan).unwrap();
    }
    layers
}

/// Cells that are known in the oracle; of those, the share on which the map agrees whether they are occupied, free, or
/// neither; and of the oracle's occupied cells, the share with an occupied cell of the map in or beside them.
fn agreement(map: &MapLayers, oracle: &OccupancyGrid) -> (f64, f64) {
    let (min, max) = oracle.bounds().unwrap();
    let (ours, theirs) = (map.occupancy.region(min, max, 1 << 20).unwrap(), oracle.region(min, max, 1 << 20).unwrap());
    let state = |percent: u8| i32::from(percent >= 60) - i32::from(percent <= 40);
    let of_map = |c: Cell| ours.value(c).flatten().map(state);
    let cells = (0..ours.height as i32).flat_map(|y| (0..ours.width as i32).map(move |x| Cell::new(x, y)));
    let known: Vec<(Cell, i32)> = cells.filter_map(|c| Some((c, state(theirs.value(c)??)))).collect();
    let same = known.iter().filter(|(c, s)| of_map(*c) == Some(*s)).count();
    let around = |c: &Cell| {
        (-1..=1)
            .flat_map(move |y| (-1..=1).map(move |x| (x, y)))
            .map(|(x, y)| Cell::new(c.x + x, c.y + y))
            .collect::<Vec<_>>()
    };
    let occupied: Vec<Cell> = known.iter().filter(|(_, s)| *s == 1).map(|(c, _)| *c).collect();
    let there = occupied.iter().filter(|c| around(c).into_iter().any(|c| of_map(c) == Some(1))).count();
    (same as f64 / known.len() as f64, there as f64 / occupied.len() as f64)
}

/// Median and 99th percentile of the distance from the points of one cloud to the nearest of the other, metres.
fn apart(a: &percept_geometry::PointCloud, b: &percept_geometry::PointCloud) -> (f32, f32) {
    let edge = 0.25f32;
    let key = |p: &nalgebra::Point3<f32>| [p.x, p.y, p.z].map(|v| (v / edge).floor() as i32);
    let mut cells: std::collections::HashMap<[i32; 3], Vec<nalgebra::Point3<f32>>> = Default::default();
    b.positions.iter().for_each(|p| cells.entry(key(p)).or_default().push(*p));
    let nearest = |p: &nalgebra::Point3<f32>| {
        let k = key(p);
        let around = (0..27).map(|n| [k[0] + n % 3 - 1, k[1] + n / 3 % 3 - 1, k[2] + n / 9 - 1]);
        around.filter_map(|k| cells.get(&k)).flatten().map(|q| (p - q).norm()).fold(edge, f32::min)
    };
    let mut distances: Vec<f32> = a.positions.iter().map(nearest).collect();
    distances.sort_by(f32::total_cmp);
    (distances[distances.len() / 2], distances[distances.len() * 99 / 100])
}

#[test]
fn submaps_laid_over_each_other_are_the_map_built_at_once() {
    let scans = scans();
    let map = built(&scans, drive);
    assert!(map.submaps().len() >= 5, "{}", map.submaps().len());
    let (grid, cloud) = direct(&scans, drive);
    let (same, there) = agreement(&map.layers(), &grid);
    let (ours, theirs) = (map.layers().cloud.to_cloud(), cloud.to_cloud());
    assert!(same > 0.995 && there > 0.999, "{same} {there}");
    assert!(ours.len().abs_diff(theirs.len()) * 100 < theirs.len(), "{} {}", ours.len(), theirs.len());
    assert!(apart(&ours, &theirs).1 < 0.01 && apart(&theirs, &ours).1 < 0.05);
}

#[test]
fn a_correction_is_seen_at_once_and_to_the_cell_once_what_it_bent_is_built_anew() {
    let scans = scans();
    let mut map = built(&scans, |i| drifted(i, 0.004));
    let before = map.layers();
    let picture = before.occupancy.dense(1 << 20).unwrap();
    let (grid, cloud) = direct(&scans, drive);
    assert!(agreement(&before, &grid).1 < 0.95, "walls were seen elsewhere");
    let report = map.correct(&correction(drive), &[]).unwrap();
    assert_eq!((report.num_moved, report.num_unknown), (NUM - 1, 0), "keyframe 0 stays");
    assert!(map.version() > before.version && report.num_bent > 0 && map.is_rebuilding());
    // At the centres of cells that lie askew, walls are read within a cell of where they are.
    let (same, there) = agreement(&map.layers(), &grid);
    assert!(same > 0.97 && there > 0.995, "{same} {there}");
    let (ours, theirs) = (map.layers().cloud.to_cloud(), cloud.to_cloud());
    assert!(apart(&ours, &theirs).0 < 0.025 && apart(&theirs, &ours).1 < 0.05, "half a voxel, and a voxel");

    let version = map.version();
    while !map.advance(5_000) {}
    assert!(!map.is_rebuilding() && map.version() > version);
    let (same, there) = agreement(&map.layers(), &grid);
    assert!(same > 0.995 && there > 0.999, "{same} {there}");
    // Who looked before sees what was there.
    assert_eq!(before.occupancy.dense(1 << 20).unwrap(), picture);
}

#[test]
fn a_map_that_moves_as_a_whole_is_bent_nowhere_and_undoing_it_restores_the_bytes() {
    let scans = scans();
    let mut map = built(&scans, drive);
    let (before, shift) = (map.layers(), se3::from_xy_yaw(2.0, -1.0, 0.5));
    let report = map.correct(&correction(|i| shift * drive(i)), &[]).unwrap();
    assert_eq!((report.num_bent, report.num_submaps_moved), (0, map.submaps().len()));
    let (grid, _) = direct(&scans, |i| shift * drive(i));
    let (same, there) = agreement(&map.layers(), &grid);
    assert!(same > 0.95 && there > 0.99, "{same} {there}");
    while !map.advance(1) {}
    assert!(map.submaps().iter().all(|s| *s.t_map_submap() == Pose::identity()), "on the map's cells again");
    let (same, there) = agreement(&map.layers(), &grid);
    assert!(same > 0.995 && there > 0.999, "{same} {there}");
    map.correct(&correction(drive), &[]).unwrap();
    while !map.advance(usize::MAX) {}
    let undone = map.layers();
    assert_eq!((&undone.occupancy, &undone.cloud), (&before.occupancy, &before.cloud));
    assert!(undone.version > before.version);
}

/// A drive by drifting odometry with a gap in it, corrected and culled as it goes while submaps are being built anew, all of
/// one and the first of another among them: the map, and what is known of each keyframe, with whether it was culled. Steps
/// of building are `beside` what else is done with the map, or between.
fn driven(scans: &[Arc<KeyframeScan>], beside: bool) -> (Map, Vec<(MapEntry, bool)>) {
    let mut map = Map::new(MapParams::default()).unwrap();
    let mut step = None;
    let mut entries: Vec<(MapEntry, bool)> = vec![];
    let mut t_map_odom = Pose::identity();
    for (i, scan) in scans.iter().enumerate() {
        let t_odom_base = drifted(i, 0.004);
        let entry = MapEntry { t_map_base: t_map_odom * t_odom_base, t_odom_base, after_gap: i == 25 };
        map.insert(id(i), &entry, Arc::clone(scan)).unwrap();
        entries.push((entry, false));
        if beside {
            step.take().into_iter().for_each(|step: RebuildStep| map.take_step(step.run()));
            step = map.next_step(3_000);
            assert!(map.next_step(1).is_none(), "one after the other");
        } else {
            map.advance(3_000);
        }
        if i % 10 != 9 && i != NUM - 2 {
            continue;
        }
        // Ever nearer to where they were.
        t_map_odom = drifted(i, 0.02 / i as f64) * t_odom_base.inverse();
        for (k, (entry, _)) in entries.iter_mut().enumerate() {
            entry.t_map_base = drifted(k, 0.02 / i as f64);
        }
        let gone: Vec<usize> = match i {
            19 => vec![0, 7, 8],
            39 => map.submaps()[1].keyframes().keys().map(|id| id.0 as usize).chain([26]).collect(),
            46 => map.submaps().last().unwrap().keyframes().keys().map(|id| id.0 as usize).collect(),
            _ => vec![],
        };
        gone.iter().for_each(|k| entries[*k].1 = true);
        let moved = entries.iter().enumerate().map(|(k, (entry, _))| (id(k), entry.t_map_base)).collect();
        map.correct(&Correction { t_map_base: moved }, &gone.into_iter().map(id).collect::<Vec<_>>()).unwrap();
    }
    assert_eq!(step.is_some(), beside, "something is being built at the end");
    step.into_iter().for_each(|step| map.take_step(step.run()));
    (map, entries)
}

#[test]
fn a_map_that_is_restored_from_its_keyframes_is_the_map_that_was_stored() {
    let scans = scans();
    for beside in [false, true] {
        let (map, entries) = driven(&scans, beside);
        assert!(map.is_rebuilding() && entries.iter().any(|e| e.1));
        is_restored(map, &entries, &scans);
    }
}

fn is_restored(mut map: Map, entries: &[(MapEntry, bool)], scans: &[Arc<KeyframeScan>]) {
    while !map.advance(usize::MAX) {}
    let mut restored = Map::new(MapParams::default()).unwrap();
    for (i, (entry, is_gone)) in entries.iter().enumerate() {
        match is_gone {
            true => restored.skip(entry),
            false => restored.insert(id(i), entry, Arc::clone(&scans[i])).unwrap(),
        }
    }
    let submaps =
        |map: &Map| map.submaps().iter().map(|s| (s.id(), s.keyframes().clone(), s.is_frozen())).collect::<Vec<_>>();
    assert_eq!(submaps(&map), submaps(&restored));
    let (ours, theirs) = (map.layers(), restored.layers());
    assert_eq!((&ours.occupancy, &ours.cloud), (&theirs.occupancy, &theirs.cloud));
    // And both go on alike.
    for map in [&mut map, &mut restored] {
        map.insert(id(NUM), &MapEntry::at(drive(NUM)), Arc::clone(&scans[0])).unwrap();
    }
    assert_eq!(submaps(&map), submaps(&restored));
}

#[test]
fn a_submap_that_is_moved_while_it_is_built_anew_gets_built() {
    let scans = scans();
    let mut map = built(&scans, |i| drifted(i, 0.004));
    // Corrections come faster than anything is built.
    for step in 0..40 {
        let drift = 0.0001 * f64::from(step % 2);
        map.correct(&correction(|i| drifted(i, drift)), &[]).unwrap();
        map.advance(20_000);
    }
    let off = |map: &Map| {
        let of_submap = |s: &percept_mapping::Submap| {
            let off = |(id, t): (&KeyframeId, &Pose)| se3::log(&t.inv_mul(&drive(id.0 as usize))).norm();
            s.keyframes().iter().map(off).fold(0.0, f64::max)
        };
        map.submaps().iter().map(of_submap).fold(0.0, f64::max)
    };
    assert!(off(&map) < 0.02, "{}", off(&map));
}

#[test]
fn a_submap_that_loses_keyframes_while_it_is_built_anew_gets_built_without_them() {
    let scans = scans();
    let mut map = built(&scans, |i| drifted(i, 0.004));
    map.correct(&correction(drive), &[]).unwrap();
    map.advance(1);
    let last = |s: &percept_mapping::Submap| *s.keyframes().keys().next_back().unwrap();
    let gone: Vec<KeyframeId> = map.submaps().iter().map(last).collect();
    map.correct(&Correction::default(), &gone).unwrap();
    while !map.advance(usize::MAX) {}
    let mut direct = Map::new(MapParams::default()).unwrap();
    for (i, scan) in scans.iter().enumerate() {
        let entry = MapEntry { t_odom_base: drifted(i, 0.004), ..MapEntry::at(drive(i)) };
        match gone.contains(&id(i)) {
            true => direct.skip(&entry),
            false => direct.insert(id(i), &entry, Arc::clone(scan)).unwrap(),
        }
    }
    assert_eq!(map.layers().occupancy, direct.layers().occupancy);
    assert_eq!(map.layers().cloud, direct.layers().cloud);
}

#[test]
fn what_is_built_anew_does_not_depend_on_the_steps_nor_on_the_threads() {
    let scans = scans();
    let on = |threads: usize, step: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut map = built(&scans, |i| drifted(i, 0.004));
            map.correct(&correction(drive), &[id(3), id(40)]).unwrap();
            while !map.advance(step) {}
            map.layers()
        })
    };
    let (one, other) = (on(1, 1), on(4, usize::MAX));
    assert_eq!((&one.occupancy, &one.cloud), (&other.occupancy, &other.cloud));
}

#[test]
fn a_submap_goes_with_its_last_keyframe_and_is_built_anew_without_others() {
    let scans = scans();
    let mut map = built(&scans, drive);
    let first: Vec<KeyframeId> = map.submaps()[0].keyframes().keys().copied().collect();
    let (gone, num) = (map.submaps()[0].id(), map.submaps().len());
    map.correct(&Correction::default(), &first).unwrap();
    assert!(map.submaps().len() == num - 1 && map.submaps().iter().all(|s| s.id() != gone) && !map.is_rebuilding());
    let thinned = *map.submaps()[0].keyframes().keys().next().unwrap();
    map.correct(&Correction::default(), &[thinned]).unwrap();
    while !map.advance(usize::MAX) {}
    assert!(!map.submaps()[0].keyframes().contains_key(&thinned) && !map.keyframes().contains_key(&thinned));
    let left: Vec<usize> = (0..NUM).filter(|i| map.keyframes().contains_key(&id(*i))).collect();
    let (mut grid, _) = direct(&[], drive);
    left.iter().for_each(|i| grid.integrate(&drive(*i), &scans[*i]).unwrap());
    let (same, there) = agreement(&map.layers(), &grid);
    assert!(same > 0.995 && there > 0.999, "{same} {there}");
}

/// The room from keyframe `i` of a way along y = 0 from x = -6 to 6 and back: there two submaps, back two more.
fn there_and_back(i: usize) -> Pose {
    let s = 0.5 * i as f64;
    if s <= 12.0 { se3::from_xy_yaw(s - 6.0, 0.0, 0.0) } else { se3::from_xy_yaw(18.0 - s, 0.05, 3.1) }
}

/// Things in the first part of the way, and other ones when the robot comes back.
fn changed(at_first: &[Block], later: &[Block], see: impl Fn(&Pose, &[Block]) -> KeyframeScan) -> MapLayers {
    let mut map = Map::new(MapParams::default()).unwrap();
    for i in 0..48 {
        let t = there_and_back(i);
        map.insert(id(i), &MapEntry::at(t), Arc::new(see(&t, if i < 24 { at_first } else { later }))).unwrap();
    }
    assert!(map.submaps().len() >= 4);
    map.layers()
}

/// Cells of the map within a rectangle that are occupied.
fn num_occupied(layers: &MapLayers, (min, max): &Block) -> usize {
    let geometry = layers.occupancy.geometry();
    let cell = |p: &[f64; 3]| geometry.cell(&[p[0], p[1]].into()).unwrap();
    let part = layers.occupancy.region(cell(min), cell(max), 1 << 20).unwrap();
    part.cells.iter().filter(|v| **v >= 60).count()
}

#[test]
fn what_was_moved_away_is_freed_and_vanishes_once_a_later_submap_sees_through_it() {
    let chair: Block = ([-2.0, 1.5, 0.0], [-1.5, 2.0, 1.2]);
    let cupboard: Block = ([1.0, -2.5, 0.0], [1.6, -2.0, 1.5]);
    let around = |b: &Block| ([b.0[0] - 0.2, b.0[1] - 0.2, 0.0], [b.1[0] + 0.2, b.1[1] + 0.2, 0.0]);
    let count = |layers: &MapLayers, b: &Block| {
        let center = nalgebra::Point3::new(0.5 * (b.0[0] + b.1[0]), 0.5 * (b.0[1] + b.1[1]), 0.5 * b.1[2]);
        let near = layers.cloud.points_within(&center, 0.7);
        near.positions.iter().filter(|p| p.z > 0.2 && p.z < b.1[2] as f32 - 0.1).count()
    };
    let stays = changed(&[chair, cupboard], &[chair, cupboard], seen);
    let goes = changed(&[chair, cupboard], &[cupboard], seen);
    assert!(num_occupied(&stays, &around(&chair)) >= 5 && count(&stays, &chair) > 60, "{}", count(&stays, &chair));
    assert_eq!(num_occupied(&goes, &around(&chair)), 0);
    assert!(count(&goes, &chair) * 20 <= count(&stays, &chair), "{} left", count(&goes, &chair));
    assert_eq!(num_occupied(&goes, &around(&cupboard)), num_occupied(&stays, &around(&cupboard)), "what stands stays");
    assert!(count(&goes, &cupboard) * 20 >= count(&stays, &cupboard) * 19);
}

#[test]
fn who_has_left_vanishes_for_a_planar_lidar_too_whose_plane_is_the_border_of_two_layers_of_voxels() {
    let person: Block = ([-2.0, 1.5, 0.0], [-1.6, 1.9, 1.7]);
    let count = |layers: &MapLayers| layers.cloud.points_within(&nalgebra::Point3::new(-1.8, 1.7, 0.2), 0.5).len();
    let (stays, leaves) = (changed(&[person], &[person], seen_planar), changed(&[person], &[], seen_planar));
    assert!(count(&stays) > 15 && count(&leaves) == 0, "{} of {}", count(&leaves), count(&stays));
}

#[test]
fn a_table_top_stays_when_later_submaps_look_under_it_or_a_planar_lidar_passes_there() {
    let top: Block = ([-1.0, 1.2, 0.75], [0.6, 2.2, 0.8]);
    let around = (top.0, top.1);
    let seen_from_above = |t: &Pose, blocks: &[Block]| {
        // The top is seen by a high sensor first: its beams hit the table; later the low one passes beneath.
        let lift = se3::from_xy_yaw(0.0, 0.0, 0.0);
        let mut up = t * lift;
        if t.rotation.angle() < 1.0 {
            up.translation.vector.z += 0.8;
        }
        let mut scan = seen(&up, blocks);
        if t.rotation.angle() < 1.0 {
            scan.hits = scan.hits.transformed(&(t.inverse() * up));
            scan.t_base_sensor = (t.inverse() * up) * scan.t_base_sensor;
        }
        scan
    };
    let high_then_low = changed(&[top], &[top], seen_from_above);
    let never = changed(&[], &[], seen_from_above);
    let stands = num_occupied(&high_then_low, &around);
    assert!(stands > 30 && num_occupied(&never, &around) == 0, "{stands}");
    let then_planar = |t: &Pose, blocks: &[Block]| {
        if t.rotation.angle() < 1.0 { seen_from_above(t, blocks) } else { seen_planar(t, blocks) }
    };
    assert!(num_occupied(&changed(&[top], &[top], then_planar), &around) > 30);
    // A look through where it was frees it.
    let gone = changed(&[top], &[], |t, blocks| {
        let mut t_high = *t;
        t_high.translation.vector.z += 0.3;
        let mut scan = seen(&t_high, blocks);
        scan.hits = scan.hits.transformed(&(t.inverse() * t_high));
        scan.t_base_sensor = (t.inverse() * t_high) * scan.t_base_sensor;
        if blocks.is_empty() { scan } else { seen_from_above(t, blocks) }
    });
    assert!(num_occupied(&gone, &around) * 10 < stands, "{} of {stands}", num_occupied(&gone, &around));
}

#[test]
fn readers_learn_which_tiles_changed() {
    let scans = scans();
    let mut map = built(&scans[..NUM - 1], drive);
    let before = map.layers();
    assert_eq!(before.occupancy.changed_since(before.version).count(), 0);
    map.insert(id(NUM - 1), &MapEntry::at(drive(NUM - 1)), Arc::clone(&scans[NUM - 1])).unwrap();
    let after = map.layers();
    let changed: Vec<_> = after.cloud.changed_since(before.version).collect();
    for key in after.cloud.tile_keys().filter(|key| !changed.contains(key)) {
        assert!(before.cloud.tile(key) == after.cloud.tile(key));
    }
    assert!(changed.iter().any(|key| before.cloud.tile(*key) != after.cloud.tile(*key)));
}

#[test]
fn what_changes_nothing_keeps_the_version_and_what_is_refused_keeps_the_map() {
    let scans = scans();
    let mut map = built(&scans, drive);
    let before = map.layers();
    map.correct(&correction(drive), &[]).unwrap();
    let unknown = Correction { t_map_base: vec![(id(99), Pose::identity())] };
    assert_eq!(map.correct(&unknown, &[]).unwrap().num_unknown, 1);
    let broken =
        Correction { t_map_base: vec![(id(1), Pose::identity()), (id(2), se3::from_xy_yaw(f64::NAN, 0.0, 0.0))] };
    assert_eq!(map.correct(&broken, &[]), Err(MappingError::PoseNotFinite));
    let scan = Arc::new(planar(&[[1.0, 0.0]], &[]));
    let again = map.insert(id(3), &MapEntry::at(Pose::identity()), Arc::clone(&scan));
    assert_eq!(again, Err(MappingError::DuplicateKeyframe { id: id(3) }));
    map.correct(&Correction::default(), &[id(3)]).unwrap();
    let older = map.insert(id(3), &MapEntry::at(Pose::identity()), scan);
    assert_eq!(older, Err(MappingError::KeyframeNotNewest { id: id(3), newest: id(NUM - 1) }));
    map = built(&scans, drive);
    assert_eq!((map.layers(), map.keyframes().len()), (before, NUM));
}

#[test]
fn what_was_not_seen_again_for_too_long_leaves_all_layers_and_what_was_seen_again_stays() {
    let scans = scans();
    // The way goes once round the room, and away from there.
    let away = |i: usize| if i < NUM { drive(i) } else { se3::from_xy_yaw(200.0, 0.0, 0.0) * drive(i - NUM) };
    let run = |time_to_live_s: f64, num: usize| {
        let mut map = Map::new(MapParams { time_to_live_s, ..MapParams::default() }).unwrap();
        for i in 0..num {
            let scan = KeyframeScan {
                stamp: percept_geometry::Timestamp(i as i64 * 1_000_000_000),
                ..KeyframeScan::clone(&scans[i % NUM])
            };
            map.insert(id(i), &MapEntry::at(away(i)), Arc::new(scan)).unwrap();
        }
        map
    };
    let known_here = |map: &Map| {
        let (low, high) = (Cell::new(-80, -80), Cell::new(80, 80));
        let grid = map.layers().occupancy.region(low, high, 1 << 20).unwrap();
        let cloud = map.layers().cloud.points_within(&nalgebra::Point3::origin(), 20.0);
        (grid.cells.iter().filter(|c| **c >= 0).count(), cloud.len())
    };
    let all = known_here(&run(0.0, 2 * NUM));
    assert!(all.0 > 1000 && all.1 > 1000, "{all:?}");
    assert_eq!(known_here(&run(1000.0, 2 * NUM)), all);
    // Half of the time: the first submaps have gone, and at the end all of them.
    let (early, late) = (run(30.0, NUM + 8), run(30.0, 2 * NUM));
    assert!(
        known_here(&early).0 > 0 && known_here(&late) == (0, 0),
        "{:?} {:?}",
        known_here(&early),
        known_here(&late)
    );
    assert!(early.layers().version < late.layers().version);
    let since = early.layers().version;
    let tile = |key: (i32, i32)| (-2..2).contains(&key.0) && (-2..2).contains(&key.1);
    assert!(late.layers().occupancy.changed_since(since).any(tile), "that it has gone is a change");
    // Places stay.
    assert_eq!(late.keyframes().len(), 2 * NUM);
    let wrong = MapParams { time_to_live_s: -1.0, ..MapParams::default() };
    assert!(matches!(Map::new(wrong), Err(MappingError::InvalidParam { field: "time_to_live_s", .. })));
}
