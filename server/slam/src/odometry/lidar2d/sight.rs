//! What a keyframe saw in each direction, and whether another one's points contradict it.
//!
//! Places that look alike agree in the surfaces that both views show; what tells them apart is a surface of one that the
//! other looked through.

use crate::odometry::lidar2d::planar;
use nalgebra::{Isometry2, Point2};
use percept_geometry::KeyframeScan;
use std::f64::consts::TAU;

/// Directions of a full turn.
const BINS: usize = 360;
/// A beam that ends so much beyond a point has passed it, metres and share of the range.
const BEYOND: (f64, f64) = (0.3, 0.03);

/// Free ranges around a sensor, by direction.
#[derive(Debug, Clone)]
pub(crate) struct Sight {
    t_sensor_base: Isometry2<f64>,
    /// Shortest range of the beams in each direction, metres; 0 where nothing looked.
    ranges: Vec<f32>,
}

impl Sight {
    pub(crate) fn new(scan: &KeyframeScan) -> Self {
        let t_sensor_base = planar(&scan.t_base_sensor).inverse();
        let mut ranges = vec![0f32; BINS];
        for p in scan.hits.positions.iter().chain(&scan.misses) {
            let q = t_sensor_base * p.cast::<f64>().xy();
            let (bin, r) = (bin(&q), q.coords.norm() as f32);
            let known = &mut ranges[bin];
            *known = if *known == 0.0 { r } else { known.min(r) };
        }
        Self { t_sensor_base, ranges }
    }

    /// Whether a beam ended near a point of base.
    pub(crate) fn reaches(&self, p: &Point2<f64>) -> bool {
        let q = self.t_sensor_base * p;
        let (bin, r) = (bin(&q), q.coords.norm());
        let near = BEYOND.0 + BEYOND.1 * r;
        [bin + BINS - 1, bin, bin + 1].iter().any(|b| (f64::from(self.ranges[b % BINS]) - r).abs() <= near)
    }

    /// Whether beams on both sides of a point of base ended well beyond it.
    pub(crate) fn is_through(&self, p: &Point2<f64>) -> bool {
        let q = self.t_sensor_base * p;
        let (bin, r) = (bin(&q), q.coords.norm());
        let beyond = (r + BEYOND.0 + BEYOND.1 * r) as f32;
        [bin + BINS - 1, bin, bin + 1].iter().all(|b| self.ranges[b % BINS] > beyond)
    }
}

fn bin(q: &Point2<f64>) -> usize {
    let turn = q.y.atan2(q.x).rem_euclid(TAU) / TAU;
    ((turn * BINS as f64) as usize).min(BINS - 1)
}
