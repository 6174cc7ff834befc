//! How far one keyframe saw in each direction.

use super::CloudParams;
use crate::angles::atan2;
use nalgebra::{Point3, Vector3};
use percept_geometry::by_processor;
use std::f64::consts::{PI, TAU};

const COLUMNS: usize = 720;
const ROWS: usize = 360;
/// From a bin to the next, radians.
pub(crate) const BIN_RAD: f64 = TAU / COLUMNS as f64;
/// Edge of a window of which the longest beam is known, bins.
const WINDOW: usize = 4;
/// Directions that are worked on together.
const CHUNK: usize = 64;

/// The shortest beam in each half degree of azimuth and elevation around the sensor, along the map's axes.
#[derive(Debug, Clone)]
pub(crate) struct RangeImage {
    sensor: Point3<f64>,
    max_range: f64,
    /// Rows of `COLUMNS`, empty where no beam went: a planar scan fills few.
    rows: Vec<Vec<Bin>>,
    /// Longest beam of each window of `WINDOW x WINDOW` bins, metres; row-major, 0 without a beam.
    longest: Vec<f32>,
    /// What all beams lie in.
    view: View,
}

/// A cone that holds all beams, and the elevations between which they lie.
#[derive(Debug, Clone, Copy)]
struct View {
    axis: Vector3<f64>,
    /// Angle to the axis, radians; pi where beams go all around.
    half_angle: f64,
    /// Least and largest angle above the horizontal, radians.
    elevations: (f64, f64),
}

impl View {
    fn of(rows: &[Vec<Bin>]) -> Self {
        let beams = || rows.iter().flatten().filter(|b| b.0.is_finite()).map(|b| b.1.cast::<f64>());
        let sum: Vector3<f64> = beams().sum();
        let axis = sum.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        let least = beams().map(|d| d.dot(&axis)).fold(1.0, f64::min);
        let (low, high) = beams().map(|d| d.z).fold((1.0, -1.0), |(a, b): (f64, f64), z| (a.min(z), b.max(z)));
        let angle = |sin: f64| sin.clamp(-1.0, 1.0).asin();
        // Directions are kept as f32.
        Self {
            axis,
            half_angle: least.clamp(-1.0, 1.0).acos() + 1e-3,
            elevations: (angle(low) - 1e-3, angle(high) + 1e-3),
        }
    }

    /// Whether a beam may pass within `radius` of what lies at `offset` from the sensor.
    fn may_reach(&self, offset: &Vector3<f64>, radius: f64) -> bool {
        let distance = offset.norm();
        if distance <= radius {
            return true;
        }
        let spread = (radius / distance).asin();
        let from_axis = (offset.dot(&self.axis) / distance).clamp(-1.0, 1.0).acos();
        let elevation = (offset.z / distance).clamp(-1.0, 1.0).asin();
        from_axis <= self.half_angle + spread
            && elevation + spread >= self.elevations.0
            && elevation - spread <= self.elevations.1
    }
}

/// Range (m), infinite without a beam, and the beam's unit direction.
type Bin = (f32, Vector3<f32>);

impl RangeImage {
    /// From the ends of beams in the map frame, returns and misses alike; ends that are not finite are left out.
    pub(crate) fn new(sensor: Point3<f64>, ends: impl Iterator<Item = Point3<f64>>) -> Self {
        let view = View { axis: Vector3::z(), half_angle: 0.0, elevations: (0.0, 0.0) };
        let mut out = Self { sensor, max_range: 0.0, rows: Vec::new(), longest: Vec::new(), view };
        // Whole vectors of directions at a time.
        let (mut beams, mut narrow, mut at) = ([(Vector3::zeros(), 0.0); CHUNK], [[0.0f32; 3]; CHUNK], [0u32; CHUNK]);
        let mut num = 0;
        let mut ends = ends.map(|end| end - sensor);
        loop {
            let next = ends.next();
            if let Some(beam) = next {
                let range = beam.norm();
                if range.is_finite() && range > 1e-6 {
                    (beams[num], narrow[num]) = ((beam, range), beam.cast::<f32>().into());
                    num += 1;
                }
            }
            if num == CHUNK || next.is_none() {
                bins(&narrow[..num], &mut at[..num]);
                beams[..num].iter().zip(&at).for_each(|((beam, range), at)| out.add(beam, *range, *at as usize));
                num = 0;
            }
            if next.is_none() {
                break;
            }
        }
        out.view = View::of(&out.rows);
        out.longest = longest(&out.rows);
        out
    }

