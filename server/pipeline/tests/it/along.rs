//! People who walk along with a robot, what it tows, and parts of its own in its lidar's view: surroundings that stand still as it drives.

use crate::plan::{Plan, RANGE_M, drive, laser, pipeline, tour};
use percept_geometry::sensor::OdometrySample;
use percept_geometry::{Pose, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Timestamp, se3};
use percept_pipeline::{Pipeline, PoseEstimate};
use std::f64::consts::TAU;

/// A robot with a planar lidar and wheels that are some percent off.
struct Robot {
    pipeline: Pipeline,
    range_max_m: f64,
    wheels_scale: f64,
    t_map_world: Pose,
    num_scans: usize,
}

impl Robot {
    /// At the beginning of its way.
    fn at((x, y, yaw): (f64, f64, f64), range_max_m: f64, wheels_scale: f64) -> Self {
        let mut pipeline = pipeline();
        pipeline.declare_sensor(SensorSpec { id: SensorId::from("wheels"), kind: SensorKind::Odometry, ..laser() });
        let t_map_world = se3::from_xy_yaw(x, y, yaw).inverse();
        Self { pipeline, range_max_m, wheels_scale, t_map_world, num_scans: 0 }
    }

    /// Scans `plan`; how far off it is told to be, metres.
    fn see(&mut self, plan: &Plan, at: (f64, f64, f64)) -> (f64, PoseEstimate) {
        self.see_while_wheels_tell(plan, at, at)
    }

    /// As [`Self::see`], with wheels that believe to be elsewhere.
    fn see_while_wheels_tell(
        &mut self,
        plan: &Plan,
        at: (f64, f64, f64),
        told: (f64, f64, f64),
    ) -> (f64, PoseEstimate) {
        let number = self.num_scans;
        self.num_scans += 1;
        let stamp = Timestamp::from_nanos(1_000_000_000 + 100_000_000 * number as i64);
        let (x, y, yaw) = at;
        // The wheels' frame is their own.
        let t_odom_base = se3::from_xy_yaw(self.wheels_scale * told.0, self.wheels_scale * told.1, told.2);
        let told = SensorData::Odometry(OdometrySample { t_odom_base, covariance: None });
        self.pipeline.process(&SensorFrame { sensor: SensorId::from("wheels"), stamp, data: told }).unwrap();
        let scan = SensorData::Scan(plan.scan_within(self.range_max_m, at, number));
        let pose = self.pipeline.process(&SensorFrame { sensor: laser().id, stamp, data: scan }).unwrap().pose.unwrap();
        let truth = (self.t_map_world * se3::from_xy_yaw(x, y, yaw)).translation.vector;
        ((truth - pose.t_map_base.translation.vector).xy().norm(), pose)
    }
}

/// Nine people walk around the robot, four fifths of what it would see behind them.
fn among_people(plan: &Plan, (x, y, _): (f64, f64, f64)) -> Plan {
    let mut plan = plan.clone();
    for k in 0..9 {
        let angle = TAU * f64::from(k) / 9.0;
        let (px, py) = (x + 0.8 * angle.cos(), y + 0.8 * angle.sin());
        plan.thing(px - 0.22, py - 0.22, px + 0.22, py + 0.22);
    }
    plan
}

#[test]
fn wheels_lead_while_people_who_walk_along_hide_the_surroundings() {
    let plan = Plan::of_rooms(false);
    let way = tour(&[0, 1, 2, 3]);
    let mut robot = Robot::at(way[0], RANGE_M, 1.03);
    // Through the first two rooms alone, through the third among people, and back alone.
    let among = 800..1200;
    for (i, at) in way.iter().enumerate() {
        let seen = if among.contains(&i) { among_people(&plan, *at) } else { plan.clone() };
        let (off, pose) = robot.see(&seen, *at);
        let most = if pose.state.is_tracking() { 0.3 } else { 1.2 };
        assert!(off < most, "{i}: {off} m off, {:?}", pose.state);
    }
    assert!(robot.pipeline.snapshot().wheels_faults.is_empty());
    assert!(robot.pipeline.snapshot().pose.unwrap().state.is_tracking());
}

