//! Made-up maps that look like real ones.

use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{Cell, GridGeometry, ObjectClass, OrientedBox3, Pose, se3};
use percept_mapping::{DenseGrid, DenseHeights};
use percept_pictures::{MapObject, Overlay, PathDrawing, PathEnd, PathQuantity, Zone, ZoneKind};

/// Walls of a room with free floor, unknown around it, its lower left corner at (-1, -1) m.
pub(crate) fn empty_room(width: usize, height: usize, resolution_m: f64) -> DenseGrid {
    let cell = |x: usize, y: usize| match x.min(width - 1 - x).min(y).min(height - 1 - y) {
        0 => -1,
        1 => 100,
        _ => 0,
    };
    let cells = (0..width * height).map(|i| cell(i % width, i / width)).collect();
    DenseGrid { geometry: GridGeometry::new(resolution_m, Point2::new(-1.0, -1.0)), width, height, cells }
}

fn rectangle(grid: &mut DenseGrid, low: [f64; 2], high: [f64; 2], value: i8) {
    let cell = |p: [f64; 2]| grid.geometry.cell(&Point2::from(p)).unwrap_or(Cell::new(0, 0));
    let (a, b) = (cell(low), cell(high));
    for y in a.y.max(0)..b.y.min(grid.height as i32) {
        for x in a.x.max(0)..b.x.min(grid.width as i32) {
            grid.cells[y as usize * grid.width + x as usize] = value;
        }
    }
}

/// A flat of three rooms, 11.4 x 7.4 m, cells of 5 cm.
pub(crate) fn flat() -> DenseGrid {
    let (width, height) = (236, 156);
    let geometry = GridGeometry::new(0.05, Point2::new(-0.6, -0.4));
    let mut grid = DenseGrid { geometry, width, height, cells: vec![-1; width * height] };
    rectangle(&mut grid, [0.0, 0.0], [10.8, 7.0], 0);
    let walls = [
        ([0.0, 0.0], [10.8, 0.15]),
        ([0.0, 6.85], [10.8, 7.0]),
        ([0.0, 0.0], [0.15, 7.0]),
        ([10.65, 0.0], [10.8, 7.0]),
        ([4.5, 0.0], [4.65, 2.4]),
        ([4.5, 3.4], [4.65, 7.0]),
        ([4.5, 3.4], [7.0, 3.55]),
        ([8.0, 3.4], [10.8, 3.55]),
    ];
    walls.iter().for_each(|(low, high)| rectangle(&mut grid, *low, *high, 97));
    let things =
        [([1.2, 4.4], [2.8, 5.4]), ([3.9, 0.3], [4.4, 1.7]), ([8.4, 5.2], [10.2, 6.6]), ([6.0, 0.2], [7.2, 0.7])];
    things.iter().for_each(|(low, high)| rectangle(&mut grid, *low, *high, 88));
    rectangle(&mut grid, [9.6, 0.15], [10.65, 1.3], -1);
    // What was seen from afar is less certain.
    rectangle(&mut grid, [8.2, 2.2], [9.6, 3.2], 30);
    grid
}

/// The flat when a table was moved and a box was left in the way.
pub(crate) fn flat_later() -> DenseGrid {
    let mut grid = flat();
    rectangle(&mut grid, [1.2, 4.4], [2.8, 5.4], 0);
    rectangle(&mut grid, [1.2, 2.0], [2.2, 3.6], 88);
    rectangle(&mut grid, [5.6, 2.2], [6.2, 2.7], 92);
    rectangle(&mut grid, [9.6, 0.15], [10.65, 1.3], 0);
    rectangle(&mut grid, [10.0, 0.3], [10.5, 0.9], 90);
    grid
}

fn way() -> Vec<Pose> {
    let corners: [[f64; 2]; 7] = [[1.0, 1.0], [1.0, 3.2], [3.4, 3.0], [5.4, 2.8], [7.4, 2.4], [7.5, 4.4], [6.0, 5.6]];
    let mut poses = vec![];
    for ends in corners.windows(2) {
        let (a, b) = (Point2::from(ends[0]), Point2::from(ends[1]));
        let yaw = (b - a).y.atan2((b - a).x);
        let steps = ((b - a).norm() / 0.05) as usize;
        poses.extend((0..steps).map(|i| {
            let p = a + (b - a) * (i as f64 / steps as f64);
            se3::from_xy_yaw(p.x, p.y, yaw)
        }));
    }
    poses
}