    /// Adds a beam of a range (m) that goes into a bin.
    fn add(&mut self, beam: &Vector3<f64>, range: f64, at: usize) {
        if self.rows.is_empty() {
            self.rows = vec![Vec::new(); ROWS];
        }
        self.max_range = self.max_range.max(range);
        let (row, column) = (&mut self.rows[at / COLUMNS], at % COLUMNS);
        if row.is_empty() {
            *row = vec![(f32::INFINITY, Vector3::zeros()); COLUMNS];
        }
        let slot = &mut row[column];
        if (range as f32) < slot.0 {
            *slot = (range as f32, (beam / range).cast());
        }
    }

    /// Whether anything within `radius_m` of a point may have been seen through; if not, nothing was.
    pub(super) fn may_see_through(&self, center: &Point3<f64>, radius_m: f64, params: &CloudParams) -> bool {
        let offset = center - self.sensor;
        if self.rows.is_empty() || !self.view.may_reach(&offset, radius_m + 0.5 * params.voxel_size_m) {
            return false;
        }
        let nearest = offset.norm() - radius_m;
        nearest <= 0.0 || self.longest_towards(&offset, radius_m) >= nearest + params.margin(nearest)
    }

    /// No beam within `radius` of what lies at `offset`, farther away than that, is longer.
    fn longest_towards(&self, offset: &Vector3<f64>, radius: f64) -> f64 {
        let distance = offset.norm();
        // Rounding may put a beam into the bin beside its own.
        let spread = (radius / distance).min(1.0).asin() + 1e-5;
        let elevation = (offset.z / distance).clamp(-1.0, 1.0).asin();
        let row = |angle: f64| ((((angle / PI + 0.5) * ROWS as f64).max(0.0) as usize).min(ROWS - 1)) / WINDOW;
        // How far a cap around that direction reaches to the sides; around a pole, all around.
        let aside = (spread.sin() / elevation.cos()).clamp(0.0, 1.0);
        let half = if elevation.abs() + spread < 0.5 * PI { aside.asin() } else { PI };
        let step = TAU / (COLUMNS / WINDOW) as f64;
        let azimuth = offset.y.atan2(offset.x) + PI;
        let (first, last) = (((azimuth - half) / step).floor() as i64, ((azimuth + half) / step).floor() as i64);
        let windows = COLUMNS / WINDOW;
        let columns = (last - first + 1).clamp(0, windows as i64);
        let mut out: f32 = 0.0;
        for y in row(elevation - spread)..=row(elevation + spread) {
            for x in (0..columns).map(|k| (first + k).rem_euclid(windows as i64) as usize) {
                out = out.max(self.longest[y * windows + x]);
            }
        }
        f64::from(out)
    }

    /// Where the beams start, map frame.
    pub(crate) fn sensor(&self) -> &Point3<f64> {
        &self.sensor
    }

    /// Length of the longest beam, metres.
    pub(super) fn max_range(&self) -> f64 {
        self.max_range
    }

    /// Bins that a beam went into.
    pub(super) fn num_beams(&self) -> usize {
        self.rows.iter().flatten().filter(|b| b.0.is_finite()).count()
    }

    /// Shows each beam: its unit direction, and the length of the shortest among it and those in the bins around it.
    pub(crate) fn visit_beams(&self, mut visit: impl FnMut(&Vector3<f64>, f64)) {
        // The shortest of each three in a row: those before, here and after.
        let beside: Vec<Vec<f32>> = self.rows.iter().map(|row| shortest_of_three(row)).collect();
        for (y, row) in self.rows.iter().enumerate().filter(|(_, row)| !row.is_empty()) {
            let rows = &beside[y.saturating_sub(1)..=(y + 1).min(ROWS - 1)];
            for (x, beam) in row.iter().enumerate().filter(|(_, b)| b.0.is_finite()) {
                let shortest = rows.iter().filter_map(|row| row.get(x)).copied().fold(f32::INFINITY, f32::min);
                visit(&beam.1.cast(), shortest.into());
            }
        }
    }

