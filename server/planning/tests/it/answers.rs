//! What an answer says beside the path: times, terms of the cost, and what is in the way.

use crate::{drawn, hall, path};
use nalgebra::Point2;
use percept_geometry::{Cell, GridGeometry};
use percept_mapping::DenseGrid;
use percept_planning::{
    Blocking, CellState, Footprint, Goal, HybridParams, Mask, MaskKind, NoPathReason, Path, PathRequest, PathSample,
    PlanError, PlanOutcome, PlanParams, Planner, Pose2, SpeedLimits, Zone, ZoneKind, plan_path, samples_along,
};

fn found(outcome: PlanOutcome) -> Path {
    match outcome {
        PlanOutcome::Path(path) => path,
        other => panic!("{other:?}"),
    }
}

fn refused(outcome: PlanOutcome) -> (NoPathReason, Option<Blocking>) {
    match outcome {
        PlanOutcome::NoPath { reason, blocking } => (reason, blocking),
        other => panic!("{other:?}"),
    }
}

fn rectangle(low: [f64; 2], high: [f64; 2], kind: ZoneKind) -> Zone {
    let polygon = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]];
    Zone { polygon: polygon.map(Point2::from).to_vec(), kind }
}

#[test]
fn a_straight_way_takes_the_time_of_a_trapezoid_or_a_triangle() {
    let (grid, params) = (hall(80, 40), PlanParams::default());
    for (length, speed, accel) in [(4.0, 0.5, 1.0), (4.0, 2.0, 0.5), (0.3, 0.5, 0.25)] {
        let (a, b) = (Point2::new(1.05, 2.05), Point2::new(1.05 + length, 2.05));
        let speed_limits = SpeedLimits { max_speed_mps: speed, max_accel_mps2: accel, max_turn_rate_radps: 1.0 };
        let request = PathRequest { speed: speed_limits, ..PathRequest::new(a, b, &params) };
        let path = found(plan_path(&grid, &request).unwrap());
        // It reaches full speed if v^2/a fits into the length.
        let reaches = speed * speed / accel <= length;
        let wanted = if reaches { length / speed + speed / accel } else { 2.0 * (length / accel).sqrt() };
        assert!((path.duration_s - wanted).abs() < 1e-6, "{length} {speed} {accel}: {} {wanted}", path.duration_s);
        assert!(path.waypoints.windows(2).all(|w| w[0].time_s < w[1].time_s));
        assert_eq!(path.waypoints[path.waypoints.len() - 1].time_s, path.duration_s);
    }
}

#[test]
fn turns_and_changes_of_direction_take_their_time() {
    let (grid, params) = (hall(120, 120), PlanParams::default());
    let steer = |goal: Pose2| {
        let start = Pose2 { position: Point2::new(5.0, 5.0), yaw_rad: 0.0 };
        let footprint = Footprint::rectangle(0.4, 0.4);
        let request = PathRequest {
            start,
            goal: Goal { position: goal.position, yaw_rad: Some(goal.yaw_rad) },
            planner: Planner::Hybrid(HybridParams::default()),
            footprint: Some(&footprint),
            speed: SpeedLimits { max_speed_mps: 1.0, max_accel_mps2: 100.0, max_turn_rate_radps: 0.5 },
            ..PathRequest::new(start.position, goal.position, &params)
        };
        found(plan_path(&grid, &request).unwrap())
    };
    // A quarter turn on the tightest arc, at 0.5 rad/s.
    let quarter = std::f64::consts::FRAC_PI_2;
    let arc = steer(Pose2 { position: Point2::new(5.8, 5.8), yaw_rad: quarter });
    assert!((arc.duration_s - quarter / 0.5).abs() < 0.02, "{}", arc.duration_s);
    let parts = arc.cost_parts;
    assert!((parts.length - 0.8 * quarter).abs() < 1e-6 && (parts.steering - 0.2 * parts.length).abs() < 1e-6);
    assert!((parts.length + parts.clearance + parts.steering - arc.cost).abs() < 1e-9);
    assert!(arc.bound.is_some_and(|b| (1.0..1.6).contains(&b)) && arc.is_final);
    // Backwards a metre counts twice.
    let back = steer(Pose2 { position: Point2::new(4.0, 5.0), yaw_rad: 0.0 });
    assert!((back.length_m - 1.0).abs() < 1e-6 && (back.cost - 2.0).abs() < 1e-6 && back.waypoints[0].is_reverse);
}

