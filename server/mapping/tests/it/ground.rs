//! Ground that is not flat, by rays over heights that are written down.

use crate::scans::spatial;
use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};
use percept_geometry::{KeyframeScan, Pose};
use percept_mapping::{Occupancy, OccupancyGrid, OccupancyParams};

/// What a lidar of 64 rings, `height` (m) above the ground at (`x`, 0), sees of a surface: where each beam goes below it, to 25 m.
pub(crate) fn seen(x: f64, height: f64, surface: impl Fn(f64, f64) -> f64) -> (Pose, KeyframeScan) {
    // As a robot stands there.
    let rise = (surface(x + 0.2, 0.0) - surface(x - 0.2, 0.0)) / 0.4;
    let pitch = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -rise.atan());
    let t_map_base = Pose::from_parts(Vector3::new(x, 0.0, surface(x, 0.0)).into(), pitch);
    let sensor = t_map_base * Point3::new(0.0, 0.0, height);
    let mut hits = vec![];
    for ring in 0..64 {
        let elevation = (-40.0 + 0.7 * f64::from(ring)).to_radians();
        for column in 0..900 {
            let azimuth = f64::from(column) * 0.4f64.to_radians() + 1e-3;
            let d = Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            let below = |r: f64| {
                let p = sensor + d * r;
                p.z <= surface(p.x, p.y)
            };
            let Some(step) = (1..1250).find(|step| below(f64::from(*step) * 0.02)) else { continue };
            let (mut free, mut hit) = (f64::from(step - 1) * 0.02, f64::from(step) * 0.02);
            for _ in 0..10 {
                let middle = 0.5 * (free + hit);
                if below(middle) { hit = middle } else { free = middle }
            }
            hits.push((t_map_base.inverse() * (sensor + d * hit)).cast::<f32>());
        }
    }
    (t_map_base, spatial(height, hits))
}

/// The grid after a look from each place along x.
fn mapped(from: &[f64], height: f64, surface: impl Fn(f64, f64) -> f64) -> OccupancyGrid {
    let mut grid = OccupancyGrid::new(OccupancyParams::default()).unwrap();
    for x in from {
        let (t_map_base, scan) = seen(*x, height, &surface);
        grid.integrate(&t_map_base, &scan).unwrap();
    }
    grid
}

/// Cells that are free, occupied and unknown among those whose centres are asked for, every decimetre.
fn count(grid: &OccupancyGrid, x: (f64, f64), y: (f64, f64)) -> [usize; 3] {
    let mut out = [0; 3];
    let steps = |(a, b): (f64, f64)| (0..=((b - a) * 10.0).round() as i32).map(move |i| a + f64::from(i) * 0.1 + 0.05);
    for (x, y) in steps(x).flat_map(|x| steps(y).map(move |y| (x, y))) {
        match grid.geometry().cell(&Point2::new(x, y)).and_then(|c| grid.log_odds(c)) {
            Some(v) => out[usize::from(v > 0.0)] += 1,
            None => out[2] += 1,
        }
    }
    out
}

#[test]
fn ramps_hills_and_camber_are_ground() {
    // A tenth steep from 4 m on for 8 m, level above; a street that falls to both sides and goes over a hill.
    let ramp = |x: f64, _: f64| 0.1 * (x - 4.0).clamp(0.0, 8.0);
    let street = |x: f64, y: f64| 1.5 * (x * 0.12).sin() - 0.03 * y.abs();
    for (name, grid) in
        [("ramp", mapped(&[0.0, 5.0, 10.0], 1.2, ramp)), ("street", mapped(&[0.0, 4.0, 8.0], 1.7, street))]
    {
        let [free, occupied, unknown] = count(&grid, (0.0, 12.0), (-3.0, 3.0));
        assert!(occupied == 0 && free > 50 * unknown, "{name}: {free} free, {occupied} occupied, {unknown} unknown");
    }
}

