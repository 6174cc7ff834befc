//! Returns of a planar lidar from what comes along with the robot: who follows or leads it, what it tows, parts of its own.
//!
//! They stand still in base as it drives. Where walls leave the way open, as along a corridor, they alone seem to tell it, and hold the
//! pose where it was: one person at 0.8 m is a tenth of the beams and enough. Wheels tell them from the world: what stayed in base over
//! half a metre of the way is nothing that the scan before saw from there.

use nalgebra::{Isometry2, Point2, Vector2};
use percept_geometry::cloud::Beam;
use percept_geometry::{LaserScan, Pose, se3};
use percept_slam::motion_noise::unknown_wheels;
use percept_slam::{MotionPrior, PlanarScan, Scan};
use std::collections::VecDeque;
use std::sync::Arc;

/// Scans are compared so far apart, metres of the way: more than a person is deep.
const APART_M: f64 = 0.5;
/// Scans are kept so far apart, metres.
const KEPT_EVERY_M: f64 = 0.1;
/// Who comes along is this near to the sensor, metres.
const NEAR_M: f64 = 3.0;
/// Up to here it is looked whether other things stay in base, too, metres: then the robot stands, and its wheels turn. Farther away the
/// walls of a corridor are met at a slant, by single hits.
const LOOKED_AT_M: f64 = 1.5 * NEAR_M;
/// What comes along keeps its distance to so much over the way between both scans, metres: less than that way, so that nothing stays by
/// itself.
const STAYS_M: f64 = 0.3;
/// What the scan before saw lies within so much of where it is now, metres: a cell of the raster and what wheels err by. With two cells
/// people who hide most of a scan are not known for such, and lead astray where wheels have led (a test).
const SUPPORTED_M: f64 = 0.1;
/// Neighbours in one surface are so near to each other, metres, and beams' spacings more: those of a wall seen at 75 degrees.
const TOGETHER: (f64, f64) = (0.1, 4.0);
/// Most of the hits that may come along, and that may stay in base farther away, where nobody follows: shares. With these 13 % of the
/// scans of Intel's log (the first 3,000) and 36 % of CSAIL's leave out some 7 % of their hits, which changes neither (`planar_log`:
/// relations off by 13.7 mm before and after, and by 115 after 112).
const MOST: f64 = 0.35;
const MOST_BEYOND: f64 = 0.15;
/// So many neighbouring hits at least.
const LEAST_HITS: usize = 3;
/// Odometry that has been led astray by more than this goes on where wheels have led, metres.
const ASTRAY_M: f64 = 0.1;

/// A scan that others are compared with.
#[derive(Debug, Clone)]
struct Seen {
    ends: Raster,
    /// The sensor in base.
    eye: Point2<f64>,
    /// Base where wheels have led, and their way up to there, metres.
    t_way_base: Isometry2<f64>,
    way_m: f64,
    /// Base to odom, where it was placed.
    t_odom_base: Option<Pose>,
}

/// A scan without what comes along.
pub(super) struct Without {
    pub(super) scan: Scan,
    /// Where wheels have led to, base to odom, and by what since the scan before, if odometry has gone along instead.
    led_to: Option<(Pose, Pose)>,
}

impl Without {
    /// The motion since the frame before, which odometry placed there, back to where wheels have led; none if odometry is there.
    pub(super) fn prior(&self, t_odom_last: &Pose) -> Option<MotionPrior> {
        let (t_odom_base, led) = self.led_to.as_ref()?;
        let covariance = unknown_wheels(led.translation.vector.norm(), led.rotation.angle());
        Some(MotionPrior { t_prev_now: t_odom_last.inv_mul(t_odom_base), covariance })
    }
}

/// Tells what comes along from the world.
#[derive(Debug, Clone, Default)]
pub(super) struct Comoving {
    kept: VecDeque<Seen>,
    t_way_base: Isometry2<f64>,
    way_m: f64,
    /// The newest step by wheels.
    told: Isometry2<f64>,
    newest: Option<Seen>,
    is_along: bool,
}