    /// Which of at most 64 points were seen through, a bit each: a beam passed within half a voxel of them and ended well behind, while
    /// no beam beside it ended near or before them.
    pub(super) fn sees_through(&self, points: impl ExactSizeIterator<Item = Point3<f64>>, params: &CloudParams) -> u64 {
        let num = points.len().min(64);
        if self.rows.is_empty() {
            return 0;
        }
        let (mut offsets, mut narrow, mut at) = ([Vector3::zeros(); 64], [[0.0f32; 3]; 64], [0u32; 64]);
        for ((offset, narrow), p) in offsets.iter_mut().zip(&mut narrow).zip(points) {
            *offset = p - self.sensor;
            *narrow = offset.cast::<f32>().into();
        }
        bins(&narrow[..num], &mut at[..num]);
        let through = |i: usize| u64::from(self.is_behind(&offsets[i], at[i], params)) << i;
        (0..num).map(through).fold(0, |all, one| all | one)
    }

    /// Whether the beams in a bin and around it see through what lies at an offset from the sensor, in that bin.
    fn is_behind(&self, offset: &Vector3<f64>, at: u32, params: &CloudParams) -> bool {
        let r = offset.norm();
        let behind = r + params.margin(r);
        if r < params.range_min_m || behind > self.max_range {
            return false;
        }
        let (row, column) = (at as usize / COLUMNS, at as usize % COLUMNS);
        let Some(&(range, direction)) = self.rows[row].get(column) else { return false };
        if !range.is_finite() || f64::from(range) < behind {
            return false;
        }
        offset.cross(&direction.cast()).norm() <= 0.5 * params.voxel_size_m
            && around(row, column).all(|(y, x)| self.rows[y].get(x).is_none_or(|b| f64::from(b.0) >= behind))
    }
}

/// A bin and those beside it.
fn around(row: usize, column: usize) -> impl Iterator<Item = (usize, usize)> {
    let rows = row.saturating_sub(1)..=(row + 1).min(ROWS - 1);
    rows.flat_map(move |y| [COLUMNS - 1, 0, 1].map(|dx| (y, (column + dx) % COLUMNS)))
}

/// The ranges of a [`RangeImage`] alone, a quarter of its size.
#[derive(Debug, Clone)]
pub(crate) struct Ranges {
    sensor: Point3<f64>,
    /// Metres; rows of `COLUMNS`, empty where no beam went, infinite without one.
    rows: Vec<Vec<f32>>,
}

impl Ranges {
    /// From the ends of beams, in one frame with the sensor; those that are not finite are left out.
    pub(crate) fn new(sensor: Point3<f64>, ends: impl Iterator<Item = Point3<f64>>) -> Self {
        let mut rows = vec![vec![]; ROWS];
        for beam in ends.map(|end| end - sensor) {
            let range = beam.norm();
            if range.is_finite() && range > 1e-6 {
                let at = bin(beam.x as f32, beam.y as f32, beam.z as f32) as usize;
                let row: &mut Vec<f32> = &mut rows[at / COLUMNS];
                row.resize(COLUMNS, f32::INFINITY);
                row[at % COLUMNS] = row[at % COLUMNS].min(range as f32);
            }
        }
        Self { sensor, rows }
    }

    /// What the beams towards a point say of it: that they go on behind it (true), that one of them ends at it (false), or nothing. A surface
    /// behind it lies farther by metres and a share of the range.
    pub(crate) fn looks_at(&self, p: &Point3<f64>, behind: (f64, f64)) -> Option<bool> {
        let offset = p - self.sensor;
        let r = offset.norm();
        if !(r.is_finite() && r > 1e-6) {
            return None;
        }
        let margin = behind.0 + behind.1 * r;
        let at = bin(offset.x as f32, offset.y as f32, offset.z as f32) as usize;
        let (mut beams, mut farther) = (0, 0);
        for (y, x) in around(at / COLUMNS, at % COLUMNS) {
            let Some(range) = self.rows[y].get(x).map(|b| f64::from(*b)).filter(|r| r.is_finite()) else { continue };
            if (range - r).abs() <= margin {
                return Some(false);
            }
            beams += 1;
            farther += usize::from(range > r);
        }
        // One beam may pass by.
        (beams >= 2 && farther == beams).then_some(true)
    }
}