/// What comes along: of what size, metres, at what place in base, by the number of the scan.
type Companion = fn(usize) -> (f64, (f64, f64));

/// Something that comes along, seen around the robot.
fn beside(plan: &Plan, (x, y, yaw): (f64, f64, f64), (size, (ahead, left)): (f64, (f64, f64))) -> Plan {
    let (px, py) = (x + ahead * yaw.cos() - left * yaw.sin(), y + ahead * yaw.sin() + left * yaw.cos());
    let half = 0.5 * size;
    let mut plan = plan.clone();
    plan.thing(px - half, py - half, px + half, py + half);
    plan
}

#[test]
fn what_comes_along_in_a_corridor_does_not_take_the_pose_along() {
    let cases: [(&str, Companion); 5] = [
        ("follows", |_| (0.44, (-0.8, 0.0))),
        ("follows unevenly", |i| (0.44, (-0.8 + 0.15 * (0.1 * i as f64).sin(), 0.1 * (0.07 * i as f64).sin()))),
        ("leads", |_| (0.44, (1.0, 0.1))),
        ("is towed", |_| (0.8, (-1.2, 0.0))),
        ("is its own", |_| (0.06, (-0.2, 0.15))),
    ];
    let plan = Plan::of_corridor();
    let way = drive(&[(1.0, 1.0), (57.0, 1.0), (3.0, 1.0)]);
    for (name, companion) in cases {
        for (from, wheels_scale) in [(0, 1.01), (200, 1.03)] {
            let mut robot = Robot::at(way[0], 8.0, wheels_scale);
            for (i, at) in way.iter().enumerate() {
                let comes_along = (from..1600).contains(&i);
                let seen = if comes_along { beside(&plan, *at, companion(i)) } else { plan.clone() };
                let (off, pose) = robot.see(&seen, *at);
                // It is known by the way of half a metre.
                assert!(!pose.state.is_lost() && off < 0.6, "{name} from {from}, {i}: {off} m off, {:?}", pose.state);
            }
            assert!(robot.pipeline.snapshot().wheels_faults.is_empty(), "{name} from {from}");
        }
    }
}

#[test]
fn who_follows_between_pillars_before_walls_does_not_take_the_pose_along() {
    let mut plan = Plan::default();
    plan.thing(-6.0, -4.0, 32.0, 4.0);
    for k in 0..16 {
        let x = -3.0 + 2.0 * f64::from(k);
        plan.thing(x - 0.15, 1.05, x + 0.15, 1.35);
        plan.thing(x - 0.15, -1.35, x + 0.15, -1.05);
    }
    let way = drive(&[(0.0, 0.0), (24.0, 0.0)]);
    let mut robot = Robot::at(way[0], 10.0, 1.03);
    let mut worst = 0f64;
    for at in &way {
        let (off, _) = robot.see(&beside(&plan, *at, (0.4, (-0.8, 0.0))), *at);
        worst = worst.max(off);
    }
    assert!(worst < 0.3, "{worst} m off");
}

#[test]
fn a_robot_whose_wheels_spin_stays_where_it_is() {
    for (place, x) in [("at a wall", 20.0), ("at doors", 22.0), ("beside somebody", 20.0)] {
        let mut plan = Plan::of_corridor();
        if place == "beside somebody" {
            plan.thing(19.0, 0.4, 19.4, 0.8);
        }
        let way = drive(&[(1.0, 1.0), (x, 1.0)]);
        let mut robot = Robot::at(way[0], 8.0, 1.0);
        way.iter().for_each(|at| drop(robot.see(&plan, *at)));
        for k in 1..=80 {
            let told = (x + 0.05 * f64::from(k), 1.0, 0.0);
            let (off, pose) = robot.see_while_wheels_tell(&plan, (x, 1.0, 0.0), told);
            assert!(pose.state.is_tracking() && off < 0.1, "{place}, {k}: {off} m off, {:?}", pose.state);
        }
    }
}