/// Trajectory, things, zones and a path in the flat.
pub(crate) fn overlay() -> Overlay {
    let thing = |id, class, x, y, size: [f64; 3], yaw| MapObject {
        id: Some(id),
        class,
        bbox: OrientedBox3::upright(Point3::new(x, y, 0.5 * size[2]), Vector3::from(size), yaw),
    };
    let corners = |all: &[[f64; 2]]| all.iter().map(|p| Point2::from(*p)).collect();
    Overlay {
        trajectory: way(),
        robot: None,
        objects: vec![
            thing(1, ObjectClass::Table, 2.0, 4.9, [1.6, 1.0, 0.75], 0.0),
            thing(2, ObjectClass::Shelf, 4.15, 1.0, [0.5, 1.4, 1.8], 0.0),
            thing(3, ObjectClass::Chair, 1.6, 3.9, [0.5, 0.5, 0.9], 0.4),
            thing(4, ObjectClass::Chair, 2.5, 3.9, [0.5, 0.5, 0.9], -0.3),
            thing(7, ObjectClass::Person, 6.4, 1.6, [0.6, 0.5, 1.7], 0.8),
            thing(9, ObjectClass::Box, 6.6, 0.45, [1.2, 0.5, 0.6], 0.0),
            thing(12, ObjectClass::Unknown, 9.3, 5.9, [1.8, 1.4, 0.6], 0.0),
            thing(13, ObjectClass::Cylinder, 10.2, 4.0, [0.5, 0.5, 1.0], 0.0),
        ],
        zones: vec![
            Zone { polygon: corners(&[[8.3, 0.3], [9.5, 0.3], [9.5, 1.7], [8.3, 1.4]]), kind: ZoneKind::KeepOut },
            Zone {
                polygon: corners(&[[4.8, 5.9], [7.6, 5.9], [7.6, 6.7], [4.8, 6.7]]),
                kind: ZoneKind::SpeedLimit { share: 0.3 },
            },
        ],
        masks: vec![],
        path: [[6.0, 5.6], [7.4, 4.4], [7.5, 2.6], [9.0, 2.0], [10.2, 2.2]].iter().map(|p| Point2::from(*p)).collect(),
        rooms: vec![],
    }
}

/// More things than labels fit.
pub(crate) fn crowd() -> Overlay {
    let thing = |i: u32| {
        let (x, y) = (0.4 + 0.5 * f64::from(i % 20), 0.4 + 0.32 * f64::from(i / 20));
        let class = ObjectClass::BUILT_IN[i as usize % 7];
        let bbox = OrientedBox3::upright(Point3::new(x, y, 0.3), Vector3::new(0.2, 0.2, 0.6), 0.1 * f64::from(i));
        MapObject { id: Some(u64::from(i)), class, bbox }
    };
    Overlay { objects: (0..400).map(thing).collect(), ..Overlay::default() }
}

/// A robot that went along x.
pub(crate) fn walk() -> Overlay {
    let trajectory =
        (0..500).map(|i| se3::from_xy_yaw(0.1 * f64::from(i), 0.3 * (0.05 * f64::from(i)).sin(), 0.1)).collect();
    Overlay { trajectory, ..Overlay::default() }
}

fn robot() -> Vec<Point2<f64>> {
    [[0.35, 0.25], [0.45, 0.0], [0.35, -0.25], [-0.35, -0.25], [-0.35, 0.25]].iter().map(|p| Point2::from(*p)).collect()
}

/// A path with its clearance to the walls.
pub(crate) fn path() -> PathDrawing {
    let (poses, grid) = (way(), flat());
    let clearance = |pose: &Pose| {
        let p = Point2::from(pose.translation.vector.xy());
        let occupied = (0..grid.cells.len()).filter(|i| grid.cells[*i] > 50);
        let distance =
            |i: usize| (grid.geometry.center(Cell::new((i % grid.width) as i32, (i / grid.width) as i32)) - p).norm();
        occupied.map(distance).fold(9.0, f64::min)
    };
    let values = poses.iter().map(clearance).collect();
    PathDrawing { poses, values, quantity: PathQuantity::Clearance, footprint: robot(), ..PathDrawing::default() }
}

/// A goal behind a wall.
pub(crate) fn no_path() -> PathDrawing {
    PathDrawing {
        start: Some(PathEnd { position: Point2::new(1.0, 1.0), yaw_rad: Some(1.0) }),
        goal: Some(PathEnd { position: Point2::new(10.2, 0.7), yaw_rad: None }),
        blocking: Some(Point2::new(9.62, 0.9)),
        reason: Some("the goal lies in unknown space, nothing was seen there".to_owned()),
        footprint: robot(),
        zones: overlay().zones,
        ..PathDrawing::default()
    }
}

/// A yard with a hill, a ramp to a platform, and a pit.
pub(crate) fn hills() -> DenseHeights {
    let (width, height) = (320, 220);
    let geometry = GridGeometry::new(0.1, Point2::new(-4.0, -3.0));
    let ground = |i: usize| {
        let p = geometry.center(Cell::new((i % width) as i32, (i / width) as i32));
        let hill = 3.2 * (-((p.x - 7.0).powi(2) + (p.y - 9.0).powi(2)) / 30.0).exp();
        let platform =
            if (16.0..26.0).contains(&p.x) && (2.0..8.0).contains(&p.y) { (0.25 * (p.x - 16.0)).min(1.2) } else { 0.0 };
        let seen = (p.x - 12.0).powi(2) / 1.6 + (p.y - 8.0).powi(2) < 130.0;
        if seen { (hill + platform + 0.01 * (3.0 * p.x).sin()) as f32 } else { f32::NAN }
    };
    let mut ground_m: Vec<f32> = (0..width * height).map(ground).collect();
    let is_drop: Vec<bool> =
        (0..width * height).map(|i| (230..246).contains(&(i % width)) && (150..166).contains(&(i / width))).collect();
    ground_m.iter_mut().zip(&is_drop).filter(|(_, drop)| **drop).for_each(|(z, _)| *z = f32::NAN);
    let nothing = vec![f32::NAN; width * height];
    DenseHeights {
        geometry,
        width,
        height,
        sigma_m: vec![0.01; width * height],
        top_m: nothing.clone(),
        overhang_m: nothing,
        num_keyframes: vec![5; width * height],
        ground_m,
        is_drop,
    }
}