#[test]
fn what_stands_on_a_slope_is_occupied_and_the_slope_beside_it_is_not() {
    let slope = |x: f64, y: f64| {
        let stands = (7.0..7.6).contains(&x) && (-0.5..0.5).contains(&y);
        0.12 * x + if stands { 0.4 } else { 0.0 }
    };
    let grid = mapped(&[0.0, 2.0, 4.0], 1.2, slope);
    let [_, occupied, _] = count(&grid, (7.0, 7.0), (-0.4, 0.4));
    assert!(occupied >= 8, "{occupied} of its near face");
    assert_eq!(count(&grid, (1.0, 6.7), (-3.0, 3.0))[1], 0);
    // It is seen over, too.
    let [free, occupied, _] = count(&grid, (9.0, 11.0), (-0.2, 0.2));
    assert!(free > 60 && occupied == 0, "{free} free behind it");
}

#[test]
fn a_kerb_is_occupied_and_the_pavement_behind_it_is_ground() {
    let kerb = |_: f64, y: f64| if y > 3.0 { 0.15 } else { 0.0 };
    let grid = mapped(&[0.0, 1.0, 2.0], 1.7, kerb);
    let [free, occupied, _] = count(&grid, (-1.0, 4.0), (3.0, 3.0));
    assert!(occupied > 5 * free, "{occupied} of the kerb's edge occupied, {free} free");
    assert_eq!(count(&grid, (-1.0, 4.0), (-2.0, 2.8))[1], 0, "the street is free");
    let [free, occupied, unknown] = count(&grid, (-1.0, 4.0), (4.0, 6.0));
    assert!(free > 10 * (occupied + unknown), "{free} of the pavement free, {occupied} occupied, {unknown} unknown");
}

#[test]
fn tables_and_beds_are_no_ground_though_nothing_is_seen_before_them() {
    // Only what is 2 m away and more: a table's top, a bed's.
    for height in [0.45, 0.7] {
        let (t_map_base, scan) = seen(0.0, 1.2, |x, _| if x > 2.0 { height } else { 0.0 });
        let far = scan.hits.positions.iter().filter(|p| p.x > 2.1).copied().collect();
        let mut grid = OccupancyGrid::new(OccupancyParams::default()).unwrap();
        grid.integrate(&t_map_base, &spatial(1.2, far)).unwrap();
        let [free, occupied, _] = count(&grid, (2.3, 3.5), (-0.5, 0.5));
        assert!(occupied > 50 && free == 0, "{height} m: {occupied} occupied, {free} free");
    }
}

#[test]
fn where_the_ground_drops_nobody_drives_and_where_it_falls_slowly_one_may() {
    let stairs = |x: f64, _: f64| if x > 2.0 { -0.17 * ((x - 2.0) / 0.28).ceil() } else { 0.0 };
    let pit = |x: f64, y: f64| if (1.6..4.0).contains(&x) && y.abs() < 1.0 { -1.0 } else { 0.0 };
    for (name, grid, x) in [
        ("stairs", mapped(&[0.0, 0.5, 1.0], 1.2, stairs), (2.0, 2.4)),
        ("pit", mapped(&[0.0, 0.4], 1.2, pit), (1.5, 1.9)),
    ] {
        for y in (-5..5).map(|i| f64::from(i) * 0.1) {
            assert!(count(&grid, x, (y, y))[1] > 0, "{name}: the edge at y {y}");
        }
        assert_eq!(count(&grid, (0.3, x.0 - 0.2), (-0.8, 0.8))[1], 0, "{name}: the floor before it");
    }
    let falls = mapped(&[0.0, 2.0, 4.0], 1.2, |x: f64, _: f64| -0.12 * (x - 2.0).clamp(0.0, 6.0));
    let [free, occupied, unknown] = count(&falls, (0.0, 8.0), (-2.0, 2.0));
    assert!(occupied == 0 && free > 20 * unknown, "{free} free, {occupied} occupied, {unknown} unknown");
}