#[test]
fn waypoints_know_their_clearance() {
    let found = path(&hall(80, 50), [1.013, 1.027], [6.031, 3.044], &PlanParams::default());
    for waypoint in &found.waypoints {
        let p = waypoint.position;
        let truth = (p.x - 0.1).min(p.y - 0.1).min(7.9 - p.x).min(4.9 - p.y);
        let told = waypoint.clearance_m.unwrap();
        assert!(told <= truth && told >= truth - 0.142, "{told} {truth}");
    }
}

#[test]
fn keep_out_zones_are_walked_around_and_ends_in_them_refused() {
    let (grid, params) = (hall(80, 60), PlanParams::default());
    let zones = [rectangle([3.0, 1.0], [4.0, 5.0], ZoneKind::KeepOut)];
    let ask = |a: [f64; 2], b: [f64; 2]| {
        let request = PathRequest { zones: &zones, ..PathRequest::new(Point2::from(a), Point2::from(b), &params) };
        plan_path(&grid, &request).unwrap()
    };
    for waypoint in found(ask([1.0, 2.0], [6.0, 2.0])).waypoints {
        let p = waypoint.position;
        let off = (3.0 - p.x).max(p.x - 4.0).max(0.0).hypot((1.0 - p.y).max(p.y - 5.0).max(0.0));
        assert!(off >= params.robot_radius_m - 1e-9, "{p}");
    }
    assert_eq!(refused(ask([3.5, 2.0], [6.0, 2.0])).0, NoPathReason::StartInKeepOut);
    assert_eq!(refused(ask([1.0, 2.0], [3.5, 2.0])).0, NoPathReason::GoalInKeepOut);
    let (reason, blocking) = refused(ask([1.0, 2.0], [2.85, 2.0]));
    assert_eq!((reason, blocking.unwrap().state), (NoPathReason::GoalDoesNotFit, CellState::KeepOut));
    // Across the whole hall: nothing leads past it.
    let across = [rectangle([3.0, -1.0], [4.0, 9.0], ZoneKind::KeepOut)];
    let request =
        PathRequest { zones: &across, ..PathRequest::new(Point2::new(1.0, 2.0), Point2::new(6.0, 2.0), &params) };
    let (reason, blocking) = refused(plan_path(&grid, &request).unwrap());
    assert_eq!((reason, blocking.unwrap().state), (NoPathReason::Unreachable, CellState::KeepOut));
}

