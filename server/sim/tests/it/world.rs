//! Worlds and drives: furniture apart, lanes free, motion within its limits.

use crate::{world, world_params};
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{Cell, ObjectClass, se3};
use percept_sim::{RobotParams, RobotPath, SimError, TrueObject, TrueOccupancy, World, WorldParams};

const ROBOT_RADIUS_M: f64 = 0.22;

/// Distance between the sides of two upright boxes' footprints, by their corners and edges.
fn gap(a: &TrueObject, b: &TrueObject) -> f64 {
    let (p, q) = (a.bbox.footprint(), b.bbox.footprint());
    if percept_geometry::shapes::convex_intersection_area(&p, &q) > 0.0 {
        return 0.0;
    }
    let one_way = |p: &[Point2<f64>; 4], q: &[Point2<f64>; 4]| {
        let mut best = f64::INFINITY;
        for v in p {
            for i in 0..4 {
                let ab = q[(i + 1) % 4] - q[i];
                let s = ((v - q[i]).dot(&ab) / ab.norm_squared()).clamp(0.0, 1.0);
                best = best.min((v - (q[i] + ab * s)).norm());
            }
        }
        best
    };
    one_way(&p, &q).min(one_way(&q, &p))
}

/// Whether a disc reaches into an occupied cell.
fn collides(grid: &TrueOccupancy, p: &Point2<f64>, radius: f64) -> bool {
    let half = 0.5 * grid.geometry.resolution_m;
    let reach = (radius / grid.geometry.resolution_m).ceil() as i32 + 1;
    let middle = grid.geometry.cell(p).unwrap();
    (-reach..=reach).any(|dy| {
        (-reach..=reach).any(|dx| {
            let cell = Cell::new(middle.x + dx, middle.y + dy);
            let d = (grid.geometry.center(cell) - p).map(|c| (c.abs() - half).max(0.0));
            grid.at(cell) == Some(true) && d.norm() < radius
        })
    })
}

#[test]
fn the_drive_visits_every_room_and_touches_nothing() {
    for seed in 0..20 {
        for rooms in [1 + (seed as usize % 6), 1 + ((seed as usize + 3) % 6)] {
            let world = world(seed, rooms);
            let path = RobotPath::new(&world, &RobotParams::default()).unwrap();
            let grid = world.occupancy(0.02, (0.02, 1.8)).unwrap();
            let mut visited = vec![false; rooms];
            let steps = (path.lap_duration_s() / 0.05) as usize;
            for i in 0..steps {
                let t = i as f64 * 0.05;
                let p = Point2::from(path.pose_at(t).translation.vector.xy());
                assert!(!collides(&grid, &p, ROBOT_RADIUS_M), "seed {seed}, {rooms} rooms, {p} at {t} s");
                for room in world.rooms().iter().filter(|room| room.contains(&p)) {
                    visited[room.id] = true;
                }
            }
            assert!(visited.iter().all(|&v| v), "seed {seed}: {visited:?}");
        }
    }
}

#[test]
fn robot_and_person_never_touch() {
    for seed in 0..10 {
        let world = world(seed, 3);
        let path = RobotPath::new(&world, &RobotParams::default()).unwrap();
        for i in 0..4000 {
            let t = f64::from(i) * 0.1;
            let robot = path.pose_at(t).translation.vector.xy();
            let objects = world.objects_at(t);
            let person = objects.last().unwrap();
            assert_eq!((person.class, person.moving), (ObjectClass::Person, true));
            assert!((person.bbox.center().xy().coords - robot).norm() > ROBOT_RADIUS_M + 0.25);
            if i % 20 == 0 {
                let nearest = objects[..objects.len() - 1].iter().map(|o| gap(person, o)).fold(1e9, f64::min);
                assert!(nearest > 0.2, "seed {seed}: {nearest} m from furniture");
            }
        }
    }
}

#[test]
fn furniture_stands_apart_and_in_its_room() {
    let mut seen = std::collections::BTreeMap::new();
    for seed in 0..10 {
        let world = world(seed, 4);
        let objects = world.objects_at(0.0);
        assert!(objects.len() >= 16, "seed {seed}: only {} objects", objects.len());
        for (i, a) in objects.iter().enumerate() {
            *seen.entry(a.class).or_insert(0) += 1;
            assert_eq!(a.id as usize, i);
            let corners = a.bbox.footprint();
            let room = world.rooms().iter().find(|room| corners.iter().all(|c| room.contains(c))).unwrap();
            // Everything stands on the floor.
            assert!((a.bbox.center().z - 0.5 * a.bbox.size.z).abs() < 1e-9);
            let neighbours = objects[..i].iter().filter(|b| room.contains(&b.bbox.center().xy()));
            for b in neighbours.filter(|_| !a.moving) {
                assert!(gap(a, b) > 0.35 - 1e-9, "seed {seed}: {a:?} {b:?}");
            }
        }
    }
    assert_eq!(seen.len(), 6, "{seen:?}");
    assert!(seen.iter().all(|(&class, &n)| class == ObjectClass::Person || n >= 20), "{seen:?}");
}

