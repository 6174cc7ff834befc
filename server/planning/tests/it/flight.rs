//! Paths in space against brute force, dense samples and closed forms.

use nalgebra::{Point2, Point3};
use percept_geometry::{Aabb3, GridGeometry, KeyframeId, KeyframeScan, PointCloud, Pose, SensorId, Timestamp, Voxel};
use percept_mapping::{DenseGrid, Map, MapEntry, MapParams, VoxelParams};
use percept_planning::flight::{
    DenseVoxels, FlightOutcome, FlightParams, FlightPath, FlightPlanner, FlightRequest, plan_flight,
};
use percept_planning::{CellState, Mask, MaskKind, NoPathReason, PlanError, Zone, ZoneKind};
use proptest::prelude::*;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

const SIZE: f64 = 0.2;

/// Of this shape, free; its lowest corner lies at (-0.6, 0.4, 0.2).
fn open(size: [usize; 3]) -> DenseVoxels {
    DenseVoxels::new(SIZE, Voxel::new(-3, 2, 1), size, vec![0; size.iter().product()]).unwrap()
}

/// A voxel of the box by its place in it.
fn center(voxels: &DenseVoxels, at: [usize; 3]) -> Point3<f64> {
    let [x, y, z] = at.map(|v| v as i32);
    Voxel::new(voxels.low.x + x, voxels.low.y + y, voxels.low.z + z).center(voxels.voxel_size_m)
}

fn set(voxels: &mut DenseVoxels, [x, y, z]: [usize; 3], value: i8) {
    let index = (z * voxels.size[1] + y) * voxels.size[0] + x;
    voxels.percent[index] = value;
}

fn params() -> FlightParams {
    FlightParams { robot_radius_m: 0.25, start_tolerance_m: 0.0, ..FlightParams::default() }
}

fn ask(voxels: &DenseVoxels, start: Point3<f64>, goal: Point3<f64>, params: &FlightParams) -> FlightOutcome {
    plan_flight(voxels, &FlightRequest::new(start, goal, params)).unwrap()
}

fn path(voxels: &DenseVoxels, request: &FlightRequest<'_>) -> FlightPath {
    match plan_flight(voxels, request).unwrap() {
        FlightOutcome::Path(path) => path,
        FlightOutcome::NoPath { reason, .. } => panic!("no path: {reason:?}"),
    }
}

fn reason(outcome: &FlightOutcome) -> NoPathReason {
    match outcome {
        FlightOutcome::NoPath { reason, .. } => *reason,
        FlightOutcome::Path(path) => panic!("a path: {path:?}"),
    }
}

/// Distance from a point to the nearest obstacle, the outside among them unless unknown voxels are free, metres.
fn distance(voxels: &DenseVoxels, p: &Point3<f64>, params: &FlightParams) -> f64 {
    let size = voxels.voxel_size_m;
    let corner = Point3::new(voxels.low.x, voxels.low.y, voxels.low.z).cast::<f64>() * size;
    let high = corner + nalgebra::Vector3::from(voxels.size.map(|v| v as f64 * size));
    let mut nearest = f64::INFINITY;
    if !params.allow_unknown {
        nearest = (0..3).map(|i| (p[i] - corner[i]).min(high[i] - p[i])).fold(nearest, f64::min).max(0.0);
    }
    for (index, value) in voxels.percent.iter().enumerate() {
        if *value >= 50 || (*value < 0 && !params.allow_unknown) {
            let at = [index % voxels.size[0], index / voxels.size[0] % voxels.size[1]];
            let middle = center(voxels, [at[0], at[1], index / voxels.size[0] / voxels.size[1]]);
            nearest = nearest.min((p - middle).map(|v| (v.abs() - 0.5 * size).max(0.0)).norm());
        }
    }
    nearest
}

