//! Worlds of walls in the plane, for planar lidars that are moved through them.

use nalgebra::{Point2, Vector2};
use percept_geometry::{LaserScan, Pose, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Timestamp};
use percept_pipeline::{Pipeline, PipelineParams};
use std::f64::consts::{PI, TAU};

const BEAMS: usize = 360;
pub(crate) const RANGE_M: f64 = 20.0;

/// Walls in the plane, metres.
#[derive(Clone, Default)]
pub(crate) struct Plan(Vec<(Point2<f64>, Vector2<f64>)>);

impl Plan {
    pub(crate) fn wall(&mut self, x0: f64, y0: f64, x1: f64, y1: f64) {
        self.0.push((Point2::new(x0, y0), Vector2::new(x1 - x0, y1 - y0)));
    }

    pub(crate) fn thing(&mut self, x0: f64, y0: f64, x1: f64, y1: f64) {
        self.wall(x0, y0, x1, y0);
        self.wall(x1, y0, x1, y1);
        self.wall(x1, y1, x0, y1);
        self.wall(x0, y1, x0, y0);
    }

    /// Four rooms of 6 m at a corridor: the first and the third are alike, the others are not.
    pub(crate) fn of_rooms(is_third_shut: bool) -> Self {
        let mut plan = Self::default();
        plan.thing(0.0, 0.0, 24.0, 8.0);
        for k in 0..4 {
            let x = 6.0 * f64::from(k);
            if is_third_shut && k == 2 {
                plan.wall(x, 2.0, x + 6.0, 2.0);
            } else {
                plan.wall(x, 2.0, x + 2.5, 2.0);
                plan.wall(x + 3.5, 2.0, x + 6.0, 2.0);
            }
            plan.wall(x, 2.0, x, 8.0);
            match k {
                0 | 2 => {
                    plan.thing(x + 1.0, 6.0, x + 2.0, 7.5);
                    plan.thing(x + 4.0, 4.0, x + 5.0, 6.5);
                    plan.thing(x + 0.5, 3.0, x + 1.0, 4.0);
                }
                1 => {
                    plan.thing(x + 2.0, 5.0, x + 4.0, 6.2);
                    plan.thing(x + 5.0, 2.5, x + 5.5, 4.0);
                }
                _ => {
                    plan.thing(x + 0.2, 2.2, x + 1.4, 3.4);
                    plan.thing(x + 2.2, 7.0, x + 4.4, 7.8);
                    plan.thing(x + 5.0, 5.0, x + 5.8, 7.6);
                }
            }
        }
        plan
    }

    /// Where a beam ends, metres.
    fn range(&self, from: &Point2<f64>, angle: f64) -> f64 {
        let d = Vector2::new(angle.cos(), angle.sin());
        let ends = self.0.iter().filter_map(|(a, e)| {
            let den = d.perp(e);
            let (t, u) = ((a - from).perp(e) / den, (a - from).perp(&d) / den);
            (t > 1e-6 && (0.0..=1.0).contains(&u)).then_some(t)
        });
        ends.fold(f64::INFINITY, f64::min)
    }

    /// A corridor of 60 m by 2 m with a door every 6 m to each side, and empty rooms behind them.
    pub(crate) fn of_corridor() -> Self {
        let mut plan = Self::default();
        plan.thing(0.0, -5.0, 60.0, 7.0);
        for k in 0..10 {
            let x = 6.0 * f64::from(k);
            for (y, behind, door) in [(0.0, -5.0, 1.5), (2.0, 7.0, 3.2)] {
                plan.wall(x, y, x + door, y);
                plan.wall(x + door + 0.9, y, x + 6.0, y);
                plan.wall(x, y, x, behind);
            }
        }
        plan
    }

    /// What a planar lidar that sees 20 m far sees there, with a centimetre of noise.
    pub(crate) fn scan(&self, at: (f64, f64, f64), number: usize) -> LaserScan {
        self.scan_within(RANGE_M, at, number)
    }

    /// As [`Self::scan`], as far as `range_max_m`.
    pub(crate) fn scan_within(&self, range_max_m: f64, (x, y, yaw): (f64, f64, f64), number: usize) -> LaserScan {
        let step = TAU / BEAMS as f64;
        let range = |i: usize| {
            // A few steps of a generator are noise enough, and the same each time.
            let hash = (number * BEAMS + i).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
            let noise = (hash as f64 / f64::from(1 << 24) - 0.5) * 0.035;
            let range = self.range(&Point2::new(x, y), yaw - PI + i as f64 * step) + noise;
            if range < range_max_m { range as f32 } else { f32::INFINITY }
        };
        LaserScan {
            angle_min_rad: -PI,
            angle_increment_rad: step,
            range_min_m: 0.05,
            range_max_m,
            time_increment_s: 0.0,
            ranges_m: (0..BEAMS).map(range).collect(),
            intensities: None,
            later_echoes_m: vec![],
        }
    }
}

/// A drive from place to place, half a metre a second, ten poses a second.
pub(crate) fn drive(stations: &[(f64, f64)]) -> Vec<(f64, f64, f64)> {
    let (mut out, mut yaw) = (vec![], None);
    for pair in stations.windows(2) {
        let way = Vector2::new(pair[1].0 - pair[0].0, pair[1].1 - pair[0].1);
        let wanted = way.y.atan2(way.x);
        let from: f64 = yaw.unwrap_or(wanted);
        let turn = (wanted - from + PI).rem_euclid(TAU) - PI;
        let turns = (turn.abs() / 0.1).ceil() as usize;
        out.extend((1..=turns).map(|k| (pair[0].0, pair[0].1, from + turn * k as f64 / turns as f64)));
        let steps = (way.norm() / 0.05).ceil() as usize;
        let at = |k: usize| k as f64 / steps as f64;
        out.extend((1..=steps).map(|k| (pair[0].0 + way.x * at(k), pair[0].1 + way.y * at(k), wanted)));
        yaw = Some(wanted);
    }
    out
}

/// In and out of these rooms, along the corridor and back.
pub(crate) fn tour(rooms: &[usize]) -> Vec<(f64, f64, f64)> {
    let of_room = |k: &usize| {
        let x = 6.0 * *k as f64 + 3.0;
        [(x, 1.0), (x, 3.0), (x - 0.3, 4.5), (x, 3.0), (x, 1.0)]
    };
    let mut stations = vec![(1.0, 1.0)];
    stations.extend(rooms.iter().flat_map(of_room));
    stations.extend([(23.0, 1.0), (1.0, 1.0)]);
    drive(&stations)
}

pub(crate) fn laser() -> SensorSpec {
    SensorSpec {
        id: SensorId::from("laser"),
        kind: SensorKind::Lidar2d,
        t_base_sensor: Pose::translation(0.0, 0.0, 0.3),
        intrinsics: None,
        time_offset_s: 0.0,
        range_max_m: None,
    }
}

pub(crate) fn frames<'a>(plan: &'a Plan, way: &'a [(f64, f64, f64)]) -> impl Iterator<Item = SensorFrame> + 'a {
    way.iter().enumerate().map(|(i, at)| SensorFrame {
        sensor: SensorId::from("laser"),
        stamp: Timestamp::from_nanos(1_000_000_000 + 100_000_000 * i as i64),
        data: SensorData::Scan(plan.scan(*at, i)),
    })
}

pub(crate) fn pipeline() -> Pipeline {
    let mut pipeline = Pipeline::new(PipelineParams::default()).unwrap();
    pipeline.declare_sensor(laser());
    pipeline
}
