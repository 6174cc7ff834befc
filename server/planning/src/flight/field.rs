//! Where the ball's centre may be.

use super::clearance::squared_clearances;
use super::keep_out::KeepOut;
use super::{DenseVoxels, FlightParams, FlightRequest};
use crate::CellState;
use nalgebra::{Point3, Vector3};

/// A box of voxels, what is an obstacle in it, and how far that is. Positions here are in voxels from the box's lowest
/// corner: voxel `i` reaches from `i` to `i + 1` along each axis.
pub(super) struct Field<'a> {
    voxels: &'a DenseVoxels,
    allow_unknown: bool,
    /// Radius of the ball, voxels.
    pub(super) radius: f64,
    obstacle: Vec<bool>,
    /// Columns that are closed whatever is in them; none if there are no zones.
    keep_out: Option<KeepOut>,
    /// Voxels of at least this value are occupied, per cent.
    least: f64,
    /// As [`squared_clearances`] gives them.
    squares: Vec<u16>,
    /// Voxels whose centre the ball's may enter.
    open: Vec<bool>,
}

/// Clearances are told up to so many voxels beyond the radius.
const BEYOND: f64 = 2.0;

/// Smaller balls are as large, voxels.
const LEAST_RADIUS: f64 = 1e-6;

/// Share by which a clearance may be short of what is needed: rounding.
const ROUNDING: f64 = 1e-9;

impl<'a> Field<'a> {
    /// Of sound voxels and parameters; `start` in voxels from the box's corner.
    pub(super) fn new(voxels: &'a DenseVoxels, request: &FlightRequest<'_>, start: &Point3<f64>) -> Self {
        let params = request.params;
        let least = 100.0 * params.occupied_probability;
        let is_obstacle = |v: &i8| if *v < 0 { !params.allow_unknown } else { f64::from(*v) >= least };
        // A point, too, has to stay out of obstacles.
        let radius = (params.robot_radius_m / voxels.voxel_size_m).max(LEAST_RADIUS);
        let mut out = Self {
            voxels,
            allow_unknown: params.allow_unknown,
            radius,
            obstacle: voxels.percent.iter().map(is_obstacle).collect(),
            keep_out: None,
            least,
            squares: vec![],
            open: vec![],
        };
        let tolerance = params.start_tolerance_m / voxels.voxel_size_m;
        for index in out.within(start, tolerance) {
            if voxels.percent[index] < 0 {
                out.obstacle[index] = false;
            }
        }
        let most = (radius + BEYOND + 0.5).ceil() as usize + 1;
        out.keep_out = KeepOut::of(voxels, request.zones, request.masks, least, most);
        if let Some(keep_out) = &out.keep_out {
            keep_out.close(&mut out.obstacle);
        }
        out.squares = squared_clearances(&out.obstacle, voxels.size, most, params.allow_unknown);
        if let Some(keep_out) = &out.keep_out {
            keep_out.limit(&mut out.squares, most);
        }
        let allowed: Vec<bool> = (0..voxels.size[2]).map(|z| out.is_height_allowed(z as f64 + 0.5, params)).collect();
        let of_layer = voxels.size[0] * voxels.size[1];
        let is_open = |(i, square): (usize, &u16)| allowed[i / of_layer] && out.is_wide(*square);
        out.open = out.squares.iter().enumerate().map(is_open).collect();
        out
    }

    /// Whether the ball fits where this is the square of twice the clearance.
    fn is_wide(&self, square: u16) -> bool {
        let needed = 2.0 * self.radius * (1.0 - ROUNDING);
        square > 0 && f64::from(square) >= needed * needed
    }

    /// Whether a height above the box's floor, in voxels, is within the limits.
    pub(super) fn is_height_allowed(&self, z: f64, params: &FlightParams) -> bool {
        let height = (f64::from(self.voxels.low.z) + z) * self.voxels.voxel_size_m;
        params.min_z_m.is_none_or(|least| height >= least) && params.max_z_m.is_none_or(|most| height <= most)
    }

    /// Opens voxels within `tolerance` (voxels) of a start whose clearance is less than the radius, where that is no less.
    pub(super) fn open_around(&mut self, start: &Point3<f64>, clearance: f64, tolerance: f64, params: &FlightParams) {
        for index in self.within(start, tolerance) {
            let needed = 2.0 * clearance * (1.0 - ROUNDING);
            let is_no_nearer = self.squares[index] > 0 && f64::from(self.squares[index]) >= needed * needed;
            self.open[index] |= is_no_nearer && self.is_height_allowed(self.center(index).z, params);
        }
    }