/// Dijkstra by the book over voxels' centres where the ball fits; a step needs all of the box that it spans. Metres.
fn dijkstra(voxels: &DenseVoxels, from: [usize; 3], to: [usize; 3], params: &FlightParams) -> Option<f64> {
    let [x, y, z] = voxels.size;
    let at = |i: usize| [i % x, i / x % y, i / x / y];
    let index = |at: [usize; 3]| (at[2] * y + at[1]) * x + at[0];
    let needed = params.robot_radius_m * (1.0 - 1e-9);
    let fits: Vec<bool> = (0..x * y * z)
        .map(|i| {
            let clearance = distance(voxels, &center(voxels, at(i)), params);
            clearance > 0.0 && clearance >= needed
        })
        .collect();
    let mut costs = vec![f64::INFINITY; fits.len()];
    let mut settled = vec![false; fits.len()];
    if fits[index(from)] {
        costs[index(from)] = 0.0;
    }
    loop {
        let open = (0..costs.len()).filter(|i| !settled[*i] && costs[*i].is_finite());
        let here = open.min_by(|a, b| costs[*a].total_cmp(&costs[*b]))?;
        if here == index(to) {
            return Some(costs[here] * voxels.voxel_size_m);
        }
        settled[here] = true;
        for step in 0..27 {
            let by = [step % 3, step / 3 % 3, step / 9].map(|v| v - 1);
            let there: Vec<i64> = (0..3).map(|k| at(here)[k] as i64 + by[k]).collect();
            if step == 13 || (0..3).any(|k| there[k] < 0 || there[k] >= voxels.size[k] as i64) {
                continue;
            }
            let between = |k: usize, i: usize| if k >> i & 1 == 1 { there[i] as usize } else { at(here)[i] };
            if (0..8).all(|k| fits[index(std::array::from_fn(|i| between(k, i)))]) {
                let length = by.iter().map(|v| v * v).sum::<i64>() as f64;
                let next = index(std::array::from_fn(|i| there[i] as usize));
                costs[next] = costs[next].min(costs[here] + length.sqrt());
            }
        }
    }
}

/// Panics unless the ball fits along the path, by samples a hundredth of a voxel apart, and the told clearance is theirs.
fn check(voxels: &DenseVoxels, path: &FlightPath, params: &FlightParams) {
    let mut nearest = f64::INFINITY;
    for leg in path.waypoints.windows(2) {
        let steps = ((leg[1] - leg[0]).norm() / (0.01 * voxels.voxel_size_m)).ceil().max(1.0);
        for i in 0..=steps as usize {
            let p = leg[0] + (leg[1] - leg[0]) * (i as f64 / steps);
            nearest = nearest.min(distance(voxels, &p, params));
        }
    }
    assert!(nearest >= params.robot_radius_m - 1e-9, "{nearest} {path:?}");
    let limit = params.robot_radius_m + 2.0 * voxels.voxel_size_m;
    match path.min_clearance_m {
        Some(told) => {
            assert!(told <= nearest + 1e-9 && told >= nearest - 0.01 * voxels.voxel_size_m, "{told} {nearest}")
        }
        None => assert!(nearest >= limit - 1e-9, "{nearest}"),
    }
    let length: f64 = path.waypoints.windows(2).map(|leg| (leg[1] - leg[0]).norm()).sum();
    assert!((length - path.length_m).abs() < 1e-9);
}