impl Comoving {
    /// Of what wheels tell of the motion since the frame before (none if there are none to be believed) and where odometry was then: the
    /// scan without what comes along, if something does.
    pub(super) fn leave_out(&mut self, scan: &Scan, told: Option<&Pose>, t_odom_last: &Pose) -> Option<Without> {
        let (Scan::Planar(planar), Some(told)) = (scan, told) else {
            *self = Self::default();
            return None;
        };
        self.told = flat(told);
        let hits = hits_of(planar);
        let t_way_base = self.t_way_base * self.told;
        let way_m = self.way_m + self.told.translation.vector.norm();
        let ends = Raster::of(&hits, planar.scan.angle_increment_rad.abs());
        let eye = Point2::from(planar.t_base_sensor.translation.vector.xy());
        self.newest = Some(Seen { ends, eye, t_way_base, way_m, t_odom_base: None });
        let before = self.kept.iter().rev().find(|seen| {
            let apart = (seen.t_way_base.translation.vector - t_way_base.translation.vector).norm();
            apart >= APART_M
        });
        let was_along = std::mem::replace(&mut self.is_along, false);
        let before = before?;
        let t_before_now = before.t_way_base.inverse() * t_way_base;
        let along = come_along(before, &hits, &t_before_now);
        if along.is_empty() {
            return None;
        }
        self.is_along = true;
        let led_to = before.t_odom_base.filter(|_| !was_along).map(|t_odom_before| {
            let t = &t_before_now;
            let led = se3::from_xy_yaw(t.translation.x, t.translation.y, t.rotation.angle());
            (t_odom_before * led, led)
        });
        let off = |t: &Pose| (t.translation.vector - (t_odom_last * told).translation.vector).norm();
        let led_to = led_to.filter(|(t, _)| off(t) > ASTRAY_M);
        let mut left = LaserScan::clone(&planar.scan);
        let num_beams = left.ranges_m.len();
        for k in along {
            let index = hits[k].index;
            match index.checked_sub(num_beams) {
                Some(later) => left.later_echoes_m[later] = f32::NAN,
                None => left.ranges_m[index] = f32::NAN,
            }
        }
        Some(Without { scan: Scan::Planar(PlanarScan { scan: Arc::new(left), ..planar.clone() }), led_to })
    }

    /// Odometry goes on elsewhere: where scans were placed says nothing of it.
    pub(super) fn forget_places(&mut self) {
        self.kept.iter_mut().for_each(|seen| seen.t_odom_base = None);
    }

    /// The newest scan was placed here, base to odom, after it was placed there; none where it was not.
    pub(super) fn placed(&mut self, t_odom: Option<(&Pose, &Pose)>) {
        let Some(mut seen) = self.newest.take() else { return };
        if let Some((last, now)) = t_odom {
            // Scans tell the turn better than wheels do, also where somebody comes along.
            let measured = flat(&last.inv_mul(now));
            let step = Isometry2::from_parts(self.told.translation, measured.rotation);
            seen.t_way_base = self.t_way_base * step;
            seen.t_odom_base = Some(*now);
        }
        (self.t_way_base, self.way_m) = (seen.t_way_base, seen.way_m);
        if self.kept.back().is_none_or(|k| seen.way_m - k.way_m >= KEPT_EVERY_M) {
            self.kept.push_back(seen);
        }
        while self.kept.front().is_some_and(|k| self.way_m - k.way_m > 4.0 * APART_M) {
            self.kept.pop_front();
        }
    }
}

/// Numbers of the hits that come along; none if they are too many.
fn come_along(before: &Seen, hits: &[End], t_before_now: &Isometry2<f64>) -> Vec<usize> {
    let Seen { ends, eye, .. } = before;
    let stays = |hit: &End| ends.is_near(&hit.p, STAYS_M) && !ends.is_near(&(t_before_now * hit.p), SUPPORTED_M);
    let stay: Vec<bool> = hits.iter().map(|hit| hit.range_m < LOOKED_AT_M && stays(hit)).collect();
    let (mut beyond, mut stay_beyond) = (0usize, 0usize);
    let mut along = vec![];
    let mut first = 0;
    while first < hits.len() {
        let joins = |k: &usize| stay[*k] == stay[first] && (hits[*k].p - hits[*k - 1].p).norm() < STAYS_M;
        let end = (first + 1..hits.len()).take_while(joins).last().map_or(first + 1, |k| k + 1);
        let is_one = stay[first] && end - first >= LEAST_HITS;
        for (k, hit) in hits.iter().enumerate().take(end).skip(first) {
            if hit.range_m < NEAR_M {
                along.extend(is_one.then_some(k));
            } else if hit.range_m < LOOKED_AT_M && !(is_one && ends.hides(eye, &(t_before_now * hit.p))) {
                // What the scan before could not see from there says nothing.
                beyond += 1;
                stay_beyond += usize::from(is_one);
            }
        }
        first = end;
    }
    let is_share = |part: usize, whole: usize, most: f64| part as f64 <= most * whole as f64;
    let are_believed = is_share(along.len(), hits.len(), MOST) && is_share(stay_beyond, beyond, MOST_BEYOND);
    if are_believed { along } else { vec![] }
}

