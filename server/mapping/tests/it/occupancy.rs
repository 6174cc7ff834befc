use crate::scans::{planar, room, spatial};
use nalgebra::{Point2, Point3};
use percept_geometry::grid::walk;
use percept_geometry::{Cell, GridGeometry, KeyframeScan, Pose, se3};
use percept_mapping::{DenseGrid, MappingError, Occupancy, OccupancyGrid, OccupancyParams};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// What beams say, without what the robot's way does.
fn grid() -> OccupancyGrid {
    OccupancyGrid::new(OccupancyParams { footprint_radius_m: 0.0, ..Default::default() }).unwrap()
}

/// The definition, cell by cell: hit wins over free, each cell once.
fn brute_force(t_map_base: &Pose, hits: &[[f32; 2]], misses: &[[f32; 2]]) -> BTreeMap<Cell, f32> {
    let p = OccupancyParams::default();
    let g = GridGeometry::new(p.resolution_m, Point2::origin());
    let origin = Point2::from(t_map_base.translation.vector.xy());
    let (mut hit, mut free) = (BTreeSet::new(), BTreeSet::new());
    let ends = hits.iter().map(|h| (h, true)).chain(misses.iter().map(|m| (m, false)));
    for (end, returned) in ends {
        let end = (t_map_base * Point3::new(f64::from(end[0]), f64::from(end[1]), 0.0)).xy();
        let range = (end - origin).norm();
        if returned && range < p.range_min_m {
            continue;
        }
        let marks = returned && range <= p.range_max();
        let end = if range > p.range_max() { origin + (end - origin) * (p.range_max() / range) } else { end };
        walk(&g, &origin, &end, |c| {
            if marks && Some(c) == g.cell(&end) {
                hit.insert(c)
            } else {
                free.insert(c)
            };
        });
    }
    let free = free.difference(&hit).map(|c| (*c, p.free_log_odds)).collect::<Vec<_>>();
    free.into_iter().chain(hit.iter().map(|c| (*c, p.hit_log_odds))).collect()
}

fn points(range: f32) -> impl Strategy<Value = Vec<[f32; 2]>> {
    prop::collection::vec(prop::array::uniform2(-range..range), 0..40)
}

proptest! {
    #[test]
    fn a_planar_scan_marks_every_end_and_frees_what_lies_before(
        x in -300.0..300.0f64, y in -300.0..300.0f64, yaw in -3.0..3.0f64, hits in points(9.0), misses in points(9.0),
    ) {
        let pose = se3::from_xy_yaw(x, y, yaw);
        let mut grid = grid();
        grid.integrate(&pose, &planar(&hits, &misses)).unwrap();
        let expected = brute_force(&pose, &hits, &misses);
        for (cell, log_odds) in &expected {
            prop_assert_eq!(grid.log_odds(*cell), Some(*log_odds), "{:?}", cell);
        }
        prop_assert_eq!(grid.num_known(), expected.len());
        if let Some((min, max)) = grid.bounds() {
            prop_assert_eq!(min.x, expected.keys().map(|c| c.x).min().unwrap());
            prop_assert_eq!(max.y, expected.keys().map(|c| c.y).max().unwrap());
        }
    }

    #[test]
    fn beams_beyond_the_largest_range_only_free(angle in -3.1..3.1f32, range in 30.01..50.0f32) {
        let mut grid = grid();
        grid.integrate(&Pose::identity(), &planar(&[[range * angle.cos(), range * angle.sin()]], &[])).unwrap();
        let (min, max) = grid.bounds().unwrap();
        let dense = grid.dense(1_000_000).unwrap();
        prop_assert!(dense.cells.iter().all(|v| *v < 50));
        let reach = [min.x, min.y, max.x, max.y].map(|v| f64::from(v) * 0.1).iter().fold(0.0f64, |a, v| a.max(v.abs()));
        prop_assert!(reach <= 30.0 + 0.1);
        prop_assert!(grid.log_odds(Cell::new((29.9 * angle.cos() * 10.0).floor() as i32,
            (29.9 * angle.sin() * 10.0).floor() as i32)).is_some());
    }
}

#[test]
fn the_second_look_adds_up_and_clamps() {
    let mut grid = grid();
    for _ in 0..2 {
        grid.integrate(&Pose::identity(), &planar(&[[1.05, 0.05]], &[])).unwrap();
    }
    assert_eq!(grid.log_odds(Cell::new(10, 0)), Some(1.2));
    assert!((grid.probability(Cell::new(10, 0)).unwrap() - 1.0 / (1.0 + (-1.2f64).exp())).abs() < 1e-7);
    for _ in 0..20 {
        grid.integrate(&Pose::identity(), &planar(&[[1.05, 0.05]], &[])).unwrap();
    }
    assert_eq!(grid.log_odds(Cell::new(10, 0)), Some(3.5));
    assert_eq!(grid.log_odds(Cell::new(5, 0)), Some(-2.0));
    assert_eq!(grid.probability(Cell::new(11, 0)), None);
}