fn random_box(size: [usize; 3], seed: u64, share: u64) -> DenseVoxels {
    let mut state = seed;
    let mut voxels = open(size);
    for value in &mut voxels.percent {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let drawn = (state >> 33) % 400;
        *value = if drawn < share { if drawn.is_multiple_of(4) { -1 } else { 100 } } else { 10 };
    }
    voxels
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn ways_over_voxels_are_the_shortest_and_those_at_any_angle_no_longer_and_both_are_clear(
        x in 3usize..11, y in 3usize..9, z in 3usize..7, seed in any::<u64>(), share in 0u64..60,
        ends in prop::array::uniform6(0usize..100), radius in 0usize..4, allow_unknown: bool, stops in 0usize..5,
    ) {
        let voxels = random_box([x, y, z], seed, share);
        let (from, to) = ([ends[0] % x, ends[1] % y, ends[2] % z], [ends[3] % x, ends[4] % y, ends[5] % z]);
        // Touching exactly is allowed: 0.1 m is half a voxel, 0.3 m one and a half.
        let robot_radius_m = [0.0, 0.1, 0.17, 0.3][radius];
        let params = FlightParams { robot_radius_m, allow_unknown, ..params() };
        let (start, goal) = (center(&voxels, from), center(&voxels, to));
        let request = FlightRequest::new(start, goal, &params);
        let lattice = FlightRequest { planner: FlightPlanner::Lattice, ..request };
        match (plan_flight(&voxels, &lattice).unwrap(), dijkstra(&voxels, from, to, &params)) {
            (FlightOutcome::Path(found), Some(length)) => {
                prop_assert!((found.length_m - length).abs() < 1e-6, "{} {length}", found.length_m);
                check(&voxels, &found, &params);
                let any = path(&voxels, &request);
                prop_assert!(any.length_m <= found.length_m + 1e-9 && any.length_m >= (goal - start).norm() - 1e-9);
                prop_assert_eq!((any.waypoints[0], any.waypoints[any.waypoints.len() - 1]), (start, goal));
                check(&voxels, &any, &params);
                prop_assert!(any.is_final && any.bound == 1.0);
                // With a deadline, whatever is known by then.
                for asked in [lattice, request] {
                    let left = std::sync::atomic::AtomicUsize::new(stops);
                    let stop = || left.fetch_update(Relaxed, Relaxed, |n| n.checked_sub(1)).is_err();
                    match plan_flight(&voxels, &FlightRequest { stop: Some(&stop), ..asked }).unwrap() {
                        FlightOutcome::Path(in_time) => {
                            check(&voxels, &in_time, &params);
                            let known = if asked.planner == FlightPlanner::Lattice { &found } else { &any };
                            if in_time.is_final {
                                prop_assert_eq!((&in_time.waypoints, in_time.bound), (&known.waypoints, 1.0));
                            }
                            let most = in_time.bound * length + 1e-6;
                            prop_assert!(in_time.bound <= 2.0 && in_time.length_m <= most, "{in_time:?} {length}");
                        }
                        outcome => prop_assert!(stops == 0 && reason(&outcome) == NoPathReason::Stopped),
                    }
                }
            }
            (FlightOutcome::NoPath { .. }, None) => {}
            (found, length) => prop_assert!(false, "{found:?} {length:?}"),
        }
    }

    #[test]
    fn ends_off_the_centres_are_met_exactly(
        seed in any::<u64>(), share in 0u64..30, a in prop::array::uniform3(0.0..1.0f64), b in prop::array::uniform3(0.0..1.0f64),
    ) {
        let voxels = random_box([12, 9, 8], seed, share);
        let place = |v: [f64; 3]| Point3::new(-0.6 + 2.4 * v[0], 0.4 + 1.8 * v[1], 0.2 + 1.6 * v[2]);
        let params = FlightParams { robot_radius_m: 0.12, ..params() };
        let (start, goal) = (place(a), place(b));
        match ask(&voxels, start, goal, &params) {
            FlightOutcome::Path(found) => {
                check(&voxels, &found, &params);
                prop_assert_eq!((found.waypoints[0], found.waypoints[found.waypoints.len() - 1]), (start, goal));
            }
            FlightOutcome::NoPath { reason: NoPathReason::StartDoesNotFit, blocking } => {
                prop_assert!(blocking.is_some());
            }
            FlightOutcome::NoPath { .. } => {}
        }
    }
}