/// Where a beam ended, in base's plane.
struct End {
    /// Of the beam, later echoes behind the first ones.
    index: usize,
    p: Point2<f64>,
    range_m: f64,
}

fn hits_of(planar: &PlanarScan) -> Vec<End> {
    let scan = &planar.scan;
    let num_beams = scan.ranges_m.len();
    let mut hits = vec![];
    let later = scan.later_echoes_m.iter().enumerate().map(|(k, r)| (num_beams + k, k % num_beams.max(1), *r));
    let all = scan.ranges_m.iter().enumerate().map(|(i, r)| (i, i, *r)).chain(later);
    for (index, beam, range) in all {
        let Beam::Hit(_) = scan.reading(range) else { continue };
        let (angle, range_m) = (scan.angle(beam), f64::from(range));
        let p = planar.t_base_sensor * nalgebra::Point3::new(range_m * angle.cos(), range_m * angle.sin(), 0.0);
        hits.push(End { index, p: p.xy(), range_m });
    }
    hits
}

fn flat(t: &Pose) -> Isometry2<f64> {
    Isometry2::new(Vector2::new(t.translation.x, t.translation.y), se3::yaw(t))
}

/// Which cells around base surfaces cross.
#[derive(Debug, Clone)]
struct Raster {
    is_crossed: Vec<bool>,
}

/// Edge of a cell, metres, and cells to each side of base.
const CELL_M: f64 = 0.1;
const HALF: i32 = 64;

impl Raster {
    fn of(hits: &[End], spacing_rad: f64) -> Self {
        let mut raster = Self { is_crossed: vec![false; (4 * HALF * HALF) as usize] };
        for (k, hit) in hits.iter().enumerate() {
            raster.cross(&hit.p);
            let Some(next) = hits.get(k + 1) else { continue };
            let step = next.p - hit.p;
            let length = step.norm();
            if length < TOGETHER.0 + TOGETHER.1 * spacing_rad * hit.range_m {
                let parts = (2.0 * length / CELL_M).ceil() as usize;
                (1..parts).for_each(|i| raster.cross(&(hit.p + step * (i as f64 / parts as f64))));
            }
        }
        raster
    }

    fn index(x: i32, y: i32) -> Option<usize> {
        let is_inside = (-HALF..HALF).contains(&x) && (-HALF..HALF).contains(&y);
        is_inside.then_some(((y + HALF) * 2 * HALF + x + HALF) as usize)
    }

    fn cell(p: &Point2<f64>) -> (i32, i32) {
        ((p.x / CELL_M).floor() as i32, (p.y / CELL_M).floor() as i32)
    }

    fn cross(&mut self, p: &Point2<f64>) {
        let (x, y) = Self::cell(p);
        if let Some(i) = Self::index(x, y) {
            self.is_crossed[i] = true;
        }
    }

    /// Whether a surface lies between two points, and not at the second one.
    fn hides(&self, from: &Point2<f64>, to: &Point2<f64>) -> bool {
        let way = to - from;
        let steps = (way.norm() / CELL_M - STAYS_M / CELL_M).floor().max(0.0) as usize;
        let step = way.normalize() * CELL_M;
        (1..=steps).any(|k| {
            let (x, y) = Self::cell(&(from + step * k as f64));
            Self::index(x, y).is_some_and(|i| self.is_crossed[i])
        })
    }

