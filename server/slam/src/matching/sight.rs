//! What a scan saw in each direction, and whether another one's points contradict it.
//!
//! Places that look alike agree in the surfaces that both views show; what tells them apart is a surface of one that the
//! other looked through.

use super::field::{Field, Hit};
use nalgebra::{Isometry2, Point2, Vector2};
use std::f64::consts::TAU;

/// Directions of a full turn.
const BINS: usize = 360;
/// A beam that ends so much beyond a point has passed it, metres and share of the range. Ten times the 3 cm that ranges
/// err by, and a beam half a degree wide that meets a wall at 17 degrees.
pub(crate) const BEYOND: (f64, f64) = (0.3, 0.03);

/// Free ranges around a sensor, by direction.
#[derive(Debug, Clone)]
pub(crate) struct Sight {
    t_sensor_base: Isometry2<f64>,
    /// Shortest range of the beams in each direction, metres; 0 where nothing looked.
    ranges: Vec<f32>,
}

impl Sight {
    /// Of the ends of beams in base, those without a return included if they are known.
    pub(crate) fn new(ends: impl Iterator<Item = Point2<f64>>, t_base_sensor: &Isometry2<f64>) -> Self {
        let t_sensor_base = t_base_sensor.inverse();
        let mut ranges = vec![0f32; BINS];
        for p in ends {
            let q = t_sensor_base * p;
            let (bin, r) = (bin(&q), q.coords.norm() as f32);
            let known = &mut ranges[bin];
            *known = if *known == 0.0 { r } else { known.min(r) };
        }
        Self { t_sensor_base, ranges }
    }

    /// Whether a beam ended near a point of base.
    fn reaches(&self, p: &Point2<f64>) -> bool {
        let q = self.t_sensor_base * p;
        let (bin, r) = (bin(&q), q.coords.norm());
        let near = BEYOND.0 + BEYOND.1 * r;
        [bin + BINS - 1, bin, bin + 1].iter().any(|b| (f64::from(self.ranges[b % BINS]) - r).abs() <= near)
    }

    /// Whether beams on both sides of a point of base ended well beyond it.
    fn is_through(&self, p: &Point2<f64>) -> bool {
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

/// A scan of a local map, with its pose in it.
pub(crate) struct View<'a> {
    pub(crate) t_map_base: Isometry2<f64>,
    pub(crate) hits: &'a [Hit],
    pub(crate) sight: Sight,
}

/// Share of what both a scan at `t` and the views of a local map saw in which they contradict each other: hits of one
/// that the other looked through. `field` holds the views' hits.
pub(crate) fn contradicted(
    field: &Field,
    views: &[View<'_>],
    (own, hits): (&Sight, &[Hit]),
    t: &Isometry2<f64>,
) -> f64 {
    let to_views: Vec<Isometry2<f64>> = views.iter().map(|v| v.t_map_base.inverse()).collect();
    let (mut agreed, mut against) = (0usize, 0usize);
    for hit in hits {
        let p = t * hit.p;
        if field.element(&p, &Vector2::zeros()).is_some() {
            agreed += 1;
        } else if views.iter().zip(&to_views).any(|(v, t_base_map)| v.sight.is_through(&(t_base_map * p))) {
            against += 1;
        }
    }
    let t_base_map = t.inverse();
    let (mut passed, mut met) = (0usize, 0usize);
    for view in views {
        let t_base_view = t_base_map * view.t_map_base;
        for hit in view.hits.iter().step_by(4) {
            let p = t_base_view * hit.p;
            match own.is_through(&p) {
                true => passed += 1,
                false if own.reaches(&p) => met += 1,
                false => {}
            }
        }
    }
    let share = |bad: usize, good: usize| bad as f64 / (bad + good).max(1) as f64;
    share(against, agreed).max(share(passed, met))
}