#[test]
fn in_empty_space_the_way_is_straight_and_over_voxels_it_has_its_closed_form() {
    let voxels = open([40, 30, 20]);
    let params = params();
    let (from, to) = ([5, 5, 5], [30, 17, 9]);
    let (start, goal) = (center(&voxels, from), center(&voxels, to));
    let request = FlightRequest::new(start, goal, &params);
    let any = path(&voxels, &request);
    assert_eq!(any.waypoints, [start, goal]);
    // 25, 12 and 4 voxels: 4 over all three axes, 8 over two, 13 over one.
    let lattice = path(&voxels, &FlightRequest { planner: FlightPlanner::Lattice, ..request });
    let wanted = SIZE * (4.0 * 3f64.sqrt() + 8.0 * 2f64.sqrt() + 13.0);
    assert!((lattice.length_m - wanted).abs() < 1e-9, "{} {wanted}", lattice.length_m);
    assert_eq!(lattice.waypoints.len(), 26);
    // Off the centres, and of no length.
    let (start, goal) = (Point3::new(0.53, 1.77, 1.31), Point3::new(5.11, 3.02, 2.69));
    assert_eq!(path(&voxels, &FlightRequest::new(start, goal, &params)).waypoints, [start, goal]);
    let still = path(&voxels, &FlightRequest::new(start, start, &params));
    assert_eq!((still.length_m, still.waypoints), (0.0, vec![start, start]));
}

#[test]
fn a_window_in_a_wall_is_flown_through_if_the_ball_fits() {
    // A wall across, with a window of 4 x 4 voxels (0.8 m).
    let mut voxels = open([30, 20, 20]);
    for (y, z) in (0..20).flat_map(|y| (0..20).map(move |z| (y, z))) {
        if !((12..16).contains(&y) && (3..7).contains(&z)) {
            set(&mut voxels, [15, y, z], 100);
        }
    }
    let (start, goal) = (center(&voxels, [5, 5, 14]), center(&voxels, [25, 5, 14]));
    for radius in [0.1, 0.25, 0.29] {
        let params = FlightParams { robot_radius_m: radius, ..params() };
        let found = path(&voxels, &FlightRequest::new(start, goal, &params));
        check(&voxels, &found, &params);
        let at_wall = found.waypoints.windows(2).find(|leg| leg[0].x <= 2.5 && leg[1].x >= 2.5);
        assert!(at_wall.is_some(), "{found:?}");
    }
    // The middle of the window is a corner of voxels: centres next to it are 0.3 m from its edges.
    let wide = FlightParams { robot_radius_m: 0.31, ..params() };
    assert_eq!(reason(&ask(&voxels, start, goal, &wide)), NoPathReason::Unreachable);
    // Shut by heights: the window reaches from 0.8 to 1.6 m.
    let high = FlightParams { min_z_m: Some(1.45), ..params() };
    assert_eq!(reason(&ask(&voxels, start, goal, &high)), NoPathReason::Unreachable);
    let low = FlightParams { max_z_m: Some(2.0), ..params() };
    assert_eq!(reason(&ask(&voxels, start, goal, &low)), NoPathReason::StartInKeepOut);
    let below = Point3::new(goal.x, goal.y, 1.2);
    assert_eq!(reason(&ask(&voxels, start, below, &high)), NoPathReason::GoalInKeepOut);
    let between = FlightParams { min_z_m: Some(1.05), max_z_m: Some(3.1), ..params() };
    let found = path(&voxels, &FlightRequest::new(start, goal, &between));
    assert!(found.waypoints.iter().all(|p| (1.05..=3.1).contains(&p.z)));
}

#[test]
fn refused_ends_say_why() {
    let mut voxels = open([20, 20, 20]);
    set(&mut voxels, [10, 10, 10], 100);
    set(&mut voxels, [4, 10, 10], -1);
    let params = params();
    let good = center(&voxels, [15, 15, 15]);
    let both = |p: Point3<f64>| (reason(&ask(&voxels, p, good, &params)), reason(&ask(&voxels, good, p, &params)));
    use NoPathReason::*;
    assert_eq!(both(Point3::new(-0.61, 1.0, 1.0)), (StartOutsideMap, GoalOutsideMap));
    assert_eq!(both(center(&voxels, [10, 10, 10])), (StartOccupied, GoalOccupied));
    assert_eq!(both(center(&voxels, [4, 10, 10])), (StartUnknown, GoalUnknown));
    let beside = center(&voxels, [11, 10, 10]);
    assert_eq!(both(beside), (StartDoesNotFit, GoalDoesNotFit));
    let FlightOutcome::NoPath { blocking: Some(blocking), .. } = ask(&voxels, good, beside, &params) else { panic!() };
    assert_eq!((blocking.position, blocking.state), (beside, CellState::Occupied));
    assert!((blocking.obstacle - center(&voxels, [10, 10, 10])).norm() < 1e-9);
    // Against the box's end, beyond which nothing is known.
    let end = center(&voxels, [0, 5, 5]);
    let FlightOutcome::NoPath { blocking: Some(blocking), .. } = ask(&voxels, good, end, &params) else { panic!() };
    assert_eq!(blocking.state, CellState::Unknown);
    // Where unknown voxels are free, all of these but what is occupied or too near to it are places to be.
    let allowing = FlightParams { allow_unknown: true, ..params };
    for p in [end, center(&voxels, [4, 10, 10])] {
        assert!(matches!(ask(&voxels, good, p, &allowing), FlightOutcome::Path(_)));
        assert!(matches!(ask(&voxels, p, good, &allowing), FlightOutcome::Path(_)));
    }
}

