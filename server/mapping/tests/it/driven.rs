//! What moved, and where the robot drove: what stood there has gone.

use crate::map::id;
use crate::scans::{Block, seen, spatial};
use nalgebra::{Point2, UnitQuaternion, Vector3};
use percept_geometry::{Correction, KeyframeScan, Pose, se3};
use percept_mapping::{Map, MapEntry, MapParams};
use std::sync::Arc;

/// Who stood in the way, once.
const SOMEONE: Block = ([1.83, -0.2, 0.0], [2.23, 0.2, 0.4]);

/// A scan that shows nothing around the robot: of someone who has left no beam says so.
fn blind(height: f64) -> KeyframeScan {
    spatial(height, vec![])
}

fn along(x: f64) -> Pose {
    se3::from_xy_yaw(x, 0.0, 0.0)
}

fn map(params: MapParams, keyframes: &[(Pose, KeyframeScan)]) -> Map {
    let mut map = Map::new(params).unwrap();
    for (i, (t, scan)) in keyframes.iter().enumerate() {
        map.insert(id(i), &MapEntry::at(*t), Arc::new(scan.clone())).unwrap();
    }
    map
}

/// Whether a path would count the place as an obstacle; none if nothing is known of it.
fn stands(map: &Map, x: f64, y: f64) -> Option<bool> {
    map.layers().occupancy.log_odds_at(&Point2::new(x, y)).map(|v| v > 0.405)
}

/// Seen twice from the beginning, then driven over in steps.
fn passed(block: Block, steps: &[f64], height: f64) -> Vec<(Pose, KeyframeScan)> {
    let looks = [0.0, 0.1].map(|x| (along(x), seen(&along(x), &[block])));
    looks.into_iter().chain(steps.iter().map(|x| (along(*x), blind(height)))).collect()
}

#[test]
fn where_the_robot_drove_nothing_stands_any_more() {
    let keyframes = passed(SOMEONE, &[1.0, 1.7, 2.4, 3.1], 0.5);
    let before = map(MapParams::default(), &keyframes[..2]);
    assert_eq!(stands(&before, 1.85, 0.05), Some(true));
    let after = map(MapParams::default(), &keyframes);
    // Between two keyframes as well as at one.
    for x in [1.75, 1.85, 1.95, 2.05, 2.15] {
        assert!(stands(&after, x, 0.05) != Some(true), "{x}");
    }
    let mut off = MapParams::default();
    off.occupancy.footprint_radius_m = 0.0;
    assert_eq!(stands(&map(off, &keyframes), 1.85, 0.05), Some(true));
}

#[test]
fn who_comes_to_stand_there_later_is_an_obstacle_once_seen_twice() {
    let mut keyframes = passed(SOMEONE, &[1.0, 1.7, 2.4, 3.1, 3.8], 0.5);
    let back = |x: f64| {
        let t = se3::from_xy_yaw(x, 0.0, 0.2);
        (t, seen(&t, &[SOMEONE]))
    };
    keyframes.extend([back(3.9), back(4.0)]);
    assert_eq!(stands(&map(MapParams::default(), &keyframes), 2.25, 0.05), Some(true));
}

#[test]
fn what_hangs_above_the_body_stays() {
    let board: Block = ([1.83, -0.2, 0.55], [2.2, 0.2, 0.75]);
    let after = map(MapParams::default(), &passed(board, &[1.0, 1.7, 2.4, 3.1], 0.3));
    assert_eq!(stands(&after, 1.85, 0.05), Some(true));
}

#[test]
fn what_is_held_in_a_hand_drives_nowhere() {
    let held =
        |x: f64| along(x) * Pose::from_parts(Vector3::zeros().into(), UnitQuaternion::from_euler_angles(0.0, 0.4, 0.0));
    let mut keyframes = passed(SOMEONE, &[], 0.5);
    keyframes.extend([1.0, 1.7, 2.4, 3.1].map(|x| (held(x), blind(0.5))));
    assert_eq!(stands(&map(MapParams::default(), &keyframes), 1.85, 0.05), Some(true));
}