    /// Voxels along each axis.
    pub(super) fn size(&self) -> [usize; 3] {
        self.voxels.size
    }

    pub(super) fn is_open(&self, index: usize) -> bool {
        self.open[index]
    }

    /// Whether the ball fits on this voxel's centre, however it came to be open.
    pub(super) fn fits(&self, index: usize) -> bool {
        self.is_wide(self.squares[index])
    }

    /// Whether nothing is known of this voxel.
    pub(super) fn is_unknown(&self, index: usize) -> bool {
        self.voxels.percent[index] < 0
    }

    /// What is in a voxel.
    pub(super) fn state(&self, index: usize) -> CellState {
        let [x, y, _] = self.coordinates(index);
        let is_kept_out = || self.keep_out.as_ref().is_some_and(|k| k.holds(x as i64, y as i64));
        match self.voxels.percent[index] {
            _ if !self.obstacle[index] => CellState::Free,
            v if f64::from(v) >= self.least => CellState::Occupied,
            _ if is_kept_out() => CellState::KeepOut,
            _ => CellState::Unknown,
        }
    }

    /// What is beyond the box over a place in voxels, if that is an obstacle.
    pub(super) fn state_beyond(&self, p: &Point3<f64>) -> Option<CellState> {
        let is_kept_out = || self.keep_out.as_ref().is_some_and(|k| k.holds(p.x.floor() as i64, p.y.floor() as i64));
        if self.allow_unknown { is_kept_out().then_some(CellState::KeepOut) } else { Some(CellState::Unknown) }
    }

    /// Map frame, metres, to voxels from the box's corner.
    pub(super) fn located(voxels: &DenseVoxels, p: &Point3<f64>) -> Point3<f64> {
        let low = Vector3::new(f64::from(voxels.low.x), f64::from(voxels.low.y), f64::from(voxels.low.z));
        p / voxels.voxel_size_m - low
    }

    /// The other way round.
    pub(super) fn placed(&self, p: &Point3<f64>) -> Point3<f64> {
        let low = self.voxels.low;
        let low = Vector3::new(f64::from(low.x), f64::from(low.y), f64::from(low.z));
        (p + low) * self.voxels.voxel_size_m
    }

    /// Index of the voxel that holds a point; none outside.
    pub(super) fn index_at(&self, p: &Point3<f64>) -> Option<usize> {
        let [x, y, z] = self.size();
        let along = |v: f64, side: usize| (v >= 0.0 && v < side as f64).then_some(v as usize);
        Some((along(p.z, z)? * y + along(p.y, y)?) * x + along(p.x, x)?)
    }

    /// Its voxel's place along each axis.
    pub(super) fn coordinates(&self, index: usize) -> [usize; 3] {
        let [x, y, _] = self.size();
        [index % x, index / x % y, index / (x * y)]
    }

    pub(super) fn center(&self, index: usize) -> Point3<f64> {
        Point3::from(self.coordinates(index).map(|v| v as f64 + 0.5))
    }

    /// Voxels of the box with their centre within `radius` of a point, and the one that holds it.
    pub(super) fn within(&self, p: &Point3<f64>, radius: f64) -> Vec<usize> {
        let [x, y, z] = self.size();
        let range = |v: f64, side: usize| {
            let low = (v - radius).floor().clamp(0.0, side as f64) as usize;
            low..((v + radius).floor() + 1.0).clamp(0.0, side as f64) as usize
        };
        let holds = self.index_at(p);
        let mut out = vec![];
        for k in range(p.z, z) {
            for j in range(p.y, y) {
                let row = range(p.x, x).map(|i| (k * y + j) * x + i);
                out.extend(row.filter(|i| (self.center(*i) - p).norm() <= radius || Some(*i) == holds));
            }
        }
        out
    }

    /// The largest clearance that is told, voxels.
    pub(super) fn farthest(&self) -> f64 {
        self.radius + BEYOND
    }

    /// Distance from a segment within the box to the nearest obstacle's surface, voxels, at most `limit`, which is at most
    /// [`Field::farthest`]. Exact; 0 where it touches.
    pub(super) fn segment_clearance(&self, a: &Point3<f64>, b: &Point3<f64>, limit: f64) -> f64 {
        let pieces = ((b - a).norm() / 2.0).ceil().max(1.0);
        let at = |i: f64| a + (b - a) * (i / pieces);
        let piece = |nearest, i: usize| self.piece_clearance(&at(i as f64), &at(i as f64 + 1.0), nearest);
        (0..pieces as usize).fold(limit, piece)
    }