#[test]
fn a_start_on_the_ground_is_left_without_going_nearer_to_it() {
    let mut voxels = open([20, 20, 20]);
    for (x, y) in (0..20).flat_map(|x| (0..20).map(move |y| (x, y))) {
        set(&mut voxels, [x, y, 2], 100);
    }
    let (start, goal) = (Point3::new(1.33, 2.41, 0.9), center(&voxels, [15, 5, 10]));
    assert_eq!(reason(&ask(&voxels, start, goal, &params())), NoPathReason::StartDoesNotFit);
    let tolerant = FlightParams { start_tolerance_m: 0.5, ..params() };
    let found = path(&voxels, &FlightRequest::new(start, goal, &tolerant));
    // The ground reaches up to 0.8 m.
    assert!((found.min_clearance_m.unwrap() - 0.1).abs() < 1e-9);
    let far = found.waypoints.iter().filter(|p| (*p - start).norm() > 0.7);
    assert!(far.into_iter().all(|p| distance(&voxels, p, &tolerant) >= 0.25 - 1e-9));
    assert!(found.waypoints.iter().all(|p| p.z >= 0.9 - 1e-9));
}

#[test]
fn limits_end_the_search_and_say_so() {
    let voxels = open([40, 40, 40]);
    let (start, goal) = (center(&voxels, [3, 3, 3]), center(&voxels, [36, 30, 20]));
    let few = FlightParams { max_expansions: 3, ..params() };
    assert_eq!(reason(&ask(&voxels, start, goal, &few)), NoPathReason::SearchLimit);
    let params = params();
    let stop = || true;
    let request = FlightRequest { stop: Some(&stop), ..FlightRequest::new(start, goal, &params) };
    assert_eq!(reason(&plan_flight(&voxels, &request).unwrap()), NoPathReason::Stopped);
    // A way was found when the time was over.
    let mut walled = voxels.clone();
    (0..40).flat_map(|y| (5..40).map(move |z| [20, y, z])).for_each(|at| set(&mut walled, at, 100));
    let request = FlightRequest::new(start, center(&walled, [36, 30, 35]), &params);
    let done = path(&walled, &request);
    let at_the = |nth: usize| {
        let asked = std::sync::atomic::AtomicUsize::new(0);
        let stop = || asked.fetch_add(1, Relaxed) >= nth;
        match plan_flight(&walled, &FlightRequest { stop: Some(&stop), ..request }).unwrap() {
            FlightOutcome::Path(path) => Some(path),
            none => (reason(&none) != NoPathReason::Stopped).then(|| panic!("{none:?}")),
        }
    };
    let in_time = (1..100).find_map(at_the).unwrap();
    assert!(!in_time.is_final && in_time.bound > 1.0 && in_time.bound <= 2.0, "{in_time:?}");
    assert!(done.is_final && in_time.length_m >= done.length_m - 1e-9);
    check(&walled, &in_time, &params);
    assert_eq!(ask(&voxels, start, goal, &params), ask(&voxels, start, goal, &params));
}

