//! Rooms that look alike, one of which the map does not know: a robot that is in it may be said to be in the other for as long as it stays,
//! and no longer; and nothing of the map is changed meanwhile.

use nalgebra::{Point2, Vector2};
use percept_geometry::sensor::OdometrySample;
use percept_geometry::{LaserScan, Pose, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Timestamp, se3};
use percept_mapping::Occupancy as _;
use percept_mapping::given::{GivenOptions, views_of_grid};
use percept_pipeline::{Pipeline, PipelineParams};
use std::f64::consts::{PI, TAU};

const BEAMS: usize = 360;
const RANGE_M: f64 = 20.0;

/// Walls in the plane, metres.
#[derive(Clone, Default)]
struct Plan(Vec<(Point2<f64>, Vector2<f64>)>);

impl Plan {
    fn wall(&mut self, x0: f64, y0: f64, x1: f64, y1: f64) {
        self.0.push((Point2::new(x0, y0), Vector2::new(x1 - x0, y1 - y0)));
    }

    fn thing(&mut self, x0: f64, y0: f64, x1: f64, y1: f64) {
        self.wall(x0, y0, x1, y0);
        self.wall(x1, y0, x1, y1);
        self.wall(x1, y1, x0, y1);
        self.wall(x0, y1, x0, y0);
    }

