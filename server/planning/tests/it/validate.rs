//! Paths looked at again.

use crate::worlds::world;
use crate::{hall, path};
use nalgebra::Point2;
use percept_planning::{
    CellState, Footprint, Goal, HybridParams, MisfitReason, PathRequest, PlanError, PlanOutcome, PlanParams, Planner,
    Pose2, Zone, ZoneKind, plan_path, validate_path,
};

fn poses(path: &percept_planning::Path) -> Vec<Pose2> {
    path.waypoints.iter().map(|w| Pose2 { position: w.position, yaw_rad: w.yaw_rad }).collect()
}

fn pose(x: f64, y: f64, yaw_rad: f64) -> Pose2 {
    Pose2 { position: Point2::new(x, y), yaw_rad }
}

#[test]
fn what_each_planner_finds_fits_and_no_longer_does_once_something_is_put_on_it() {
    let params = PlanParams { start_tolerance_m: 0.0, max_expansions: 100_000, ..PlanParams::default() };
    let footprint = Footprint::rectangle(0.5, 0.3);
    let hybrid = HybridParams { turning_radius_m: 0.5, ..HybridParams::default() };
    let mut found = 0;
    for seed in 0..40 {
        for planner in [Planner::Grid, Planner::AnyAngle, Planner::Hybrid(hybrid)] {
            let (mut grid, [start, goal]) = world(seed);
            let request = PathRequest {
                goal: Goal { position: goal, yaw_rad: Some(1.0) },
                planner,
                footprint: Some(&footprint),
                ..PathRequest::new(start, goal, &params)
            };
            let PlanOutcome::Path(path) = plan_path(&grid, &request).unwrap() else { continue };
            let poses = poses(&path);
            assert_eq!(validate_path(&grid, &poses, &request).unwrap(), None, "world {seed} by {planner:?}");
            let middle = poses[poses.len() / 2].position;
            let at = grid.index(grid.geometry.cell(&middle).unwrap()).unwrap();
            grid.cells[at] = 100;
            let misfit = validate_path(&grid, &poses, &request).unwrap().unwrap();
            let MisfitReason::Blocked(blocking) = misfit.reason else { panic!("{misfit:?}") };
            assert_eq!(blocking.state, CellState::Occupied);
            assert!((blocking.obstacle - middle).norm() < 0.071 + 1e-9, "{blocking:?}");
            assert!(misfit.pose_index <= poses.len() / 2);
            found += 1;
        }
    }
    assert!(found >= 45, "{found}");
}

#[test]
fn the_first_place_is_told_and_why() {
    let (grid, params) = (hall(80, 50), PlanParams::default());
    let along = [pose(1.0, 2.0, 0.0), pose(3.0, 2.0, 0.0), pose(5.0, 2.0, 0.0), pose(9.0, 2.0, 0.0)];
    let request = PathRequest::new(Point2::origin(), Point2::origin(), &params);
    let misfit = validate_path(&grid, &along, &request).unwrap().unwrap();
    // The wall's inner edge is at 7.9 m, the robot's radius 0.22 m.
    assert_eq!(misfit.pose_index, 2);
    assert!((misfit.pose.position.x - 7.68).abs() < 1e-3, "{misfit:?}");
    let outside = validate_path(&grid, &[pose(-1.0, 2.0, 0.0)], &request).unwrap().unwrap();
    assert_eq!((outside.pose_index, outside.reason), (0, MisfitReason::OutsideMap));
    let zones =
        [Zone { polygon: [[3.5, 1.0], [4.5, 1.0], [4.5, 3.0]].map(Point2::from).to_vec(), kind: ZoneKind::KeepOut }];
    let misfit = validate_path(&grid, &along[..3], &PathRequest { zones: &zones, ..request }).unwrap().unwrap();
    assert!(
        matches!(misfit.reason, MisfitReason::Blocked(b) if b.state == CellState::KeepOut) && misfit.pose_index == 1
    );
    assert_eq!(validate_path(&grid, &along[..3], &request).unwrap(), None);
    assert_eq!(validate_path(&grid, &[], &request).unwrap(), None);
    let nan = validate_path(&grid, &[pose(1.0, 1.0, f64::NAN)], &request);
    assert!(matches!(nan, Err(PlanError::NotFinite { field: "poses", .. })));
}

/// A robot that stands nearer to a wall than it fits is led away from there, and what it was given still holds.
#[test]
fn a_path_that_leaves_a_tight_start_fits_and_what_comes_later_is_seen() {
    let (mut grid, params) = (hall(80, 50), PlanParams::default());
    // The wall's inner edge is at 7.9 m.
    let (start, goal) = (Point2::new(7.77, 2.03), Point2::new(2.0, 2.0));
    for planner in [Planner::Grid, Planner::AnyAngle] {
        let request = PathRequest { planner, ..PathRequest::new(start, goal, &params) };
        let PlanOutcome::Path(path) = plan_path(&grid, &request).unwrap() else { panic!("no path") };
        let poses = poses(&path);
        assert_eq!(validate_path(&grid, &poses, &request).unwrap(), None, "{planner:?}");
        let strict = PlanParams { start_tolerance_m: 0.0, ..params };
        let at_once = PathRequest { params: &strict, ..request };
        assert_eq!(validate_path(&grid, &poses, &at_once).unwrap().unwrap().pose_index, 0);
        // Nearer to the wall than it was is not excused.
        let nearer = [poses[0], pose(7.86, 2.03, 0.0), poses[1]];
        assert!(validate_path(&grid, &nearer, &request).unwrap().is_some());
        let before = grid.cells.clone();
        let at = grid.index(grid.geometry.cell(&Point2::new(4.0, 2.0)).unwrap()).unwrap();
        grid.cells[at] = 100;
        let misfit = validate_path(&grid, &poses, &request).unwrap().unwrap();
        assert!((misfit.pose.position.x - 4.0).abs() < 0.4, "{misfit:?}");
        grid.cells = before;
    }
}

#[test]
fn what_cannot_be_steered_is_told_from_what_does_not_fit() {
    let (grid, params) = (hall(80, 50), PlanParams::default());
    let hybrid = HybridParams { allow_reverse: false, ..HybridParams::default() };
    let request = PathRequest {
        planner: Planner::Hybrid(hybrid),
        ..PathRequest::new(Point2::origin(), Point2::origin(), &params)
    };
    let reason = |poses: &[Pose2]| validate_path(&grid, poses, &request).unwrap().map(|m| m.reason);
    let start = pose(2.0, 2.0, 0.0);
    assert_eq!(reason(&[start, pose(2.0, 2.5, 0.0)]), Some(MisfitReason::NotSteerable), "sideways");
    assert_eq!(reason(&[start, pose(2.0, 2.0, 1.0)]), Some(MisfitReason::NotSteerable), "on the spot");
    assert_eq!(
        reason(&[start, pose(2.5, 2.5, std::f64::consts::FRAC_PI_2)]),
        Some(MisfitReason::NotSteerable),
        "0.5 m"
    );
    assert_eq!(reason(&[start, pose(2.8, 2.8, std::f64::consts::FRAC_PI_2)]), None, "0.8 m");
    assert_eq!(reason(&[start, pose(1.5, 2.0, 0.0)]), Some(MisfitReason::Backwards));
    // A path over cells turns at its corners.
    let by_cells = path(&grid, [1.0, 1.0], [4.0, 2.0], &PlanParams { smooth: false, ..params });
    assert!(reason(&poses(&by_cells)).is_some());
}