#[test]
fn what_makes_no_sense_is_refused_by_what_is_wrong() {
    let refused = |result: Result<DenseVoxels, PlanError>| match result {
        Err(PlanError::InvalidParam { field, .. }) => field,
        other => panic!("{other:?}"),
    };
    let low = Voxel::new(0, 0, 0);
    assert_eq!(refused(DenseVoxels::new(f64::NAN, low, [1, 1, 1], vec![0])), "voxel_size_m");
    assert_eq!(refused(DenseVoxels::new(0.0, low, [1, 1, 1], vec![0])), "voxel_size_m");
    assert_eq!(refused(DenseVoxels::new(0.1, low, [0, 1, 1], vec![])), "voxels.size");
    assert_eq!(refused(DenseVoxels::new(0.1, low, [2, 1, 1], vec![0])), "voxels.size");
    assert_eq!(refused(DenseVoxels::new(0.1, Voxel::new(i32::MAX, 0, 0), [2, 1, 1], vec![0, 0])), "voxels.low");
    assert_eq!(refused(DenseVoxels::new(0.1, low, [1, 1, 1], vec![101])), "voxels.percent");
    let region = |high: [f64; 3]| Aabb3 { min: Point3::origin(), max: Point3::from(high) };
    assert_eq!(refused(DenseVoxels::unknown(0.1, &region([1.0, 0.0, 1.0]), 1000)), "region");
    assert_eq!(refused(DenseVoxels::unknown(0.1, &region([1.0, f64::NAN, 1.0]), 1000)), "region");
    assert_eq!(refused(DenseVoxels::unknown(0.1, &region([1.0, 1e12, 1.0]), 1000)), "region");
    // 10^5 x 10^5 x 10^3 voxels, of which not one is taken.
    let huge = DenseVoxels::unknown(0.1, &region([1e4 - 0.05, 1e4 - 0.05, 99.95]), 32_000_000);
    assert_eq!(huge, Err(PlanError::GridTooLarge { cells: 10_000_000_000_000, limit: 32_000_000 }));
    assert_eq!(DenseVoxels::unknown(0.1, &region([0.95, 0.95, 0.95]), 1000).unwrap().size, [10, 10, 10]);
    let voxels = open([10, 10, 10]);
    let middle = center(&voxels, [5, 5, 5]);
    let refused = |params: FlightParams| match plan_flight(&voxels, &FlightRequest::new(middle, middle, &params)) {
        Err(PlanError::InvalidParam { field, .. }) => field,
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(FlightParams { robot_radius_m: -0.1, ..params() }), "robot_radius_m");
    assert_eq!(refused(FlightParams { robot_radius_m: 16.1, ..params() }), "robot_radius_m", "more than 80 voxels");
    assert_eq!(refused(FlightParams { min_z_m: Some(f64::NAN), ..params() }), "min_z_m");
    assert_eq!(refused(FlightParams { min_z_m: Some(1.0), max_z_m: Some(0.5), ..params() }), "max_z_m");
    assert_eq!(refused(FlightParams { max_expansions: 0, ..params() }), "max_expansions");
    let small = FlightParams { max_voxels: 999, ..params() };
    let outcome = plan_flight(&voxels, &FlightRequest::new(middle, middle, &small));
    assert_eq!(outcome, Err(PlanError::GridTooLarge { cells: 1000, limit: 999 }));
    let nan = FlightRequest::new(middle, Point3::new(0.0, f64::NAN, 0.0), &small);
    assert!(matches!(plan_flight(&voxels, &nan), Err(PlanError::NotFinite { field: "goal", .. })));
}