    /// Whether a surface crosses a cell within so much of a point's, to each side.
    fn is_near(&self, p: &Point2<f64>, within_m: f64) -> bool {
        let (x, y) = Self::cell(p);
        let n = (within_m / CELL_M).round() as i32;
        let mut around = (y - n..=y + n).flat_map(|y| (x - n..=x + n).map(move |x| (x, y)));
        around.any(|(x, y)| Self::index(x, y).is_some_and(|i| self.is_crossed[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A corridor along x, 2 m wide, which ends 4 m from the origin on both sides; base at `x`, and something of 0.4 m across the way
    /// `ahead` of it.
    fn scan(x: f64, ahead: f64) -> Scan {
        let range = |i: u32| {
            let (sin, cos) = f64::from(i).to_radians().sin_cos();
            let along = if sin == 0.0 { f64::INFINITY } else { 1.0 / sin.abs() };
            let across = if cos > 0.0 { (4.0 - x) / cos } else { (-4.0 - x) / cos };
            let thing = ahead / cos;
            let is_met = cos != 0.0 && thing > 0.0 && (thing * sin).abs() < 0.2;
            along.min(across).min(if is_met { thing } else { f64::INFINITY }) as f32
        };
        let scan = LaserScan {
            angle_min_rad: 0.0,
            angle_increment_rad: 1f64.to_radians(),
            range_min_m: 0.05,
            range_max_m: 30.0,
            time_increment_s: 0.0,
            ranges_m: (0..360).map(range).collect(),
            intensities: None,
            later_echoes_m: vec![],
        };
        Scan::Planar(PlanarScan { scan: Arc::new(scan), t_base_sensor: Pose::identity() })
    }

    /// Drives 1.5 m in steps of 5 cm by wheels; `seen` makes the scan of a place, `placed` where odometry says that it is. The beams
    /// that are left out of the last scan, and where odometry was led to first.
    fn drive(seen: impl Fn(f64) -> Scan, placed: impl Fn(f64) -> f64) -> (Vec<usize>, Option<f64>) {
        let (mut comoving, mut led_to, mut out) = (Comoving::default(), None, vec![]);
        let odom = |x: f64| se3::from_xy_yaw(placed(x), 0.0, 0.0);
        for k in 0..=30 {
            let (before, x) = (0.05 * f64::from(k - 1), 0.05 * f64::from(k));
            let step = se3::from_xy_yaw(0.05, 0.0, 0.0);
            let scan = seen(x);
            let without = comoving.leave_out(&scan, Some(&step), &odom(before));
            comoving.placed(Some((&odom(before), &odom(x))));
            out = vec![];
            if let Some(Without { scan: Scan::Planar(left), led_to: led }) = without {
                out = (0..360).filter(|i| left.scan.ranges_m[*i].is_nan()).collect();
                led_to = led_to.or(led.map(|(t, _)| t.translation.x));
            }
        }
        (out, led_to)
    }

    #[test]
    fn what_comes_along_is_left_out_and_odometry_that_went_along_is_led_back() {
        for ahead in [0.8, -0.8] {
            let (out, led_to) = drive(|x| scan(x, ahead), |x| x);
            let is_it = |i: &usize| {
                let angle = (*i as f64).to_radians();
                (0.8 * angle.tan()).abs() < 0.2 && angle.cos() * ahead > 0.0
            };
            assert_eq!(out, (0..360).filter(is_it).collect::<Vec<_>>(), "{ahead}");
            assert_eq!(led_to, None, "odometry was right");
            let (again, led_to) = drive(|x| scan(x, ahead), |_| 0.0);
            assert_eq!(again, out);
            assert!(led_to.is_some_and(|x| (0.45..0.65).contains(&x)), "{led_to:?}");
        }
    }

    #[test]
    fn what_stands_in_the_way_is_of_the_world_and_so_is_all_of_it_where_wheels_spin() {
        assert_eq!(drive(|x| scan(x, 3.0 - x), |x| x), (vec![], None));
        assert_eq!(drive(|_| scan(0.0, 0.8), |_| 0.0), (vec![], None), "the walls across stay, too");
    }

    #[test]
    fn without_wheels_nothing_is_told_apart() {
        let mut comoving = Comoving::default();
        assert!(comoving.leave_out(&scan(0.0, 0.8), None, &Pose::identity()).is_none());
        assert!(comoving.kept.is_empty());
    }
}