#[test]
fn masks_are_zones_cell_by_cell() {
    let (grid, params) = (hall(80, 60), PlanParams { clearance_weight: 0.0, ..PlanParams::default() });
    // Cells of 0.5 m, beginning at 3 m: columns 0 and 1 are the zone.
    let values = |value: i8| {
        let cells = (0..6 * 12).map(|i| if i % 6 < 2 && (2..10).contains(&(i / 6)) { value } else { 0 }).collect();
        DenseGrid::new(GridGeometry::new(0.5, Point2::new(3.0, 0.0)), 6, 12, cells).unwrap()
    };
    let (a, b) = (Point2::new(1.05, 3.05), Point2::new(6.05, 3.05));
    let zone = |kind: ZoneKind| [rectangle([3.01, 1.01], [3.99, 4.99], kind)];
    let by_zone =
        |zones: &[Zone]| found(plan_path(&grid, &PathRequest { zones, ..PathRequest::new(a, b, &params) }).unwrap());
    let by_mask = |grid_of: &DenseGrid, kind: MaskKind| {
        let masks = [Mask { grid: grid_of, kind }];
        found(plan_path(&grid, &PathRequest { masks: &masks, ..PathRequest::new(a, b, &params) }).unwrap())
    };
    assert_eq!(by_mask(&values(100), MaskKind::KeepOut), by_zone(&zone(ZoneKind::KeepOut)));
    assert_eq!(by_mask(&values(50), MaskKind::PERCENT), by_zone(&zone(ZoneKind::SpeedLimit { share: 0.5 })));
    assert!(by_mask(&values(50), MaskKind::KeepOut).length_m < 5.01, "below the threshold of an obstacle");
    // Straight through at half the speed: a metre more in cost, and at 0.5 m/s two seconds more, but for the ramps.
    let through = by_mask(&values(50), MaskKind::PERCENT);
    assert!((through.length_m - 5.0).abs() < 0.01 && (through.cost - 6.0).abs() < 0.1, "{}", through.cost);
    assert!((through.duration_s - (10.0 + 2.0 + 0.5)).abs() < 0.7, "{}", through.duration_s);
    // At a tenth the way around is quicker.
    let around = by_mask(&values(10), MaskKind::PERCENT);
    assert!(around.waypoints.iter().any(|w| w.position.y < 1.01 || w.position.y > 4.99));
    // nav2's base and multiplier: 100 - 2 * 25 is half, 100 - 0.1 * 100 is nine tenths, and what is no limit is none.
    let falling = |multiplier| MaskKind::SpeedLimit { base: 100.0, multiplier };
    assert_eq!(by_mask(&values(25), falling(-2.0)), through);
    assert_eq!(falling(-0.1).speed_share(100), Some(0.9));
    assert_eq!([0, 50, 51].map(|value| falling(-2.0).speed_share(value)), [None; 3]);
    assert_eq!(by_mask(&values(60), falling(-2.0)), by_mask(&values(0), MaskKind::PERCENT));
}

#[test]
fn a_path_is_sampled_with_what_holds_along_it() {
    let (grid, params) = (hall(80, 60), PlanParams::default());
    let slow = [rectangle([3.0, -1.0], [5.0, 9.0], ZoneKind::SpeedLimit { share: 0.2 })];
    let (a, b) = (Point2::new(0.55, 3.05), Point2::new(7.05, 3.05));
    let request = PathRequest { zones: &slow, planner: Planner::AnyAngle, ..PathRequest::new(a, b, &params) };
    let path = found(plan_path(&grid, &request).unwrap());
    let poses: Vec<Pose2> = path.waypoints.iter().map(|w| Pose2 { position: w.position, yaw_rad: w.yaw_rad }).collect();
    let samples = samples_along(&grid, &poses, &request).unwrap();
    assert_eq!((samples[0].pose.position, samples[samples.len() - 1].pose.position), (a, b));
    let gap = |s: &[PathSample]| (s[1].pose.position - s[0].pose.position).norm();
    assert!(samples.windows(2).all(|s| gap(s) < 0.11));
    // In the zone a metre takes five times as long, and costs as much; at rest at both ends.
    for s in &samples {
        let x = s.pose.position.x;
        if x > 3.2 && x < 4.8 {
            assert!((s.speed_mps - 0.1).abs() < 1e-6 && (s.cost - 5.0).abs() < 1e-3, "{s:?}");
        } else if !(2.8..5.2).contains(&x) {
            assert!(s.cost < 4.01 && s.speed_mps <= 0.5 + 1e-9, "{s:?}");
        }
        assert!(s.clearance_m.is_some_and(|c| c > 0.22));
    }
    let spent: f64 = samples.windows(2).map(|s| gap(s) / s[0].speed_mps).sum();
    assert!((spent - path.duration_s).abs() < 0.1 * path.duration_s, "{spent} {}", path.duration_s);
    // Nowhere at all, and off the map, nothing is known.
    assert!(samples_along(&grid, &[], &request).unwrap().is_empty());
    let off = [Pose2 { position: Point2::new(-50.0, 0.0), yaw_rad: 0.0 }];
    assert_eq!(samples_along(&grid, &off, &request).unwrap().len(), 1);
    let bad = [Pose2 { position: Point2::new(f64::NAN, 0.0), yaw_rad: 0.0 }];
    assert!(matches!(samples_along(&grid, &bad, &request), Err(PlanError::NotFinite { field: "poses", .. })));
}