#[test]
fn a_map_of_voxels_is_planned_in() {
    // From the middle of a room 5 x 5 x 2.4 m, a beam every degree or so.
    let (mut hits, half) = (vec![], Point3::new(2.52f64, 2.52, 1.22));
    for (row, column) in (-80..=80).flat_map(|row| (0..360).map(move |column| (row, column))) {
        let (elevation, azimuth) = (f64::from(row).to_radians(), (f64::from(column) + 0.31).to_radians());
        let d =
            nalgebra::Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
        let t = (0..3).map(|i| half[i] / d[i].abs().max(1e-9)).fold(f64::INFINITY, f64::min);
        hits.push(Point3::from(d * t).cast::<f32>());
    }
    let scan = KeyframeScan {
        stamp: Timestamp::from_nanos(0),
        sensor: SensorId::from("lidar"),
        t_base_sensor: Pose::identity(),
        base_height_m: 0.0,
        hits: PointCloud::from_positions(hits),
        misses: vec![],
        planar: false,
        features: None,
    };
    let voxels = VoxelParams { enabled: true, ..VoxelParams::default() };
    let mut map = Map::new(MapParams { voxels, ..MapParams::default() }).unwrap();
    map.insert(KeyframeId(0), &MapEntry::at(Pose::identity()), Arc::new(scan)).unwrap();
    let map = map.layers().voxels;
    let whole = DenseVoxels::of_map(&map, None, 10_000_000).unwrap();
    let params = params();
    let (start, goal) = (Point3::new(-1.5, -1.5, -0.5), Point3::new(1.5, 1.5, 0.5));
    assert_eq!(path(&whole, &FlightRequest::new(start, goal, &params)).waypoints, [start, goal]);
    let behind = Point3::new(2.62, 0.0, 0.0);
    let there = reason(&ask(&whole, start, behind, &params));
    assert!(matches!(there, NoPathReason::GoalUnknown | NoPathReason::GoalOutsideMap | NoPathReason::GoalOccupied));
    // The same voxels within a region, and unknown ones around them.
    let region = Aabb3 { min: Point3::new(-4.0, -4.0, -1.0), max: Point3::new(4.0, 0.5, 3.0) };
    let part = DenseVoxels::of_map(&map, Some(&region), 10_000_000).unwrap();
    let mut known = 0;
    for (index, value) in whole.percent.iter().enumerate() {
        let [x, y, _] = whole.size;
        let at = [index % x, index / x % y, index / x / y].map(|v| v as i32);
        let voxel = Voxel::new(whole.low.x + at[0], whole.low.y + at[1], whole.low.z + at[2]);
        if *value >= 0 && region.contains(&voxel.center(whole.voxel_size_m)) {
            known += 1;
            assert_eq!(part.index(voxel).map(|i| part.percent[i]), Some(*value));
        }
    }
    assert!(known > 10_000, "{known}");
    let few = DenseVoxels::of_map(&map, None, 1000);
    assert!(matches!(few, Err(PlanError::GridTooLarge { limit: 1000, .. })));
}

/// Keep out of a rectangle in metres.
fn closed(low: [f64; 2], high: [f64; 2]) -> Zone {
    let polygon = [low, [high[0], low[1]], high, [low[0], high[1]]].map(Point2::from).to_vec();
    Zone { polygon, kind: ZoneKind::KeepOut }
}

#[test]
fn a_keep_out_zone_is_a_column_that_no_part_of_the_ball_enters() {
    // 6 x 4 x 2.4 m; a bar across it but for the upper 1.2 m along y.
    let voxels = open([30, 20, 12]);
    let params = params();
    let (start, goal) = (center(&voxels, [3, 5, 5]), center(&voxels, [26, 5, 5]));
    let zone = closed([2.05, -9.0], [2.35, 3.15]);
    for planner in [FlightPlanner::Lattice, FlightPlanner::AnyAngle] {
        let request = FlightRequest { planner, ..FlightRequest::new(start, goal, &params) };
        let straight = path(&voxels, &request);
        assert!(straight.waypoints.iter().all(|p| p.y < 2.0));
        let zones = [zone.clone()];
        let around = path(&voxels, &FlightRequest { zones: &zones, ..request });
        // The same as if walls stood there.
        let mut walled = voxels.clone();
        for index in 0..walled.percent.len() {
            let p = center(&walled, [index % 30, index / 30 % 20, index / 600]);
            // The columns that the zone touches.
            if (p.x - 2.2).abs() < 0.15 && p.y < 3.2 {
                walled.percent[index] = 100;
            }
        }
        assert_eq!(around, path(&walled, &request));
        assert!(around.length_m > straight.length_m + 0.5);
        let shut = [closed([2.0, -9.0], [2.4, 9.0])];
        let none = plan_flight(&voxels, &FlightRequest { zones: &shut, ..request }).unwrap();
        assert_eq!(reason(&none), NoPathReason::Unreachable);
        // Slow is not shut.
        let slow = [Zone { kind: ZoneKind::SpeedLimit { share: 0.1 }, ..shut[0].clone() }];
        assert_eq!(path(&voxels, &FlightRequest { zones: &slow, ..request }), straight);
    }
}

