//! Where a robot can drive, by the shape of the ground.

use super::{DenseHeights, HeightMap, HeightParams, Storey};
use crate::{DenseGrid, MappingError};
use percept_geometry::{Cell, GridGeometry};
use rayon::prelude::*;
use std::ops::Range;

/// Steps are told over so many cells: the edge of a kerb often falls inside a cell, whose height lies between.
const STEP_CELLS: i32 = 2;
/// A plane takes so much of the footprint's cells, and a spread of so many squared cells across its longest direction: ground
/// that was seen along a single line has no slope.
const PLANE_SHARE: f64 = 0.25;
const PLANE_SPREAD: f64 = 0.2;
/// Value of a cell that is just passable, of 100: below what planners take for occupied.
const PASSABLE: f32 = 50.0;

/// Where a robot can drive: maps of one rectangle, row-major `height x width`, row 0 at the smallest y.
///
/// The footprint is the disc of `footprint_m` around a cell's centre. Slope, step and roughness are those of the ground
/// in it. `traversability = 1 - max(slope / max_slope, step / max_step, roughness / max_roughness)`, at least 0; 0 as well where a drop was
/// seen, where something stands that is higher than `max_step` or on ground that was not seen, and where ground ends in the footprint that
/// goes on lower, behind what the edge hides, by more than a slope or a step may take it down.
/// Source: Wermelinger, Fankhauser, Diethelm, Krüsi, Siegwart and Hutter, "Navigation planning for legged robots in challenging
/// terrain", 2016. They take a weighted mean and 0 where a limit is exceeded; with the largest there are no weights, and 0 is where
/// a limit is reached.
#[derive(Debug, Clone, PartialEq)]
pub struct Traversability {
    /// Origin: lower-left corner of cell (0, 0) of this rectangle, in the map frame.
    pub geometry: GridGeometry,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Angle between the least-squares plane and the horizontal, radians; NaN where too little ground was seen.
    pub slope_rad: Vec<f32>,
    /// Largest difference of height between ground cells at most two columns and rows apart, metres; NaN as the slope. A slope
    /// has steps of what it rises over that distance.
    pub step_m: Vec<f32>,
    /// Standard deviation of the ground from the plane, metres; NaN as the slope.
    pub roughness_m: Vec<f32>,
    /// Whether a drop was seen.
    pub is_drop: Vec<bool>,
    /// From 0, not passable, to 1, flat; NaN where it is not known.
    pub traversability: Vec<f32>,
}

/// What is told of a cell: slope, step, roughness, drop, traversability.
type Told = (f32, f32, f32, bool, f32);

impl Traversability {
    /// Of a rectangle of heights; what is beyond its border is not known.
    pub fn of(heights: &DenseHeights, params: &HeightParams) -> Self {
        Self::within(heights, params, 0..heights.width, 0..heights.height)
    }

    /// Of those columns and rows.
    fn within(heights: &DenseHeights, params: &HeightParams, columns: Range<usize>, rows: Range<usize>) -> Self {
        let footprint = Footprint::new(params);
        let width = columns.len();
        let cells = |y: usize| columns.clone().map(move |x| (x, y));
        let told: Vec<Vec<Told>> = rows
            .clone()
            .into_par_iter()
            .map(|y| cells(y).map(|(x, y)| footprint.tell(heights, params, x as i32, y as i32)).collect())
            .collect();
        let told = told.concat();
        let corner = Cell::new(columns.start as i32, rows.start as i32);
        Self {
            geometry: GridGeometry::new(heights.geometry.resolution_m, heights.geometry.corner(corner)),
            width,
            height: rows.len(),
            slope_rad: told.iter().map(|t| t.0).collect(),
            step_m: told.iter().map(|t| t.1).collect(),
            roughness_m: told.iter().map(|t| t.2).collect(),
            is_drop: told.iter().map(|t| t.3).collect(),
            traversability: told.iter().map(|t| t.4).collect(),
        }
    }

    /// As planners take it, in ROS's values: -1 not known, 100 not passable, else from 0, flat, to 50, just passable.
    pub fn to_grid(&self) -> DenseGrid {
        let value = |t: &f32| match t {
            t if t.is_nan() => -1,
            t if *t <= 0.0 => 100,
            t => (PASSABLE * (1.0 - t)).round() as i8,
        };
        let cells = self.traversability.iter().map(value).collect();
        DenseGrid { geometry: self.geometry, width: self.width, height: self.height, cells }
    }
}

