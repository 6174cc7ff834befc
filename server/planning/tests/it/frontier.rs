//! Where to look next.

use crate::worlds::distance_to_obstacles;
use crate::{drawn, hall, path};
use nalgebra::Point2;
use percept_geometry::GridGeometry;
use percept_mapping::DenseGrid;
use percept_planning::{
    Footprint, Frontier, Mask, MaskKind, PathRequest, PlanError, PlanParams, Zone, ZoneKind, frontiers, rank_frontiers,
};

fn from(grid: &DenseGrid, start: Point2<f64>, params: &PlanParams) -> Result<Vec<Frontier>, PlanError> {
    frontiers(grid, &PathRequest::new(start, start, params), 1)
}

fn rectangle(low: [f64; 2], high: [f64; 2]) -> Zone {
    let polygon = [low, [high[0], low[1]], high, [low[0], high[1]]].map(Point2::from).to_vec();
    Zone { polygon, kind: ZoneKind::KeepOut }
}

#[test]
fn frontiers_that_can_be_reached_are_found_the_nearest_first() {
    // Two rooms; the left one is open to the unseen at its top and far bottom, the right one cannot be entered.
    let mut rows = vec![format!("#{}#{}#", "?".repeat(29), "?".repeat(20)); 3];
    rows.extend(vec![format!("#{}#{}#", ".".repeat(29), ".".repeat(20)); 24]);
    rows.push(format!("#{}??????{}#{}#", ".".repeat(20), ".".repeat(3), ".".repeat(20)));
    rows.push("#".repeat(52));
    let grid = drawn(&rows.iter().map(String::as_str).collect::<Vec<_>>());
    let (start, params) = (Point2::new(2.25, 0.95), PlanParams { start_tolerance_m: 0.0, ..PlanParams::default() });
    let request = PathRequest::new(start, start, &params);
    let found = frontiers(&grid, &request, 3).unwrap();
    assert_eq!(found.len(), 2, "{found:?}");
    // Beside the six unseen cells of the bottom row: eight above them, and one at either end.
    assert_eq!(found.iter().map(|f| f.cells.len()).collect::<Vec<_>>(), [10, 29]);
    assert!(found[0].cost <= found[1].cost);
    for frontier in &found {
        let goal = frontier.goal;
        assert!(distance_to_obstacles(&grid, &goal) >= params.robot_radius_m - 1e-6);
        let nearest = frontier.cells.iter().map(|c| (c - goal).norm()).fold(f64::INFINITY, f64::min);
        assert!(nearest <= params.robot_radius_m + 0.3, "{nearest}");
        assert!(path(&grid, start.into(), goal.into(), &params).length_m <= frontier.cost * 1.01 + 0.2);
    }
    assert_eq!(frontiers(&grid, &request, 11).unwrap().len(), 1);
    // Of 1 and 2.9 m, the larger one farther off: it comes first once a metre of it is worth as much of the way.
    let sizes = |gain: f64| {
        let mut ranked = found.clone();
        rank_frontiers(&mut ranked, gain).unwrap();
        ranked.iter().map(|f| (10.0 * f.size_m).round() as i32).collect::<Vec<_>>()
    };
    let apart = (found[1].cost - found[0].cost) / (found[1].size_m - found[0].size_m);
    assert!(apart > 0.0, "{apart}");
    assert_eq!((sizes(0.0), sizes(0.9 * apart), sizes(1.1 * apart)), (vec![10, 29], vec![10, 29], vec![29, 10]));
    assert!(matches!(rank_frontiers(&mut [], f64::NAN), Err(PlanError::InvalidParam { field: "gain", .. })));
    assert_eq!(from(&grid, Point2::new(-1.0, 0.0), &params).unwrap(), []);
}

#[test]
fn a_map_without_unknown_cells_has_no_frontier() {
    let params = PlanParams::default();
    assert_eq!(from(&hall(40, 40), Point2::new(2.0, 2.0), &params).unwrap(), []);
    let nan = from(&hall(40, 40), Point2::new(f64::NAN, 2.0), &params);
    assert!(matches!(nan, Err(PlanError::NotFinite { field: "start", .. })));
}

#[test]
fn what_lies_in_a_keep_out_zone_or_beyond_one_is_no_frontier() {
    // A corridor of 8 x 3 m along x, open to the unseen at both ends.
    let row = format!("?{}?", ".".repeat(78));
    let mut rows = vec!["#".repeat(80)];
    rows.extend(vec![row; 28]);
    rows.push("#".repeat(80));
    let grid = drawn(&rows.iter().map(String::as_str).collect::<Vec<_>>());
    let (start, params) = (Point2::new(2.0, 1.5), PlanParams { start_tolerance_m: 0.0, ..PlanParams::default() });
    let ends = |request: &PathRequest<'_>| {
        let found = frontiers(&grid, request, 3).unwrap();
        found.iter().map(|f| if f.goal.x < 4.0 { 'w' } else { 'e' }).collect::<String>()
    };
    let request = PathRequest::new(start, start, &params);
    assert_eq!(ends(&request), "we");
    // Across the corridor; over its east end; and across but for a gap that lets the robot by.
    let gap = 2.0 * params.robot_radius_m + 0.3;
    for (zone, expected) in [
        (rectangle([4.0, -1.0], [4.2, 4.0]), "w"),
        (rectangle([7.0, -1.0], [9.0, 4.0]), "w"),
        (rectangle([4.0, -1.0], [4.2, 2.9 - gap]), "we"),
    ] {
        let zones = [zone];
        assert_eq!(ends(&PathRequest { zones: &zones, ..request }), expected, "{zones:?}");
    }
    // A mask does the same, and a footprint that does not pass the gap.
    let cells =
        DenseGrid { geometry: GridGeometry::new(0.5, Point2::new(4.0, 0.0)), width: 1, height: 6, cells: vec![100; 6] };
    let masks = [Mask { grid: &cells, kind: MaskKind::KeepOut }];
    assert_eq!(ends(&PathRequest { masks: &masks, ..request }), "w");
    let zones = [rectangle([4.0, -1.0], [4.2, 2.9 - gap])];
    let wide = Footprint::Disc { radius_m: 0.5 * gap + 0.3 };
    assert_eq!(ends(&PathRequest { zones: &zones, footprint: Some(&wide), ..request }), "w");
    // From within a zone there is none.
    let zones = [rectangle([1.0, 0.5], [3.0, 2.5])];
    assert_eq!(ends(&PathRequest { zones: &zones, ..request }), "");
    let unsound = [Zone { polygon: vec![], kind: ZoneKind::KeepOut }];
    let refused = frontiers(&grid, &PathRequest { zones: &unsound, ..request }, 1);
    assert!(matches!(refused, Err(PlanError::InvalidParam { field: "zones.polygon", .. })));
}
