//! What a scan saw in each direction, and whether another one's points contradict it.
//!
//! Places that look alike agree in the surfaces that both scans show; what tells them apart is a surface of one that the
//! other looked through.

use crate::matching::sight::BEYOND;
use nalgebra::{Point3, Vector3};
use percept_geometry::Pose;
use std::f64::consts::{PI, TAU};

/// Directions of a full turn, and from straight down to straight up: 2 degrees, the spacing of sparse lidars' rings.
const AZIMUTHS: usize = 180;
const ELEVATIONS: usize = 90;
/// Points of a scan that are looked up in another one, about. A share of a thousand is good to a hundredth.
const LOOKED_UP: usize = 1000;

/// The ends of a scan's beams, and how far it saw in each direction.
#[derive(Debug, Clone)]
pub(crate) struct Sight {
    /// Ends of beams in base, thinned, metres.
    points: Vec<Point3<f32>>,
    t_sensor_base: Pose,
    /// Shortest range of the beams in each direction, metres, row by row from the lowest; 0 where nothing looked.
    ranges: Vec<f32>,
}

/// Points of one scan in the view of another: those that it looked through, and those that it saw, too.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Contradiction {
    through: usize,
    met: usize,
    looked_up: usize,
}

impl Contradiction {
    /// Of what both saw.
    pub(crate) fn share(&self) -> f64 {
        self.through as f64 / (self.through + self.met).max(1) as f64
    }

    /// What both saw, as a share of all that was looked up.
    pub(crate) fn compared(&self) -> f64 {
        (self.through + self.met) as f64 / self.looked_up.max(1) as f64
    }

    fn add(&mut self, other: &Self) {
        self.through += other.through;
        self.met += other.met;
        self.looked_up += other.looked_up;
    }
}

impl Sight {
    /// Bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.points.capacity() * size_of::<Point3<f32>>() + self.ranges.capacity() * size_of::<f32>()
    }

    /// Of ends of beams in base.
    pub(crate) fn new(ends: &[Point3<f32>], t_base_sensor: &Pose) -> Self {
        let t_sensor_base = t_base_sensor.inverse();
        let mut ranges = vec![0f32; AZIMUTHS * ELEVATIONS];
        for p in ends {
            let q = t_sensor_base * p.cast::<f64>();
            let (row, column) = direction(&q);
            let (known, r) = (&mut ranges[row * AZIMUTHS + column], q.coords.norm() as f32);
            *known = if *known == 0.0 { r } else { known.min(r) };
        }
        let step = ends.len().div_ceil(LOOKED_UP).max(1);
        Self { points: ends.iter().step_by(step).copied().collect(), t_sensor_base, ranges }
    }

    /// What this scan and others, with their base seen from this one's, contradict each other in: the larger of both
    /// directions.
    pub(crate) fn contradicted<'a>(&self, others: impl Iterator<Item = (&'a Self, Pose)>) -> Contradiction {
        let (mut mine, mut theirs) = (Contradiction::default(), Contradiction::default());
        for (other, t_base_other) in others {
            mine.add(&self.compare(other, &t_base_other));
            theirs.add(&other.compare(self, &t_base_other.inverse()));
        }
        if mine.share() > theirs.share() { mine } else { theirs }
    }

    /// What this scan says to the points of another one, whose base lies at `t_base_other` from this one's.
    fn compare(&self, other: &Self, t_base_other: &Pose) -> Contradiction {
        let t_sensor_other = self.t_sensor_base * t_base_other;
        let mut out = Contradiction { looked_up: other.points.len(), ..Contradiction::default() };
        for p in &other.points {
            let q = t_sensor_other * p.cast::<f64>();
            let (r, ranges) = (q.coords.norm(), self.around(&q));
            let slack = BEYOND.0 + BEYOND.1 * r;
            if ranges.iter().any(|&known| known > 0.0 && (f64::from(known) - r).abs() <= slack) {
                out.met += 1;
            } else if ranges[4] > 0.0 && ranges.iter().all(|&known| known == 0.0 || f64::from(known) > r + slack) {
                out.through += 1;
            }
        }
        out
    }

    /// Ranges in the direction of a point of the sensor frame and the eight around it, itself in the middle.
    fn around(&self, q: &Point3<f64>) -> [f32; 9] {
        let (row, column) = direction(q);
        std::array::from_fn(|k| {
            let row = (row + k / 3).saturating_sub(1).min(ELEVATIONS - 1);
            self.ranges[row * AZIMUTHS + (column + AZIMUTHS + k % 3 - 1) % AZIMUTHS]
        })
    }
}

/// Row and column of a point's direction.
fn direction(q: &Point3<f64>) -> (usize, usize) {
    let v: &Vector3<f64> = &q.coords;
    let up = v.z.atan2(v.xy().norm()) / PI + 0.5;
    let turn = v.y.atan2(v.x).rem_euclid(TAU) / TAU;
    let bin = |share: f64, bins: usize| ((share * bins as f64) as usize).min(bins - 1);
    (bin(up, ELEVATIONS), bin(turn, AZIMUTHS))
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::se3;

    /// What a lidar of 40 rings sees of a room with these half widths and a pillar at `pillar` (x).
    fn room(half: [f64; 2], pillar: Option<f64>, t_room_base: &Pose) -> Sight {
        let mut ends = vec![];
        for (ring, column) in (0..40).flat_map(|r| (0..360).map(move |c| (r, c))) {
            let (up, turn) = ((f64::from(ring) - 20.0) * 0.02, f64::from(column) * PI / 180.0);
            let d = t_room_base.rotation * Vector3::new(up.cos() * turn.cos(), up.cos() * turn.sin(), up.sin());
            let o = t_room_base.translation.vector;
            let mut r = (0..2).map(|k| (half[k] * d[k].signum() - o[k]) / d[k]).fold(f64::MAX, f64::min);
            if let Some(x) = pillar {
                let at = (x - o.x) / d.x;
                if at > 0.0 && (o.y + at * d.y).abs() < 1.0 {
                    r = r.min(at);
                }
            }
            ends.push((t_room_base.inverse() * Point3::from(o + d * r)).cast());
        }
        Sight::new(&ends, &Pose::identity())
    }

    #[test]
    fn the_same_room_from_elsewhere_agrees_and_another_one_does_not() {
        let (here, there) = (se3::from_xy_yaw(0.0, 0.0, 0.0), se3::from_xy_yaw(1.0, -0.8, 1.0));
        let a = room([4.0, 3.0], Some(2.5), &here);
        let t_here_there = here.inverse() * there;
        let share = |b: &Sight| {
            let mut both = a.compare(b, &t_here_there);
            both.add(&b.compare(&a, &t_here_there.inverse()));
            assert!(both.compared() > 0.5, "{both:?}");
            both.share()
        };
        assert!(share(&room([4.0, 3.0], Some(2.5), &there)) < 0.01);
        assert!(share(&room([4.0, 3.0], None, &there)) > 0.04);
        assert!(share(&room([4.0, 4.5], Some(2.5), &there)) > 0.2);
    }

    #[test]
    fn directions_that_nothing_looked_in_say_nothing() {
        let ahead: Vec<Point3<f32>> = (0..50).map(|i| Point3::new(5.0, 0.02 * i as f32 - 0.5, 0.0)).collect();
        let behind: Vec<Point3<f32>> = ahead.iter().map(|p| Point3::new(-1.0, p.y, 0.5)).collect();
        let (a, b) = (Sight::new(&ahead, &Pose::identity()), Sight::new(&behind, &Pose::identity()));
        assert_eq!(a.compare(&b, &Pose::identity()).compared(), 0.0);
    }
}