#[test]
fn boxes_of_objects_hold_exactly_what_rays_hit() {
    let world = world(5, 4);
    for object in world.objects_at(2.0) {
        let (center, size) = (object.bbox.center(), object.bbox.size);
        let reach = 0.5 * size.norm() + 0.1;
        let mut top = 0.0f64;
        for i in 0..400 {
            let angle = f64::from(i) * 2.399963;
            let from = center + Vector3::new(angle.cos(), angle.sin(), (f64::from(i) / 200.0 - 1.0) * 0.8) * reach;
            let aim = center + Vector3::new(0.0, 0.0, (f64::from(i % 20) / 19.0 - 0.5) * size.z * 0.999);
            let Some(hit) = world.cast(&from, &(aim - from), 2.0, 2.0) else { continue };
            if hit.object == Some(object.id) {
                let p = from + (aim - from) * hit.distance;
                let grown = percept_geometry::OrientedBox3 { size: size.add_scalar(1e-6), ..object.bbox };
                assert!(grown.contains(&p), "{object:?} {p}");
                assert!(world.surface_distance_at(&p, 2.0) < 1e-9);
                top = top.max(p.z);
            }
        }
        assert!(top > 0.8 * size.z, "{object:?} seen up to {top}");
    }
}

#[test]
fn cells_that_are_free_have_no_surface_in_them() {
    let world = world(7, 4);
    let grid = world.occupancy(0.05, (0.1, 1.8)).unwrap();
    let mut occupied = 0;
    for y in 0..grid.height as i32 {
        for x in 0..grid.width as i32 {
            let cell = Cell::new(x, y);
            let p = grid.geometry.center(cell);
            if grid.at(cell) == Some(true) {
                occupied += 1;
                continue;
            }
            for k in 0..17 {
                let z = 0.15 + 0.1 * f64::from(k);
                assert!(world.surface_distance(&Point3::new(p.x, p.y, z)) >= 0.025 - 1e-9, "{p} {z}");
            }
        }
    }
    // Walls alone are about a tenth of the plan; rooms are mostly free.
    let share = f64::from(occupied) / grid.cells.len() as f64;
    assert!((0.05..0.4).contains(&share), "{share}");
}

#[test]
fn motion_is_smooth_and_within_its_limits() {
    let params = RobotParams::default();
    for seed in 0..6 {
        let path = RobotPath::new(&world(seed, 1 + seed as usize), &params).unwrap();
        let lap = path.lap_duration_s();
        assert!(se3::log(&(path.pose_at(0.0).inverse() * path.pose_at(lap - 1e-9))).norm() < 1e-3);
        let h = 1e-4;
        let (mut fastest, mut turned) = (0.0f64, 0.0);
        for i in 0..(lap / 0.02) as usize {
            let t = 0.01 + i as f64 * 0.02;
            let state = path.state_at(t);
            let step = se3::log(&(path.pose_at(t - h).inverse() * path.pose_at(t + h))) / (2.0 * h);
            assert!((step[0] - state.speed_m_per_s).abs() < 0.01, "at {t}: {step} {state:?}");
            assert!(step[1].abs() < 0.01, "slides sideways at {t}: {step}");
            assert!((step[5] - state.yaw_rate_rad_per_s).abs() < 0.02, "at {t}: {step} {state:?}");
            assert!(state.speed_m_per_s < params.speed_m_per_s + 1e-9);
            assert!(state.yaw_rate_rad_per_s.abs() < params.turn_rate_rad_per_s * 1.05, "{state:?}");
            assert!(state.acceleration_m_per_s2.x.abs() < params.acceleration_m_per_s2 + 1e-6, "{state:?}");
            fastest = fastest.max(state.speed_m_per_s);
            turned += state.yaw_rate_rad_per_s.abs() * 0.02;
        }
        assert!(fastest > 0.59);
        // One turn on the spot and once around the ring in every room.
        assert!(turned > 0.9 * 2.0 * std::f64::consts::TAU * (1 + seed) as f64, "{turned}");
    }
}

#[test]
fn the_same_seed_gives_the_same_world_and_another_another() {
    assert_eq!(world(3, 4), world(3, 4));
    assert_ne!(world(3, 4).objects_at(0.0), world(4, 4).objects_at(0.0));
}

#[test]
fn figures_out_of_bounds_are_named() {
    let refused = |params: WorldParams| match World::generate(&params).unwrap_err() {
        SimError::OutOfRange { field, .. } => field,
    };
    assert_eq!(refused(WorldParams { rooms: 0, ..world_params(1, 1) }), "rooms");
    assert_eq!(refused(WorldParams { rooms: 257, ..world_params(1, 1) }), "rooms");
    assert_eq!(refused(WorldParams { room_min_m: f64::NAN, ..world_params(1, 1) }), "room_min_m");
    assert_eq!(refused(WorldParams { furniture_per_m2: 1.1, ..world_params(1, 1) }), "furniture_per_m2");
    assert!(World::generate(&WorldParams { rooms: 256, person: false, ..world_params(1, 1) }).is_ok());
    assert!(matches!(world(1, 1).occupancy(1e-6, (0.1, 1.8)), Err(SimError::OutOfRange { .. })));
    let robot = RobotParams { turn_rate_rad_per_s: 0.0, ..RobotParams::default() };
    assert!(RobotPath::new(&world(1, 1), &robot).is_err());
}