    fn piece_clearance(&self, a: &Point3<f64>, b: &Point3<f64>, limit: f64) -> f64 {
        let middle = nalgebra::center(a, b);
        let half = 0.5 * (b - a).norm();
        let Some(index) = self.index_at(&middle) else { return 0.0 };
        let at_center = 0.5 * f64::from(self.squares[index]).sqrt();
        let off = (self.center(index) - middle).norm();
        if at_center - off - half >= limit {
            return limit;
        }
        let mut nearest = limit;
        self.each_cube(&middle, limit + half, |low, _| {
            nearest = nearest.min(segment_to_cube(a, b, low));
        });
        nearest
    }

    /// The obstacle nearest to a point within `reach` voxels: a point of its cube's centre, and its index if it is in the box.
    pub(super) fn nearest_obstacle(&self, p: &Point3<f64>, reach: f64) -> Option<(Point3<f64>, Option<usize>)> {
        let mut best: Option<(f64, Point3<f64>, Option<usize>)> = None;
        self.each_cube(p, reach, |low, index| {
            let gap = segment_to_cube(p, p, low);
            if best.is_none_or(|(least, ..)| gap < least) {
                best = Some((gap, low + Vector3::repeat(0.5), index));
            }
        });
        best.map(|(_, center, index)| (center, index))
    }

    /// Visits the lowest corner of each obstacle's cube that reaches into a cube of this half edge, x fastest. Beyond the
    /// box all is an obstacle unless unknown voxels are free; then keep-out columns are.
    fn each_cube(&self, p: &Point3<f64>, reach: f64, mut visit: impl FnMut(&Point3<f64>, Option<usize>)) {
        let range = |i: usize| (p[i] - reach).floor() as i64..=(p[i] + reach).floor() as i64;
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    let low = Point3::new(x as f64, y as f64, z as f64);
                    let index = self.index_at(&low);
                    if index.map_or_else(|| self.state_beyond(&low).is_some(), |i| self.obstacle[i]) {
                        visit(&low, index);
                    }
                }
            }
        }
    }
}

/// Distance between a segment and the unit cube with its lowest corner at `low`.
///
/// Along the segment the square of the distance is convex, and a parabola between the places where it crosses the faces'
/// planes.
fn segment_to_cube(a: &Point3<f64>, b: &Point3<f64>, low: &Point3<f64>) -> f64 {
    let along = b - a;
    let gaps = |t: f64| {
        let p = a + along * t;
        Vector3::from_fn(|i, _| (p[i] - low[i] - 1.0).max(0.0) + (p[i] - low[i]).min(0.0))
    };
    let mut places = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    for i in (0..3).filter(|i| along[*i] != 0.0) {
        places[2 + 2 * i] = ((low[i] - a[i]) / along[i]).clamp(0.0, 1.0);
        places[3 + 2 * i] = ((low[i] + 1.0 - a[i]) / along[i]).clamp(0.0, 1.0);
    }
    places.sort_by(f64::total_cmp);
    let mut nearest = gaps(1.0).norm_squared();
    for pair in places.windows(2) {
        let begin = gaps(pair[0]);
        nearest = nearest.min(begin.norm_squared());
        let span = pair[1] - pair[0];
        if span > 0.0 {
            // The gaps change evenly in between.
            let slope = (gaps(pair[1]) - begin) / span;
            let bottom = if slope.norm_squared() > 0.0 { -begin.dot(&slope) / slope.norm_squared() } else { 0.0 };
            nearest = nearest.min((begin + slope * bottom.clamp(0.0, span)).norm_squared());
        }
    }
    nearest.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_segments_distance_is_that_of_its_nearest_sample(
            a in prop::array::uniform3(-3.0..4.0f64), b in prop::array::uniform3(-3.0..4.0f64), flat in 0..4usize,
        ) {
            let (a, mut b) = (Point3::from(a), Point3::from(b));
            if flat < 3 {
                b[flat] = a[flat];
            }
            let low = Point3::origin();
            let to_cube = |p: Point3<f64>| (p - p.coords.map(|v| v.clamp(0.0, 1.0))).coords.norm();
            let sampled = (0..=2000).map(|i| to_cube(a + (b - a) * (f64::from(i) / 2000.0)));
            let sampled = sampled.fold(f64::INFINITY, f64::min);
            let exact = segment_to_cube(&a, &b, &low);
            prop_assert!(exact <= sampled + 1e-9 && exact >= sampled - (b - a).norm() / 2000.0, "{exact} {sampled}");
        }
    }
}