#[test]
fn the_first_thing_in_the_way_is_told() {
    let rows = [
        "##############################",
        "#.......#..........?.........#",
        "#.......#..........?.........#",
        "#.......#..........?.........#",
        "#.......#..........?.........#",
        "#.......#..........?.........#",
        "#.......#..........?.........#",
        "#.......#..........?.........#",
        "##############################",
    ];
    let grid = drawn(&rows);
    let params = PlanParams { robot_radius_m: 0.12, ..PlanParams::default() };
    let blocking = |a: [f64; 2], b: [f64; 2]| {
        let outcome = plan_path(&grid, &PathRequest::new(Point2::from(a), Point2::from(b), &params)).unwrap();
        let (reason, blocking) = refused(outcome);
        assert_eq!(reason, NoPathReason::Unreachable);
        let Blocking { position, obstacle, state } = blocking.unwrap();
        // Where it blocks, the robot does not fit; a step of a cell before, it does.
        assert!((position - obstacle).norm() < 0.12 + 0.15, "{position} {obstacle}");
        (grid.geometry.cell(&obstacle).unwrap(), state)
    };
    let (cell, state) = blocking([0.4, 0.4], [1.4, 0.4]);
    assert_eq!((cell.x, state), (8, CellState::Occupied));
    let (cell, state) = blocking([1.4, 0.4], [2.5, 0.4]);
    assert_eq!((cell.x, state), (19, CellState::Unknown));
    // Through both: the first from the start.
    assert_eq!(blocking([0.4, 0.4], [2.5, 0.4]).0.x, 8);
    assert_eq!(blocking([2.5, 0.4], [0.4, 0.4]).0.x, 19);
}

#[test]
fn a_gap_too_narrow_is_what_blocks_where_all_else_is_wall() {
    // A wall three cells thick with a gap of two cells, for a robot that needs four.
    let mut grid = hall(60, 40);
    (0..40).filter(|y| !(30..32).contains(y)).for_each(|y| (29..32).for_each(|x| grid.cells[y * 60 + x] = 100));
    let params = PlanParams { robot_radius_m: 0.2, ..PlanParams::default() };
    let request = PathRequest::new(Point2::new(1.0, 1.0), Point2::new(5.0, 1.0), &params);
    let (reason, blocking) = refused(plan_path(&grid, &request).unwrap());
    assert_eq!(reason, NoPathReason::Unreachable);
    let at = grid.geometry.cell(&blocking.unwrap().obstacle).unwrap();
    assert_eq!(grid.value(Cell::new(at.x, at.y)), Some(Some(100)));
}

#[test]
fn zones_and_speeds_that_make_no_sense_are_refused() {
    let (grid, params) = (hall(50, 50), PlanParams::default());
    let request = PathRequest::new(Point2::new(1.0, 1.0), Point2::new(2.0, 2.0), &params);
    let refuses = |request: &PathRequest<'_>, wanted: &str| match plan_path(&grid, request) {
        Err(PlanError::InvalidParam { field, .. }) => assert_eq!(field, wanted),
        other => panic!("{wanted}: {other:?}"),
    };
    for share in [0.0, -1.0, 1.1, f64::NAN] {
        let zones = [rectangle([0.0, 0.0], [1.0, 1.0], ZoneKind::SpeedLimit { share })];
        refuses(&PathRequest { zones: &zones, ..request }, "zones.share");
    }
    for polygon in [vec![], vec![Point2::new(0.0, 0.0); 2], vec![Point2::new(f64::INFINITY, 0.0); 3]] {
        let zones = [Zone { polygon, kind: ZoneKind::KeepOut }];
        refuses(&PathRequest { zones: &zones, ..request }, "zones.polygon");
    }
    let speed = SpeedLimits { max_accel_mps2: 0.0, ..SpeedLimits::default() };
    refuses(&PathRequest { speed, ..request }, "speed.max_accel_mps2");
    let hybrid = HybridParams { turning_radius_m: 0.0, ..HybridParams::default() };
    refuses(&PathRequest { planner: Planner::Hybrid(hybrid), ..request }, "hybrid.turning_radius_m");
}
