//! What has gone leaves the map, and what has come enters it, though the robot stands: it makes keyframes as long as the map is wrong.

use crate::live::{Robot, Room, at};
use percept_geometry::SensorKind;
use percept_mapping::LiveParams;
use percept_pipeline::PipelineParams;

const KINDS: [SensorKind; 3] = [SensorKind::Lidar2d, SensorKind::Lidar3d, SensorKind::Depth];
/// The near side of the pillar.
const PLACE: (f64, f64) = (1.78, 0.03);

/// Two pillars far off, so that a camera sees more than a wall.
const STAYS: [(f64, f64, f64); 2] = [(3.4, 1.3, 0.3), (3.0, -1.5, 0.25)];

fn empty() -> Room {
    Room(STAYS.to_vec())
}

/// With a third one.
fn with(pillar: (f64, f64, f64)) -> Room {
    Room([&STAYS[..], &[pillar]].concat())
}

fn pillar() -> Room {
    with((2.0, 0.0, 0.25))
}

/// A robot that has looked at the pillar while it came to where it stands, so that the map is as sure of it as can be.
fn arrived(kind: SensorKind) -> Robot {
    let mut robot = Robot::new(kind, PipelineParams::default());
    (0..=100).for_each(|i| robot.sees(&pillar(), -2.0 + 0.02 * f64::from(i)));
    robot
}

/// The pillar's near side as the robot, which began 2 m before, has it in the map.
fn in_map(snapshot: &percept_pipeline::Snapshot) -> f64 {
    at(snapshot, PLACE.0 + 2.0, PLACE.1).0
}

#[test]
fn what_has_gone_is_out_of_the_map_within_three_seconds_though_the_robot_stands() {
    for kind in KINDS {
        let mut robot = arrived(kind);
        // Thirty looks from the same place make the map as sure as it gets.
        let before = robot.stands(&pillar(), 30);
        assert!(in_map(&before) > 0.8, "{kind:?}: {}", in_map(&before));
        let after = robot.stands(&empty(), 30);
        assert!(in_map(&after) < 0.5, "{kind:?}: {}", in_map(&after));
        // Once it is right it is left alone.
        let later = robot.stands(&empty(), 100);
        assert!(later.keyframes.len() <= after.keyframes.len() + 2, "{kind:?}");
        assert!(later.keyframes.len() <= before.keyframes.len() + 12, "{kind:?}");
    }
}

#[test]
fn what_has_come_to_stay_is_in_the_map_within_ten_seconds_and_goes_again() {
    for kind in KINDS {
        let mut robot = Robot::new(kind, PipelineParams::default());
        robot.stands(&empty(), 20);
        let there = robot.stands(&pillar(), 100);
        assert!(at(&there, PLACE.0, PLACE.1).0 > 0.5, "{kind:?}: {:?}", at(&there, PLACE.0, PLACE.1));
        let gone = robot.stands(&empty(), 30);
        assert!(at(&gone, PLACE.0, PLACE.1).0 < 0.5, "{kind:?}: {:?}", at(&gone, PLACE.0, PLACE.1));
    }
}

#[test]
fn who_walks_by_makes_no_keyframes_and_leaves_nothing() {
    for kind in KINDS {
        let mut robot = Robot::new(kind, PipelineParams::default());
        let before = robot.stands(&empty(), 20);
        // Three times to and fro at 1 m/s.
        for i in 0..240 {
            let y = 2.0 - (f64::from(i) * 0.1 - 8.0 * (f64::from(i) / 80.0).floor() - 4.0).abs();
            robot.sees(&with((2.0, y, 0.25)), 0.0);
        }
        let after = robot.stands(&empty(), 10);
        assert_eq!(after.keyframes.len(), before.keyframes.len(), "{kind:?}");
    }
}

#[test]
fn a_robot_that_plans_on_the_map_alone_takes_no_second_looks() {
    let live = LiveParams { time_s: 0.0, ..LiveParams::default() };
    let mut robot = Robot::new(SensorKind::Lidar3d, PipelineParams { live, ..PipelineParams::default() });
    let before = robot.stands(&pillar(), 20);
    let after = robot.stands(&empty(), 40);
    assert_eq!(after.keyframes.len(), before.keyframes.len());
}

#[test]
fn a_room_that_is_furnished_anew_all_day_does_not_fill_the_map_with_keyframes() {
    let mut robot = Robot::new(SensorKind::Lidar2d, PipelineParams::default());
    for _ in 0..60 {
        robot.stands(&pillar(), 80);
        robot.stands(&empty(), 40);
    }
    let living = robot.stands(&empty(), 1).keyframes.iter().filter(|k| k.merged.is_none()).count();
    assert!(living < 400, "{living}");
}