#[test]
fn a_clone_does_not_see_later_changes() {
    let mut grid = grid();
    grid.integrate(&Pose::identity(), &planar(&[[1.05, 0.05]], &[])).unwrap();
    let before = grid.clone();
    let picture = before.dense(1_000_000).unwrap();
    grid.integrate(&Pose::identity(), &planar(&[[0.55, 0.05], [-3.0, -3.0]], &[])).unwrap();
    assert_eq!(before.dense(1_000_000).unwrap(), picture);
    assert_ne!(before, grid);
}

#[test]
fn a_room_seen_in_3d_is_walls_and_free_floor_without_floor_or_ceiling_as_obstacles() {
    let mut grid = grid();
    // Half a cell off, so that the walls do not lie on a border between cells.
    grid.integrate(&se3::from_xy_yaw(-20.05, 7.05, 0.0), &room(0.5, 3.0, Some(1.5), 0.01)).unwrap();
    let at = |x: f64, y: f64| grid.log_odds(grid.geometry().cell(&Point2::new(x - 20.05, y + 7.05)).unwrap());
    for i in -28..=28 {
        let side = f64::from(i) * 0.1;
        for wall in [at(-3.0, side), at(side, 3.0), at(side, -3.0)] {
            assert!(wall.unwrap() > 0.0, "wall at {side}");
        }
        assert!(at(side.min(1.0), 0.0).unwrap() < 0.0, "free at {side}");
    }
    assert!(at(1.26, 0.0).unwrap() > 0.0, "the pillar's near face");
    assert_eq!(at(2.2, 0.0), None, "behind the pillar nothing is known");
    assert!(at(1.5, 1.5).unwrap() < 0.0);
}

#[test]
fn the_band_follows_gravity_when_the_robot_tilts() {
    // Base pitched by 10 degrees nose up sees the level floor at z < 0 far ahead in its own frame.
    let t_map_base = Pose::new(nalgebra::Vector3::zeros(), nalgebra::Vector3::new(0.0, -10f64.to_radians(), 0.0));
    let floor = [2.05, 3.05, 4.05].map(|x| (t_map_base.inverse() * Point3::new(x, 0.05, 0.02)).cast::<f32>());
    let mut grid = grid();
    grid.integrate(&t_map_base, &spatial(0.5, floor.to_vec())).unwrap();
    let dense = grid.dense(1_000_000).unwrap();
    assert!(dense.cells.iter().all(|v| *v < 50), "the floor is no obstacle");
    assert!(grid.log_odds(Cell::new(40, 0)).unwrap() < 0.0);
}

#[test]
fn the_band_is_measured_from_the_floor_where_base_is_a_camera_held_above_it() {
    let in_base = |above_floor: f32, x| Point3::new(x, 0.05, above_floor - 1.4);
    let hits = vec![in_base(0.02, 2.05), in_base(0.3, 4.05), in_base(2.2, 3.05)];
    let scan = KeyframeScan { base_height_m: 1.4, ..spatial(0.0, hits) };
    let mut grid = grid();
    grid.integrate(&se3::from_xy_yaw(0.0, 0.0, 0.0), &scan).unwrap();
    assert!(grid.log_odds(Cell::new(40, 0)).unwrap() > 0.0, "0.3 m above the floor");
    assert!((0..40).all(|x| grid.log_odds(Cell::new(x, 0)).unwrap() < 0.0), "floor and what hangs above");
    let unknown_height = KeyframeScan { base_height_m: f64::NAN, ..scan };
    assert!(matches!(grid.integrate(&Pose::identity(), &unknown_height), Err(MappingError::Scan(_))));
}

#[test]
fn the_floor_seen_under_a_table_does_not_free_its_top_but_a_look_over_it_does() {
    let mut grid = grid();
    let cell = Cell::new(20, 0);
    // A camera at 0.5 m sees a table's edge 2.05 m away, 0.72 m above the floor.
    grid.integrate(&Pose::identity(), &spatial(0.5, vec![Point3::new(2.05, 0.05, 0.72)])).unwrap();
    let marked = grid.log_odds(cell).unwrap();
    assert!(marked > 0.0);
    // Nearer, the edge is out of view: the floor and the wall's foot behind are seen under it.
    let under = vec![Point3::new(3.05, 0.05, 0.0), Point3::new(4.05, 0.05, 0.1)];
    for _ in 0..20 {
        grid.integrate(&Pose::identity(), &spatial(0.5, under.clone())).unwrap();
    }
    assert_eq!(grid.log_odds(cell), Some(marked));
    assert!(grid.log_odds(Cell::new(10, 0)).unwrap() < 0.0, "before the table the floor is free");
    // Once the table is gone, the wall is seen through its place.
    let through = vec![Point3::new(3.05, 0.05, 0.0), Point3::new(4.05, 0.05, 0.925)];
    for _ in 0..3 {
        grid.integrate(&Pose::identity(), &spatial(0.5, through.clone())).unwrap();
    }
    assert!(grid.log_odds(cell).unwrap() < 0.0);
}

