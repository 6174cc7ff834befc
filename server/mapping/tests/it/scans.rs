//! Scans built by hand.

use nalgebra::Point3;
use percept_geometry::{KeyframeScan, PointCloud, Pose, SensorId, Timestamp, se3};

/// A planar scan whose sensor sits at base.
pub(crate) fn planar(hits: &[[f32; 2]], misses: &[[f32; 2]]) -> KeyframeScan {
    let lift = |ps: &[[f32; 2]]| ps.iter().map(|p| Point3::new(p[0], p[1], 0.0)).collect::<Vec<_>>();
    KeyframeScan {
        stamp: Timestamp(0),
        sensor: SensorId::from("lidar"),
        t_base_sensor: Pose::identity(),
        hits: PointCloud::from_positions(lift(hits)),
        misses: lift(misses),
        base_height_m: 0.0,
        planar: true,
        features: None,
    }
}

/// A 3D scan whose sensor sits `height` above base.
pub(crate) fn spatial(height: f64, hits: Vec<Point3<f32>>) -> KeyframeScan {
    let mut t_base_sensor = se3::from_xy_yaw(0.0, 0.0, 0.0);
    t_base_sensor.translation.vector.z = height;
    KeyframeScan { planar: false, t_base_sensor, hits: PointCloud::from_positions(hits), ..planar(&[], &[]) }
}

/// What a sensor at `height` sees in a square room of half width `half` and 2.5 m height with the floor at z = 0,
/// and of an upright pillar at (`x`, 0) of radius 0.25 m and height 1.7 m, if any: a beam each `step` radians.
pub(crate) fn room(height: f64, half: f64, pillar_x: Option<f64>, step: f64) -> KeyframeScan {
    let mut hits = Vec::new();
    let rows = (1.2 / step) as i32;
    let columns = (std::f64::consts::TAU / step) as i32;
    for row in -rows..=rows {
        for column in 0..columns {
            let (elevation, azimuth) = (f64::from(row) * step, f64::from(column) * step);
            let d = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let mut t = half / d[0].abs().max(d[1].abs());
            t = t.min(if d[2] < 0.0 { -height / d[2] } else { (2.5 - height) / d[2].max(1e-9) });
            if let Some(x) = pillar_x {
                t = t.min(pillar(d, x, height).unwrap_or(f64::INFINITY));
            }
            hits.push(Point3::new((t * d[0]) as f32, (t * d[1]) as f32, (height + t * d[2]) as f32));
        }
    }
    spatial(height, hits)
}

fn pillar(d: [f64; 3], x: f64, height: f64) -> Option<f64> {
    let (a, b, c) = (d[0] * d[0] + d[1] * d[1], d[0] * x, x * x - 0.25 * 0.25);
    let root = (b * b - a * c).max(-1.0);
    let t = (b - root.sqrt()) / a;
    (root >= 0.0 && t > 0.0 && height + t * d[2] <= 1.7).then_some(t)
}

/// An upright block: smallest and largest corner, metres.
pub(crate) type Block = ([f64; 3], [f64; 3]);

/// What a sensor 0.5 m above base sees at `t_map_base` in a square room of half width 7 m with the floor at z = 0, and of
/// blocks in it: rings of beams all around, two degrees apart and denser below.
pub(crate) fn seen(t_map_base: &Pose, blocks: &[Block]) -> KeyframeScan {
    let sensor = (t_map_base * Point3::new(0.0, 0.0, 0.5)).coords;
    let rings = (-12..=4).map(|i| f64::from(i) * 0.03 + 0.004);
    let mut hits = Vec::new();
    for elevation in rings {
        for column in 0..360 {
            let azimuth = f64::from(column) * std::f64::consts::TAU / 360.0;
            let d = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let room = ([-7.0, -7.0, 0.0], [7.0, 7.0, 2.5]);
            let far = leave(&sensor.into(), &d, &room);
            let t = blocks.iter().filter_map(|b| enter(&sensor.into(), &d, b)).fold(far, f64::min);
            let p = Point3::from(sensor + t * nalgebra::Vector3::from(d));
            hits.push((t_map_base.inverse() * p).cast::<f32>());
        }
    }
    spatial(0.5, hits)
}

/// The same by a planar lidar 0.2 m above the floor.
pub(crate) fn seen_planar(t_map_base: &Pose, blocks: &[Block]) -> KeyframeScan {
    let mut scan = planar(&[], &[]);
    scan.t_base_sensor.translation.vector.z = 0.2;
    let sensor = (t_map_base * Point3::new(0.0, 0.0, 0.2)).coords;
    for column in 0..720 {
        let azimuth = f64::from(column) * std::f64::consts::TAU / 720.0;
        let d = [azimuth.cos(), azimuth.sin(), 0.0];
        let far = leave(&sensor.into(), &d, &([-7.0, -7.0, 0.0], [7.0, 7.0, 2.5]));
        let t = blocks.iter().filter_map(|b| enter(&sensor.into(), &d, b)).fold(far, f64::min);
        let p = Point3::from(sensor + t * nalgebra::Vector3::from(d));
        scan.hits.positions.push((t_map_base.inverse() * p).cast::<f32>());
    }
    scan
}

fn slabs(from: &[f64; 3], d: &[f64; 3], (min, max): &Block) -> (f64, f64) {
    let mut range = (f64::NEG_INFINITY, f64::INFINITY);
    for i in 0..3 {
        let along = if d[i].abs() < 1e-12 { 1e-12 } else { d[i] };
        let (a, b) = ((min[i] - from[i]) / along, (max[i] - from[i]) / along);
        range = (range.0.max(a.min(b)), range.1.min(a.max(b)));
    }
    range
}

fn leave(from: &[f64; 3], d: &[f64; 3], block: &Block) -> f64 {
    slabs(from, d, block).1
}

fn enter(from: &[f64; 3], d: &[f64; 3], block: &Block) -> Option<f64> {
    let (a, b) = slabs(from, d, block);
    (a > 0.0 && a < b).then_some(a)
}
