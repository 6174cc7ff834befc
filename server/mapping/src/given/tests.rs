//! Maps that are given and looked at show what was in them.

use super::*;
use crate::voxels::{VoxelReader, VoxelState};
use crate::{DenseGrid, Map, MapEntry, MapParams, MappingError, Occupancy, VoxelParams};
use nalgebra::Point2;
use percept_geometry::{Cell, GridGeometry, KeyframeId, Voxel};
use std::cell::RefCell;
use std::sync::Arc;

const OPTIONS: GivenOptions = GivenOptions { range_max_m: 10.0, sensor_height_m: 0.3 };

/// Two rooms of 6 x 5 m joined by a door, with a pillar in one, in cells of 0.05 m, 1 m of nothing known around.
fn two_rooms() -> DenseGrid {
    let (width, height) = (280, 140);
    let mut cells = vec![-1i8; width * height];
    let mut fill = |x: std::ops::Range<usize>, y: std::ops::Range<usize>, v: i8| {
        y.for_each(|y| x.clone().for_each(|x| cells[y * width + x] = v));
    };
    fill(18..262, 18..122, 100);
    fill(20..138, 20..120, 0);
    fill(142..260, 20..120, 0);
    fill(138..142, 60..80, 0);
    fill(200..206, 60..66, 100);
    DenseGrid::new(GridGeometry::new(0.05, Point2::new(-3.0, -2.0)), width, height, cells).unwrap()
}

fn map_of(views: &GivenViews, resolution_m: f64) -> Map {
    let mut params = MapParams::default();
    params.occupancy.resolution_m = resolution_m;
    map_with(views, params)
}

fn map_with(views: &GivenViews, params: MapParams) -> Map {
    let mut map = Map::new(params).unwrap();
    for (k, v) in views.views.iter().enumerate() {
        let entry = MapEntry { t_map_base: v.t_map_base, t_odom_base: v.t_map_base, after_gap: false };
        map.insert(KeyframeId(k as u64), &entry, Arc::new(v.scan.clone())).unwrap();
    }
    map
}

#[test]
fn a_grid_comes_back_from_its_views() {
    let given = two_rooms();
    let views = views_of_grid(&given, &OPTIONS).unwrap();
    assert!(views.free_share > 0.999, "{}", views.free_share);
    let map = map_of(&views, 0.05);
    let layers = map.layers();
    let (mut free, mut occupied, mut wrong) = (0, 0, 0);
    let (origin, width) = (given.geometry.origin, given.width);
    for (k, value) in given.cells.iter().enumerate() {
        let center = given.geometry.center(Cell::new((k % width) as i32, (k / width) as i32));
        let cell = GridGeometry::new(0.05, Point2::origin()).cell(&center).unwrap();
        let now = layers.occupancy.probability(cell);
        let is_free = |dx: i64, dy: i64| {
            let (x, y) = ((k % width) as i64 + dx, (k / width) as i64 + dy);
            given.cells.get((y * width as i64 + x) as usize) == Some(&0)
        };
        match (value, now) {
            (0, Some(p)) if p < 0.5 => free += 1,
            (100, Some(p)) if p > 0.64 => occupied += 1,
            (-1, None) => {}
            // Inside of walls, and behind the corner that two walls make, nothing is seen.
            (100, None) if ![(1, 0), (-1, 0), (0, 1), (0, -1)].iter().any(|(x, y)| is_free(*x, *y)) => {}
            _ => wrong += 1,
        }
    }
    assert_eq!(wrong, 0, "free {free}, occupied {occupied}, origin {origin}");
    assert!(free == 23_644 && occupied > 850, "free {free}, occupied {occupied}");
}

#[test]
fn views_near_each_other_follow_on_each_other() {
    let views = views_of_grid(&two_rooms(), &OPTIONS).unwrap().views;
    assert!((20..120).contains(&views.len()), "{}", views.len());
    let steps =
        views.windows(2).map(|w| (w[0].t_map_base.translation.vector - w[1].t_map_base.translation.vector).norm());
    assert!(steps.clone().sum::<f64>() / (views.len() - 1) as f64 <= 2.5);
    assert!(views.iter().all(|v| v.scan.planar && is_given(&v.scan.sensor)));
}