    /// Four rooms of 6 m at a corridor: the first and the third are alike, the others are not.
    fn of_rooms(is_third_shut: bool) -> Self {
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

    /// What a planar lidar sees there, with a centimetre of noise.
    fn scan(&self, (x, y, yaw): (f64, f64, f64), number: usize) -> LaserScan {
        let step = TAU / BEAMS as f64;
        let range = |i: usize| {
            // A few steps of a generator are noise enough, and the same each time.
            let hash = (number * BEAMS + i).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
            let noise = (hash as f64 / f64::from(1 << 24) - 0.5) * 0.035;
            let range = self.range(&Point2::new(x, y), yaw - PI + i as f64 * step) + noise;
            if range < RANGE_M { range as f32 } else { f32::INFINITY }
        };
        LaserScan {
            angle_min_rad: -PI,
            angle_increment_rad: step,
            range_min_m: 0.05,
            range_max_m: RANGE_M,
            time_increment_s: 0.0,
            ranges_m: (0..BEAMS).map(range).collect(),
            intensities: None,
            later_echoes_m: vec![],
        }
    }
}

/// A drive from place to place, half a metre a second, ten poses a second.
fn drive(stations: &[(f64, f64)]) -> Vec<(f64, f64, f64)> {
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
fn tour(rooms: &[usize]) -> Vec<(f64, f64, f64)> {
    let of_room = |k: &usize| {
        let x = 6.0 * *k as f64 + 3.0;
        [(x, 1.0), (x, 3.0), (x - 0.3, 4.5), (x, 3.0), (x, 1.0)]
    };
    let mut stations = vec![(1.0, 1.0)];
    stations.extend(rooms.iter().flat_map(of_room));
    stations.extend([(23.0, 1.0), (1.0, 1.0)]);
    drive(&stations)
}

fn laser() -> SensorSpec {
    SensorSpec {
        id: SensorId::from("laser"),
        kind: SensorKind::Lidar2d,
        t_base_sensor: Pose::translation(0.0, 0.0, 0.3),
        intrinsics: None,
        time_offset_s: 0.0,
        range_max_m: None,
    }
}

fn frames<'a>(plan: &'a Plan, way: &'a [(f64, f64, f64)]) -> impl Iterator<Item = SensorFrame> + 'a {
    way.iter().enumerate().map(|(i, at)| SensorFrame {
        sensor: SensorId::from("laser"),
        stamp: Timestamp::from_nanos(1_000_000_000 + 100_000_000 * i as i64),
        data: SensorData::Scan(plan.scan(*at, i)),
    })
}

fn pipeline() -> Pipeline {
    let mut pipeline = Pipeline::new(PipelineParams::default()).unwrap();
    pipeline.declare_sensor(laser());
    pipeline
}

/// A session that begins with the map of a tour of `rooms`; base to the tour's map at its first frame is the identity.
fn with_map_of(rooms: &[usize], plan: &Plan) -> (Pipeline, Pose) {
    let way = tour(rooms);
    let mut first = pipeline();
    frames(plan, &way).for_each(|f| drop(first.process(&f).unwrap()));
    first.settle();
    let grid = first.snapshot().layers.occupancy.dense(usize::MAX).unwrap();
    let views = views_of_grid(&grid, &GivenOptions { range_max_m: RANGE_M, sensor_height_m: 0.3 }).unwrap().views;
    let mut second = pipeline();
    second.take_given(views, None).unwrap();
    let (x, y, yaw) = way[0];
    (second, se3::from_xy_yaw(x, y, yaw))
}

/// What is said of each frame: how far off, metres, none where it is lost; and the keyframes that there are then.
fn errors(
    pipeline: &mut Pipeline,
    t_world_map: &Pose,
    plan: &Plan,
    way: &[(f64, f64, f64)],
) -> Vec<(Option<f64>, usize)> {
    let told = frames(plan, way).zip(way).map(|(frame, (x, y, _))| {
        let pose = pipeline.process(&frame).unwrap().pose.unwrap();
        let at = (t_world_map * pose.t_map_base).translation.vector;
        let off = pose.state.is_tracking().then(|| (at.x - x).hypot(at.y - y));
        (off, pipeline.snapshot().keyframes.len())
    });
    told.collect()
}

#[test]
fn a_robot_in_a_room_that_is_not_mapped_is_not_kept_in_the_one_that_looks_like_it_and_draws_nothing_there() {
    let (mut pipeline, t_world_map) = with_map_of(&[0, 1, 3], &Plan::of_rooms(true));
    let plan = Plan::of_rooms(false);
    // To and fro in the third room, out into the corridor, into the fourth one, the second and the first.
    let mut stations = vec![(15.0, 3.0), (14.7, 4.5), (15.0, 3.0), (14.7, 4.5), (15.0, 3.0), (15.0, 1.0)];
    stations.extend([
        (20.0, 1.0),
        (21.0, 3.0),
        (21.0, 1.0),
        (9.0, 1.0),
        (9.0, 4.0),
        (9.0, 1.0),
        (3.0, 1.0),
        (3.0, 4.0),
    ]);
    let way = drive(&stations);
    let given = pipeline.snapshot().keyframes.len();
    let (told, keyframes): (Vec<_>, Vec<_>) = errors(&mut pipeline, &t_world_map, &plan, &way).into_iter().unzip();
    let is_wrong = |e: &Option<f64>| e.is_some_and(|e| e > 0.5);
    let last_wrong = told.iter().rposition(is_wrong).map_or(0, |i| i + 1);
    // It is known before the fourth room is left again.
    let (_, y, _) = way[last_wrong];
    assert!(last_wrong < 420 && y < 8.0, "wrong until frame {last_wrong}");
    assert!(told.iter().skip(last_wrong).flatten().all(|e| *e < 0.15));
    assert!(told.last().unwrap().is_some(), "it is found in the end");
    assert!(told.iter().filter(|e| e.is_some() && !is_wrong(e)).count() > 200);
    assert!(keyframes[..=last_wrong].iter().all(|n| *n == given), "it has drawn where it was not");
    assert!(keyframes.last().is_some_and(|n| *n > given), "it maps once it is certain");
}

#[test]
fn a_robot_that_wakes_where_nobody_has_mapped_is_found_soon_after_it_comes_into_the_map() {
    // The fourth room and its end of the corridor are known, and the first one; not the third, where it wakes.
    let (mut pipeline, t_world_map) = with_map_of(&[0, 3], &Plan::of_rooms(true));
    let plan = Plan::of_rooms(false);
    let way = drive(&[(15.0, 3.0), (14.7, 4.5), (13.2, 5.5), (15.0, 3.0), (15.0, 1.0), (20.0, 1.0), (21.0, 3.0)]);
    let told = errors(&mut pipeline, &t_world_map, &plan, &way);
    let right = |(e, _): &(Option<f64>, usize)| e.is_some_and(|e| e < 0.15);
    let out_of_the_room = way.iter().position(|at| at.1 < 1.05).unwrap();
    let found = told.iter().rposition(|e| !right(e)).map_or(0, |i| i + 1);
    assert!(found < out_of_the_room + 120, "{found} after {out_of_the_room}");
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
    let wheels = SensorSpec { id: SensorId::from("wheels"), kind: SensorKind::Odometry, ..laser() };
    let mut pipeline = pipeline();
    pipeline.declare_sensor(wheels.clone());
    let (x0, y0, yaw0) = way[0];
    let t_map_world = se3::from_xy_yaw(x0, y0, yaw0).inverse();
    // Through the first two rooms alone, through the third among people, and back alone.
    let among = 800..1200;
    for (i, at) in way.iter().enumerate() {
        let seen = if among.contains(&i) { among_people(&plan, *at) } else { plan.clone() };
        let stamp = Timestamp::from_nanos(1_000_000_000 + 100_000_000 * i as i64);
        // The wheels' frame is their own, and they are 3 % off.
        let sample = OdometrySample { t_odom_base: se3::from_xy_yaw(1.03 * at.0, 1.03 * at.1, at.2), covariance: None };
        let told = SensorFrame { sensor: wheels.id.clone(), stamp, data: SensorData::Odometry(sample) };
        pipeline.process(&told).unwrap();
        let frame = SensorFrame { sensor: laser().id, stamp, data: SensorData::Scan(seen.scan(*at, i)) };
        let pose = pipeline.process(&frame).unwrap().pose.unwrap();
        let truth = (t_map_world * se3::from_xy_yaw(at.0, at.1, at.2)).translation.vector;
        let off = (truth - pose.t_map_base.translation.vector).xy().norm();
        let most = if pose.state.is_tracking() { 0.3 } else { 1.2 };
        assert!(off < most, "{i}: {off} m off, {:?}", pose.state);
    }
    assert!(pipeline.snapshot().wheels_faults.is_empty());
    assert!(pipeline.snapshot().pose.unwrap().state.is_tracking());
}