fn shortest_of_three(row: &[Bin]) -> Vec<f32> {
    let n = row.len();
    (0..n).map(|x| row[x].0.min(row[(x + 1) % n].0).min(row[(x + n - 1) % n].0)).collect()
}

fn longest(rows: &[Vec<Bin>]) -> Vec<f32> {
    let mut out = vec![0.0f32; rows.len().div_ceil(WINDOW) * (COLUMNS / WINDOW)];
    for (y, row) in rows.iter().enumerate() {
        for (x, bin) in row.iter().enumerate().filter(|(_, b)| b.0.is_finite()) {
            let slot = &mut out[y / WINDOW * (COLUMNS / WINDOW) + x / WINDOW];
            *slot = slot.max(bin.0);
        }
    }
    out
}

/// The bin of a direction, row by row.
#[inline(always)]
fn bin(x: f32, y: f32, z: f32) -> u32 {
    let elevation = atan2(z, (x * x + y * y).sqrt());
    let row = (elevation * (1.0 / PI as f32) + 0.5) * ROWS as f32;
    let column = (atan2(y, x) + PI as f32) * (COLUMNS as f32 / TAU as f32);
    let within = |v: f32, most: usize| (if v < most as f32 { v } else { (most - 1) as f32 }) as u32;
    within(row, ROWS) * COLUMNS as u32 + within(column, COLUMNS)
}

by_processor! {
    [avx512]
    /// The bins of some directions.
    fn bins(directions: &[[f32; 3]], out: &mut [u32]) {
        for (out, [x, y, z]) in out.iter_mut().zip(directions) {
            *out = bin(*x, *y, *z);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beams of a camera, of a planar lidar, of one that spins.
    fn views() -> Vec<RangeImage> {
        let sensor = Point3::new(0.3, -0.2, 1.0);
        let image = |azimuths: (f64, f64), elevations: (f64, f64)| {
            let at = |(a, b): (f64, f64), i: i32, n: i32| a + (b - a) * f64::from(i) / f64::from(n);
            let beams = (0..=400).flat_map(move |i| {
                (0..=60).map(move |j| {
                    let (a, e) = (at(azimuths, i, 400), at(elevations, j, 60));
                    let range = 3.0 + (5.0 * a).sin();
                    sensor + Vector3::new(e.cos() * a.cos(), e.cos() * a.sin(), e.sin()) * range
                })
            });
            RangeImage::new(sensor, beams)
        };
        vec![image((0.4, 1.4), (-0.5, 0.3)), image((-PI, PI), (0.0, 0.0)), image((-PI, PI), (-0.6, 0.3))]
    }

    #[test]
    fn what_may_not_be_seen_through_is_not() {
        let params = CloudParams::default();
        for (k, view) in views().iter().enumerate() {
            let (mut through, mut left_out) = (0, 0);
            for i in 0..60_000 {
                let spread = |m: u32| f64::from((i as u32).wrapping_mul(m) >> 16) / 65536.0 - 0.5;
                let center =
                    Point3::new(6.0 * spread(2_654_435_761), 6.0 * spread(2_246_822_519), 3.0 * spread(3_266_489_917));
                let inside = Vector3::new(spread(668_265_263), spread(374_761_393), spread(2_147_483_647)) * 0.4;
                let sees = view.sees_through([center + inside].into_iter(), &params) == 1;
                let may = view.may_see_through(&center, 0.87 * 0.4, &params);
                assert!(may || !sees, "view {k}: {center}");
                through += usize::from(sees);
                left_out += usize::from(!may);
            }
            assert!(through > 50 && left_out > 5_000, "view {k}: {through} seen through, {left_out} left out");
        }
    }
}