#[test]
fn a_way_that_nothing_measured_is_none() {
    // From before it to behind it, farther than a scan lies from the next; and not tied to each other.
    for (steps, after_gap) in [([0.2, 6.0], false), ([1.2, 2.8], true)] {
        let mut map = Map::new(MapParams::default()).unwrap();
        for (i, (t, scan)) in passed(SOMEONE, &steps, 0.5).into_iter().enumerate() {
            let entry = MapEntry { after_gap: after_gap && i == 3, ..MapEntry::at(t) };
            map.insert(id(i), &entry, Arc::new(scan)).unwrap();
        }
        assert_eq!(stands(&map, 1.85, 0.05), Some(true), "{steps:?}");
    }
}

#[test]
fn a_map_that_was_corrected_or_restored_knows_the_way_that_was_driven() {
    // Several submaps; odometry drifts, and every fourth keyframe is taken out.
    let x = |i: usize| 0.3 * i as f64;
    let scans: Vec<Arc<KeyframeScan>> =
        (0..40).map(|i| Arc::new(if i < 2 { seen(&along(x(i)), &[SOMEONE]) } else { blind(0.5) })).collect();
    let odom = |i: usize| along(x(i)) * se3::from_xy_yaw(0.0, 0.002 * i as f64, 0.0005 * i as f64);
    let entry = |i: usize, t_map_base: Pose| MapEntry { t_map_base, t_odom_base: odom(i), after_gap: false };
    let is_gone = |i: usize| i % 4 == 3;
    let mut map = Map::new(MapParams::default()).unwrap();
    (0..40).for_each(|i| map.insert(id(i), &entry(i, odom(i)), Arc::clone(&scans[i])).unwrap());
    let corrected = Correction { t_map_base: (0..40).map(|i| (id(i), along(x(i)))).collect() };
    map.correct(&corrected, &(0..40).filter(|i| is_gone(*i)).map(id).collect::<Vec<_>>()).unwrap();
    while !map.advance(usize::MAX) {}
    let mut restored = Map::new(MapParams::default()).unwrap();
    for (i, scan) in scans.iter().enumerate() {
        let entry = entry(i, along(x(i)));
        if is_gone(i) {
            restored.skip(&entry);
        } else {
            restored.insert(id(i), &entry, Arc::clone(scan)).unwrap();
        }
    }
    assert_eq!(map.layers().occupancy, restored.layers().occupancy);
    assert!([1.75, 1.85, 1.95, 2.05, 2.15].iter().all(|x| stands(&map, *x, 0.05) != Some(true)));
}

#[test]
fn what_left_behind_an_obstacle_is_gone_once_beams_go_on_over_that() {
    let low: Block = ([3.03, -1.0, 0.0], [3.43, 1.0, 0.3]);
    let gone: Block = ([5.03, -0.5, 0.0], [5.43, 0.5, 0.9]);
    // Turning a little, so that each keyframe has other beams.
    let look = |i: usize, blocks: &[Block]| {
        let t = se3::from_xy_yaw(0.01 * i as f64, 0.0, 0.003 * i as f64);
        (t, seen(&t, blocks))
    };
    let mut keyframes = vec![look(0, &[low, gone]), look(1, &[low, gone])];
    let before = map(MapParams::default(), &keyframes);
    assert_eq!((stands(&before, 5.05, 0.05), stands(&before, 3.05, 0.05)), (Some(true), Some(true)));
    keyframes.extend((2..6).map(|i| look(i, &[low])));
    let after = map(MapParams::default(), &keyframes);
    assert_eq!((stands(&after, 5.05, 0.05), stands(&after, 3.05, 0.05)), (Some(false), Some(true)));
    // Ground that nothing stood on stays unknown.
    assert_eq!(stands(&after, 4.45, 0.05), None);
}