#[test]
fn a_grid_without_a_free_cell_is_refused() {
    let grid = DenseGrid::new(GridGeometry::new(0.05, Point2::origin()), 3, 1, vec![100, -1, 50]).unwrap();
    assert_eq!(views_of_grid(&grid, &OPTIONS), Err(MappingError::NothingFree));
    let empty = DenseGrid::new(GridGeometry::new(0.05, Point2::origin()), 0, 0, vec![]).unwrap();
    assert_eq!(views_of_grid(&empty, &OPTIONS), Err(MappingError::NothingFree));
}

/// Floor, walls, ceiling and a table of a room of 8 x 6 x 2.5 m, points each 5 cm.
fn room() -> PointCloud {
    let mut points = vec![];
    let mut plane = |a: [f32; 3], u: [f32; 3], v: [f32; 3]| {
        let length = |d: [f32; 3]| d.iter().map(|x| x * x).sum::<f32>().sqrt();
        let (nu, nv) = ((length(u) / 0.05) as i32, (length(v) / 0.05) as i32);
        for i in 0..=nu {
            for j in 0..=nv {
                let (s, t) = (i as f32 / nu as f32, j as f32 / nv as f32);
                points.push(Point3::new(
                    a[0] + s * u[0] + t * v[0],
                    a[1] + s * u[1] + t * v[1],
                    a[2] + s * u[2] + t * v[2],
                ));
            }
        }
    };
    plane([0.0, 0.0, 0.0], [8.0, 0.0, 0.0], [0.0, 6.0, 0.0]);
    plane([0.0, 0.0, 2.5], [8.0, 0.0, 0.0], [0.0, 6.0, 0.0]);
    plane([0.0, 0.0, 0.0], [8.0, 0.0, 0.0], [0.0, 0.0, 2.5]);
    plane([0.0, 6.0, 0.0], [8.0, 0.0, 0.0], [0.0, 0.0, 2.5]);
    plane([0.0, 0.0, 0.0], [0.0, 6.0, 0.0], [0.0, 0.0, 2.5]);
    plane([8.0, 0.0, 0.0], [0.0, 6.0, 0.0], [0.0, 0.0, 2.5]);
    plane([5.0, 2.0, 0.75], [1.4, 0.0, 0.0], [0.0, 0.8, 0.0]);
    PointCloud::from_positions(points)
}

#[test]
fn a_cloud_is_looked_at_from_its_floor_and_comes_back() {
    let options = GivenOptions { sensor_height_m: 1.0, ..OPTIONS };
    let space = GivenSpace::of_points(room(), 0.1).unwrap();
    let views = views_of_space(&space, &options).unwrap();
    assert!(views.occupied_share > 0.9, "{}", views.occupied_share);
    for v in &views.views {
        let p = v.t_map_base.translation.vector;
        assert!((0.0..0.11).contains(&p.z), "not on the floor: {p}");
        assert!(p.x > 0.0 && p.x < 8.0 && p.y > 0.0 && p.y < 6.0, "{p}");
    }
    let map = map_of(&views, 0.1);
    let grid = &map.layers().occupancy;
    let at =
        |x: f64, y: f64| grid.probability(GridGeometry::new(0.1, Point2::origin()).cell(&Point2::new(x, y)).unwrap());
    assert!(at(2.0, 3.0).unwrap() < 0.3, "floor {:?}", at(2.0, 3.0));
    assert!(at(5.7, 2.4).unwrap() > 0.6, "table {:?}", at(5.7, 2.4));
    assert!(at(4.03, 0.03).unwrap() > 0.6, "wall {:?}", at(4.03, 0.03));
}

#[test]
fn voxels_say_what_is_free_and_beams_end_where_nothing_is_known() {
    // A floor of 6 x 6 m with 2 m of free space over it; a wall hides unknown space behind it.
    let mut occupied = vec![];
    let mut free = rustc_hash::FxHashSet::default();
    for x in 0..60 {
        for y in 0..60 {
            occupied.push(Voxel::new(x, y, -1));
            (0..20).for_each(|z| _ = free.insert(Voxel::new(x, y, z)));
        }
    }
    for y in 0..60 {
        for z in 0..20 {
            free.remove(&Voxel::new(40, y, z));
            occupied.push(Voxel::new(40, y, z));
        }
    }
    for x in 41..60 {
        (0..60).for_each(|y| (0..20).for_each(|z| _ = free.remove(&Voxel::new(x, y, z))));
    }
    let space = GivenSpace::of_voxels(&occupied, free.into_iter(), 0.1).unwrap();
    let views = views_of_space(&space, &GivenOptions { sensor_height_m: 1.0, ..OPTIONS }).unwrap();
    assert!(views.views.iter().all(|v| v.t_map_base.translation.vector.x < 4.0));
    let far =
        |v: &GivenView| v.scan.hits.positions.iter().all(|p| f64::from(p.x) + v.t_map_base.translation.vector.x < 4.1);
    assert!(views.views.iter().all(far));
}