#[test]
fn ends_in_a_keep_out_zone_or_too_near_to_one_say_so() {
    let voxels = open([30, 20, 12]);
    let params = params();
    let (start, goal) = (center(&voxels, [3, 5, 5]), center(&voxels, [26, 5, 5]));
    let ask = |zone: Zone| {
        let zones = [zone];
        plan_flight(&voxels, &FlightRequest { zones: &zones, ..FlightRequest::new(start, goal, &params) }).unwrap()
    };
    let around = |p: Point3<f64>, by: f64| closed([p.x - by, p.y - by], [p.x + by, p.y + by]);
    assert_eq!(reason(&ask(around(start, 0.3))), NoPathReason::StartInKeepOut);
    assert_eq!(reason(&ask(around(goal, 0.3))), NoPathReason::GoalInKeepOut);
    // Beside the goal: free, but the ball reaches in.
    let beside = ask(closed([goal.x + 0.21, goal.y - 0.3], [goal.x + 0.29, goal.y + 0.3]));
    let FlightOutcome::NoPath { reason, blocking: Some(blocking) } = beside else { panic!("{beside:?}") };
    assert_eq!((reason, blocking.state), (NoPathReason::GoalDoesNotFit, CellState::KeepOut));
    assert!((blocking.obstacle.x - goal.x - SIZE).abs() < 1e-9);
}

#[test]
fn the_ball_does_not_reach_out_of_the_box_into_a_keep_out_zone() {
    let voxels = open([30, 20, 12]);
    let params = FlightParams { allow_unknown: true, ..params() };
    let (start, goal) = (center(&voxels, [3, 19, 5]), center(&voxels, [26, 19, 5]));
    let request = FlightRequest::new(start, goal, &params);
    assert!((path(&voxels, &request).length_m - 4.6).abs() < 1e-9);
    // Beyond the box's upper edge along y, 4.4 m, and between the ends.
    let zones = [closed([1.0, 4.5], [3.0, 5.0])];
    let off = path(&voxels, &FlightRequest { zones: &zones, ..request });
    assert!(off.length_m > 4.6 && off.min_clearance_m.unwrap() >= 0.25 - 1e-9);
    assert!(off.waypoints.iter().any(|p| p.y < 4.4 - 0.2), "{:?}", off.waypoints);
    let zones = [closed([goal.x - 0.3, 4.5], [goal.x + 0.3, 5.0])];
    let none = plan_flight(&voxels, &FlightRequest { zones: &zones, ..request }).unwrap();
    assert_eq!(reason(&none), NoPathReason::GoalDoesNotFit);
}

#[test]
fn a_mask_closes_the_columns_that_its_cells_touch() {
    let voxels = open([30, 20, 12]);
    let params = params();
    let (start, goal) = (center(&voxels, [3, 5, 5]), center(&voxels, [26, 5, 5]));
    // Cells of a quarter voxel: a line of them across the box, in the middle of no column.
    let geometry = GridGeometry::new(0.05, Point2::new(2.0, 0.0));
    let cells = DenseGrid { geometry, width: 1, height: 100, cells: vec![100; 100] };
    let masks = [Mask { grid: &cells, kind: MaskKind::KeepOut }];
    let request = FlightRequest { masks: &masks, ..FlightRequest::new(start, goal, &params) };
    assert_eq!(reason(&plan_flight(&voxels, &request).unwrap()), NoPathReason::Unreachable);
    let masks = [Mask { kind: MaskKind::PERCENT, ..masks[0] }];
    assert_eq!(path(&voxels, &FlightRequest { masks: &masks, ..request }).waypoints.len(), 2);
}