impl HeightMap {
    /// Where a robot can drive, in the rectangle from cell `min` to cell `max`, both included: what lies around it counts, too.
    ///
    /// # Errors
    /// As [`HeightMap::region`], of the rectangle with a rim of the footprint's radius and of what an edge may hide.
    pub fn traversability(
        &self,
        min: Cell,
        max: Cell,
        storey: Storey,
        max_cells: usize,
    ) -> Result<Traversability, MappingError> {
        if max.x < min.x || max.y < min.y {
            return Err(MappingError::RegionEmpty);
        }
        let rim = self.params().footprint_cells() + self.params().hidden_cells();
        let low = Cell::new(min.x.saturating_sub(rim), min.y.saturating_sub(rim));
        let high = Cell::new(max.x.saturating_add(rim), max.y.saturating_add(rim));
        let around = self.region(low, high, storey, max_cells)?;
        let inner = |low: i32, min: i32, max: i32| (min - low) as usize..(max - low) as usize + 1;
        Ok(Traversability::within(&around, self.params(), inner(low.x, min.x, max.x), inner(low.y, min.y, max.y)))
    }
}

/// The cells that a robot stands on, by their offsets from that under its middle, and the pairs of them that steps are told by.
struct Footprint {
    offsets: Vec<(i32, i32)>,
    pairs: Vec<(u16, u16)>,
    resolution: f64,
    radius: i32,
    /// Cells that ground may be hidden over.
    hidden: i32,
}

/// Directions in which the ground may go on behind an edge.
const AROUND: [(i32, i32); 8] = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];

impl Footprint {
    fn new(params: &HeightParams) -> Self {
        let (n, resolution) = (params.footprint_cells(), params.resolution_m);
        let radius = 0.5 * params.footprint_m / resolution + 1e-6;
        let is_within = |(x, y): &(i32, i32)| f64::from(*x).hypot(f64::from(*y)) <= radius;
        let offsets: Vec<(i32, i32)> = (-n..=n).flat_map(|y| (-n..=n).map(move |x| (x, y))).filter(is_within).collect();
        let is_near = |a: (i32, i32), b: (i32, i32)| (a.0 - b.0).abs().max((a.1 - b.1).abs()) <= STEP_CELLS;
        let num = offsets.len();
        let all = (0..num).flat_map(|a| (a + 1..num).map(move |b| (a, b)));
        let pairs = all.filter(|(a, b)| is_near(offsets[*a], offsets[*b])).map(|(a, b)| (a as u16, b as u16)).collect();
        Self { offsets, pairs, resolution, radius: n, hidden: params.hidden_cells() }
    }

    fn tell(&self, heights: &DenseHeights, params: &HeightParams, x: i32, y: i32) -> Told {
        let index = y as usize * heights.width + x as usize;
        let (own, top, is_drop) = (heights.ground_m[index], heights.top_m[index], heights.is_drop[index]);
        let stands = !top.is_nan() && (own.is_nan() || f64::from(top - own) > params.max_step_m);
        let blocked = if is_drop || stands { 0.0 } else { f32::NAN };
        let unknown = (f32::NAN, f32::NAN, f32::NAN, is_drop, blocked);
        if own.is_nan() {
            return unknown;
        }
        let ground_at = |(dx, dy): &(i32, i32)| {
            let (x, y) = (x + dx, y + dy);
            let is_within = x >= 0 && y >= 0 && (x as usize) < heights.width && (y as usize) < heights.height;
            if is_within { heights.ground_m[y as usize * heights.width + x as usize] - own } else { f32::NAN }
        };
        let ground: Vec<f32> = self.offsets.iter().map(ground_at).collect();
        let Some((slope, roughness)) = self.plane(&ground) else { return unknown };
        let off = |(a, b): &(u16, u16)| (ground[usize::from(*a)] - ground[usize::from(*b)]).abs();
        // NaN gives way.
        let step = self.pairs.iter().map(off).fold(0.0, f32::max);
        let worst = (slope / params.max_slope_rad)
            .max(f64::from(step) / params.max_step_m)
            .max(roughness / params.max_roughness_m);
        let is_open = !(is_drop || stands) && worst < 1.0 && !self.ends_high(heights, params, (x, y), own);
        let traversability = if is_open { (1.0 - worst) as f32 } else { 0.0 };
        (slope as f32, step, roughness as f32, is_drop, traversability)
    }