/// Two rooms of 4 x 5 x 2.4 m of voxels of an edge with a door between them: a table, a box under it, a shelf that is open to the front.
fn furnished(edge: f64) -> (Vec<Voxel>, Vec<Voxel>) {
    let n = |m: f64| (m / edge).round() as i32;
    let is_in = |v: (i32, i32, i32), low: [f64; 3], high: [f64; 3]| {
        (n(low[0])..n(high[0])).contains(&v.0)
            && (n(low[1])..n(high[1])).contains(&v.1)
            && (n(low[2])..n(high[2])).contains(&v.2)
    };
    let (mut occupied, mut free) = (vec![], vec![]);
    for x in -1..=n(8.0) {
        for y in -1..=n(5.0) {
            for z in -1..=n(2.4) {
                let is_shell = x < 0 || y < 0 || z < 0 || x >= n(8.0) || y >= n(5.0) || z >= n(2.4);
                let at = (x, y, z);
                let is_wall =
                    is_in(at, [3.9, 0.0, 0.0], [4.1, 5.0, 2.4]) && !is_in(at, [3.9, 2.0, 0.0], [4.1, 3.0, 2.0]);
                let is_table = is_in(at, [1.0, 1.0, 0.7], [2.4, 1.8, 0.8]);
                let is_box = is_in(at, [1.2, 1.2, 0.0], [1.6, 1.6, 0.4]);
                let is_shelf = is_in(at, [6.0, 4.4, 0.0], [7.2, 5.0, 1.8])
                    && !is_in(at, [6.2, 4.3, 0.2], [7.0, 4.8, 0.8])
                    && !is_in(at, [6.2, 4.3, 1.0], [7.0, 4.8, 1.6]);
                let is_occupied = is_shell || is_wall || is_table || is_box || is_shelf;
                (if is_occupied { &mut occupied } else { &mut free }).push(Voxel::new(x, y, z));
            }
        }
    }
    (occupied, free)
}

#[test]
fn voxels_come_back_as_they_were_given() {
    for edge in [0.1, 0.2] {
        let (occupied, free) = furnished(edge);
        let space = GivenSpace::of_voxels(&occupied, free.iter().copied(), edge).unwrap();
        let views = views_of_space(&space, &GivenOptions { sensor_height_m: 1.0, ..OPTIONS }).unwrap();
        let voxels = VoxelParams { enabled: true, voxel_size_m: edge, ..VoxelParams::default() };
        let params = MapParams { voxels, ..MapParams::default() };
        let layers = map_with(&views, params).layers();
        let reader = RefCell::new(VoxelReader::new(&layers.voxels));
        let state = |v: &Voxel| reader.borrow_mut().state(*v);
        let wrong = (occupied.iter().filter(|v| state(v) == VoxelState::Free))
            .chain(free.iter().filter(|v| state(v) == VoxelState::Occupied));
        assert_eq!(wrong.count(), 0, "edge {edge}");
        let count = |of: &[Voxel], s: VoxelState| of.iter().filter(|v| state(v) == s).count();
        let (num_free, num_occupied) = (count(&free, VoxelState::Free), count(&occupied, VoxelState::Occupied));
        // Base is told in single precision: a beam through a corner may take the other way around it.
        assert!(num_free as f64 > 0.999 * free.len() as f64, "edge {edge}: {num_free} of {}", free.len());
        assert!((views.free_share - num_free as f64 / free.len() as f64).abs() < 1e-3, "{}", views.free_share);
        // What is inside of something thick is seen from nowhere.
        let is_bare = |v: &&Voxel| {
            let beside = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)];
            beside.iter().any(|(x, y, z)| space.is_open(Voxel::new(v.x + x, v.y + y, v.z + z)))
        };
        let num_bare = occupied.iter().filter(is_bare).count();
        assert!(num_occupied as f64 > 0.98 * num_bare as f64, "edge {edge}: {num_occupied} of {num_bare}");
        assert!((views.occupied_share - num_occupied as f64 / occupied.len() as f64).abs() < 1e-3);
    }
}