#[test]
fn a_drop_ahead_is_not_free() {
    // A camera at 1 m sees the ground 2 m below the floor, 6 m away: over the edge at about 2.4 m (0.2 m below band).
    let mut grid = grid();
    grid.integrate(&Pose::identity(), &spatial(1.0, vec![Point3::new(6.05, 0.05, -2.0)])).unwrap();
    assert!(grid.log_odds(Cell::new(15, 0)).unwrap() < 0.0);
    assert_eq!(grid.log_odds(Cell::new(30, 0)), None);
}

#[test]
fn points_without_meaning_say_nothing() {
    let mut grid = grid();
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    grid.integrate(&Pose::identity(), &planar(&[[nan, 1.0], [inf, 0.0], [0.01, 0.0]], &[[nan, nan]])).unwrap();
    grid.integrate(&Pose::identity(), &spatial(0.5, vec![Point3::new(nan, 0.0, 0.5), Point3::new(1.0, inf, 0.5)]))
        .unwrap();
    assert!(grid.is_empty());
    grid.integrate(&se3::from_xy_yaw(1e12, 0.0, 0.0), &planar(&[[1.0, 1.0]], &[])).unwrap();
    assert!(grid.is_empty(), "beyond the range of the indices");
    let broken = se3::from_xy_yaw(f64::NAN, 0.0, 0.0);
    assert_eq!(grid.integrate(&broken, &planar(&[[1.0, 1.0]], &[])), Err(MappingError::PoseNotFinite));
}

#[test]
fn an_imported_rectangle_comes_back_cell_for_cell() {
    let geometry = GridGeometry::new(0.05, Point2::new(-10.23, 4.71));
    let cells: Vec<i8> = (0..130 * 70).map(|i| [-1, 12, 50, 97, 80, 100, 0][(i * i + i / 7) % 7]).collect();
    let dense = DenseGrid::new(geometry, 130, 70, cells.clone()).unwrap();
    let grid =
        OccupancyGrid::from_dense(&dense, OccupancyParams { range_max_m: Some(5.0), ..Default::default() }).unwrap();
    let (min, max) = grid.bounds().unwrap();
    assert_eq!((min, max), (Cell::new(0, 0), Cell::new(129, 69)));
    let back = grid.dense(1_000_000).unwrap();
    assert_eq!((back.width, back.height), (130, 70));
    assert_eq!(back.geometry, geometry);
    for (a, b) in cells.iter().zip(&back.cells) {
        // Clamped to 0.12 and 0.97.
        assert_eq!(*b, if *a < 0 { -1 } else { (*a).clamp(12, 97) });
    }
}

#[test]
fn regions_are_bounded_and_faults_named() {
    let mut grid = grid();
    assert_eq!(grid.dense(0).unwrap().cells.len(), 0);
    grid.integrate(&Pose::identity(), &planar(&[[1.05, 0.05]], &[])).unwrap();
    let (a, b) = (Cell::new(0, 0), Cell::new(9, 9));
    assert_eq!(grid.region(a, b, 100).unwrap().cells.len(), 100);
    assert_eq!(grid.region(a, b, 99), Err(MappingError::RegionTooLarge { cells: 100, limit: 99 }));
    assert_eq!(grid.region(b, a, 99), Err(MappingError::RegionEmpty));
    let all = (Cell::new(i32::MIN, i32::MIN), Cell::new(i32::MAX, i32::MAX));
    assert!(matches!(grid.region(all.0, all.1, 1 << 30), Err(MappingError::RegionTooLarge { .. })));
    let geometry = grid.geometry();
    assert!(matches!(DenseGrid::new(geometry, 2, 2, vec![0; 3]), Err(MappingError::GridShape { cells: 3, .. })));
    assert!(matches!(DenseGrid::new(geometry, 1, 2, vec![0, 101]), Err(MappingError::CellValue { index: 1, .. })));
}

#[test]
fn a_planar_beam_under_a_table_top_does_not_free_it_but_a_look_through_it_does() {
    let mut map = grid();
    let top: Vec<Point3<f32>> = vec![Point3::new(2.05, 0.0, 0.72)];
    let cell = map.geometry().cell(&nalgebra::Point2::new(2.05, 0.0)).unwrap();
    map.integrate(&Pose::identity(), &spatial(0.6, top)).unwrap();
    let seen = map.log_odds(cell).unwrap();
    assert!(seen > 0.0);
    for _ in 0..20 {
        map.integrate(&Pose::identity(), &planar(&[[5.0, 0.0]], &[])).unwrap();
    }
    assert_eq!(map.log_odds(cell), Some(seen));
    // Carried away: a sensor that sees the whole band looks through its place.
    for _ in 0..20 {
        map.integrate(&Pose::identity(), &spatial(0.6, vec![Point3::new(5.0, 0.0, 0.892)])).unwrap();
    }
    assert!(map.log_odds(cell).unwrap() < 0.0);
}