    /// Whether ground of this height ends in the footprint, and goes on too low behind what its edge hides.
    fn ends_high(&self, heights: &DenseHeights, params: &HeightParams, (x, y): (i32, i32), own: f32) -> bool {
        let ground_at = |x: i32, y: i32| {
            let is_within = x >= 0 && y >= 0 && (x as usize) < heights.width && (y as usize) < heights.height;
            if is_within { heights.ground_m[y as usize * heights.width + x as usize] } else { f32::NAN }
        };
        AROUND.iter().any(|(dx, dy)| {
            let along = |i: i32| ground_at(x + i * dx, y + i * dy);
            let Some(end) = (1..=self.radius).find(|i| along(*i).is_nan()) else { return false };
            let beyond = (end + 1..=end + self.hidden).find(|i| !along(*i).is_nan());
            beyond.is_some_and(|i| {
                let length_m = f64::from(i) * f64::from(dx.abs() + dy.abs()).sqrt() * self.resolution;
                let falls_m = f64::from(own - along(i));
                falls_m > params.max_step_m.max(params.max_slope_rad.tan() * length_m)
            })
        })
    }

    /// Slope (radians) of the least-squares plane, and standard deviation from it; none of too little ground.
    fn plane(&self, ground: &[f32]) -> Option<(f64, f64)> {
        let known = || self.offsets.iter().zip(ground).filter(|(_, z)| !z.is_nan());
        let points = || known().map(|((x, y), z)| (f64::from(*x), f64::from(*y), f64::from(*z)));
        let num = known().count();
        if (num as f64) < PLANE_SHARE * self.offsets.len() as f64 || num < 4 {
            return None;
        }
        let n = num as f64;
        let (mx, my, mz) = points().fold((0.0, 0.0, 0.0), |s, p| (s.0 + p.0 / n, s.1 + p.1 / n, s.2 + p.2 / n));
        let (mut xx, mut xy, mut yy, mut xz, mut yz, mut zz) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for (x, y, z) in points().map(|p| (p.0 - mx, p.1 - my, p.2 - mz)) {
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
            (xz, yz, zz) = (xz + x * z, yz + y * z, zz + z * z);
        }
        let det = xx * yy - xy * xy;
        // The smaller eigenvalue of the spread.
        let least = 0.5 * (xx + yy - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt()) / n;
        if least < PLANE_SPREAD {
            return None;
        }
        let (a, b) = ((yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det);
        let residual = (zz - a * xz - b * yz).max(0.0) / (n - 3.0);
        Some(((a.hypot(b) / self.resolution).atan(), residual.sqrt()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;

    /// Ground up to column 14, and from column 21 on; nothing was seen in between.
    fn with_gap(near_m: f32, far_m: f32) -> DenseHeights {
        let (width, height) = (40, 20);
        let of_column = |x: usize| match x {
            0..=14 => near_m,
            15..=20 => f32::NAN,
            _ => far_m,
        };
        let ground_m: Vec<f32> = (0..width * height).map(|i| of_column(i % width)).collect();
        let nothing = || vec![f32::NAN; width * height];
        DenseHeights {
            geometry: GridGeometry::new(0.1, Point2::origin()),
            width,
            height,
            sigma_m: nothing(),
            top_m: nothing(),
            overhang_m: nothing(),
            num_keyframes: ground_m.iter().map(|z| u32::from(!z.is_nan()) as _).collect(),
            is_drop: vec![false; width * height],
            ground_m,
        }
    }

    #[test]
    fn an_edge_behind_which_the_ground_is_hidden_is_no_way_down_if_it_goes_on_too_low() {
        let params = HeightParams::default();
        let passable = |near_m, far_m| {
            let told = Traversability::of(&with_gap(near_m, far_m), &params);
            let at = |x: usize| told.traversability[10 * told.width + x] > 0.0;
            [at(14), at(10), at(21), at(25)]
        };
        assert_eq!(passable(0.0, 0.0), [true; 4]);
        // 0.2 m down over 0.7 m: more than 0.1 m, more than 14 degrees.
        assert_eq!(passable(0.2, 0.0), [false, true, true, true]);
        assert_eq!(passable(0.0, 0.4), [true, true, false, true]);
        // A slope may take it down by so much.
        assert_eq!(passable(0.05, 0.0), [true; 4]);
    }
}