#[test]
fn more_places_than_there_may_be_are_no_hindrance() {
    // Rooms that no door joins, around the origin, so that cubes of all sizes have several to look from.
    let (mut occupied, mut free) = (vec![], vec![]);
    for (x, y) in (-24..24).flat_map(|x| (-24..24).map(move |y| (x, y))) {
        for z in -1..8 {
            let is_wall = z < 0 || x % 4 == 0 || y % 4 == 0;
            (if is_wall { &mut occupied } else { &mut free }).push(Voxel::new(x, y, z));
        }
    }
    let space = GivenSpace::of_voxels(&occupied, free.into_iter(), 0.5).unwrap();
    let options = GivenOptions { sensor_height_m: 1.0, ..OPTIONS };
    let ground = space.ground(&options);
    let rest: Vec<Voxel> = space.free().collect();
    for most in [0, 1, 3, 7, 20, 1_000] {
        let places = rest::places_within(&space, &ground, &rest, most);
        assert!(places.len() <= most && places.is_empty() == (most == 0), "{most}: {}", places.len());
    }
}

#[test]
fn points_that_are_no_numbers_are_refused() {
    let points = PointCloud::from_positions(vec![Point3::new(f32::NAN, 0.0, 0.0)]);
    assert!(matches!(GivenSpace::of_points(points, 0.1), Err(MappingError::PointTooFar)));
    let none = GivenSpace::of_points(PointCloud::from_positions(vec![]), 0.1).unwrap();
    assert_eq!(views_of_space(&none, &OPTIONS), Err(MappingError::NothingFree));
    let bad = GivenSpace::of_points(PointCloud::from_positions(vec![]), 0.0);
    assert!(matches!(bad, Err(MappingError::InvalidParam { field: "voxel_size_m", .. })));
}

/// A room whose floor nobody saw, with a ceiling: as a lidar of few rings that hardly look down brings it home.
#[test]
fn where_robots_stood_there_is_a_floor() {
    let along =
        |from: f64, to: f64| (0..((to - from) / 0.05) as usize).map(move |i| (from + 0.05 * i as f64 + 0.025) as f32);
    let mut points = vec![];
    for a in along(0.0, 6.0) {
        for b in along(0.2, 2.4) {
            points.extend([[a, 0.05, b], [a, 6.05, b], [0.05, a, b], [6.05, a, b]].map(nalgebra::Point3::from));
        }
        points.extend(along(0.0, 6.0).map(|b| nalgebra::Point3::new(a, b, 2.5)));
    }
    let space = GivenSpace::of_points(PointCloud::from_positions(points), 0.1).unwrap();
    let options = GivenOptions { range_max_m: 10.0, sensor_height_m: 1.0 };
    let stood: Vec<_> = (0..20).map(|i| nalgebra::Point3::new(1.0 + 0.2 * f64::from(i), 3.0, 0.0)).collect();
    let bare = views_of_space(&space, &options).map(|v| v.occupied_share);
    assert!(!bare.as_ref().is_ok_and(|share| *share > 0.9), "{bare:?}");
    let views = views_of_space(&space.with_stood(stood), &options).unwrap();
    assert!(views.occupied_share > 0.99, "{}", views.occupied_share);
    assert!(views.views.iter().all(|v| v.t_map_base.translation.z.abs() < 0.06 && v.t_map_base.translation.x > 0.0));
    let map = map_of(&views, 0.1);
    let occupancy = &map.layers().occupancy;
    let at = |x: f64, y: f64| {
        let cell = GridGeometry::new(0.1, Point2::origin()).cell(&Point2::new(x, y)).unwrap();
        occupancy.probability(cell).unwrap_or(0.5)
    };
    for i in 5..55 {
        let a = 0.1 * f64::from(i) + 0.05;
        assert!([at(a, 0.05), at(0.05, a), at(a, 6.05), at(6.05, a)].iter().all(|p| *p > 0.6), "{a}");
    }
    assert!((10..50).all(|i| at(0.1 * f64::from(i) + 0.05, 3.05) < 0.4));
}
