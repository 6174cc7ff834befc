//! The numbers by which a part of a scan is judged.

use super::OutdoorParams;
use super::rectangle::Footprint;
use super::standing::Standing;
use nalgebra::{Point2, Point3};

/// Numbers a candidate has.
pub const NUM_TRAITS: usize = 15;

/// Numbers of one candidate. In order: logarithms of length, width and height above the ground (m); height of its
/// lowest point (m); mean and spread of its points' height over its height; closeness of its points to the faces that
/// are seen; logarithm of the share of expected points that came back; lengths of its upper and of its lower half over
/// its length; what goes on above it (logarithm, m); logarithm of points before its ends, and beside it, over its own;
/// how much higher the highest beam passes (m); logarithm of how far beams beside each other end from each other (m):
/// leaves let some pass, bodies do not.
pub type Traits = [f64; NUM_TRAITS];

/// A candidate's height is that of all but so many of its points: a stray one higher up does not count.
const TOP_SHARE: f64 = 0.01;
/// Before the ends and beside a candidate is what is so far from its footprint, metres: farther than a corner bulges.
const BESIDE_M: [f64; 2] = [0.3, 1.1];
/// Edge of the cells by which that is told, metres.
const CELL_M: f64 = 0.25;
/// So many of the beams, at most, go higher than the highest one is taken to.
const STRAY_BEAMS: f64 = 0.001;

/// A part of a scan that may be one object.
#[derive(Debug, Clone)]
pub(super) struct Shape {
    pub(super) footprint: Footprint,
    /// Height of its top above the ground, metres.
    pub(super) top: f64,
    /// Height of the ground under it in the scan's frame, metres.
    pub(super) ground: f64,
    pub(super) traits: Traits,
}

/// What stands where, and how dense the scan is.
pub(super) struct Surroundings {
    counts: Vec<u32>,
    tops: Vec<f32>,
    edge: usize,
    /// Points a steradian where the beams are.
    density: f64,
    /// Slope of the highest beams.
    slope: f64,
}

impl Surroundings {
    pub(super) fn new(standing: &Standing, params: &OutdoorParams) -> Self {
        let edge = 2 * (params.ground.max_range_m / CELL_M).ceil() as usize;
        let density = 1.0 / (params.horizontal_step_rad * params.vertical_step_rad).max(1e-9);
        let mut out = Self { counts: vec![0; edge * edge], tops: vec![0.0; edge * edge], edge, density, slope: 0.0 };
        for (p, &h) in standing.points.iter().zip(&standing.heights) {
            if let Some(cell) = out.cell(f64::from(p.x), f64::from(p.y)) {
                out.counts[cell] += 1;
                out.tops[cell] = out.tops[cell].max(h);
            }
        }
        for (p, h) in &standing.above {
            if let Some(cell) = out.cell(f64::from(p.x), f64::from(p.y)) {
                out.tops[cell] = out.tops[cell].max(*h);
            }
        }
        let all = standing.points.iter().chain(standing.above.iter().map(|a| &a.0));
        let mut slopes: Vec<f32> = all.map(|p| p.z / p.x.hypot(p.y).max(0.1)).collect();
        let stray = (slopes.len() as f64 * STRAY_BEAMS) as usize;
        if !slopes.is_empty() {
            out.slope = f64::from(*slopes.select_nth_unstable_by(stray, |a, b| b.total_cmp(a)).1);
        }
        out
    }

    fn cell(&self, x: f64, y: f64) -> Option<usize> {
        let at = |v: f64| {
            let i = (v / CELL_M + 0.5 * self.edge as f64).floor();
            (i >= 0.0 && i < self.edge as f64).then_some(i as usize)
        };
        Some(at(y)? * self.edge + at(x)?)
    }

    /// The cells at the middles of pieces of a rectangle along a footprint's axes.
    fn cells(&self, footprint: &Footprint, u: [f64; 2], v: [f64; 2], out: &mut Vec<usize>) {
        let (sin, cos) = footprint.yaw.sin_cos();
        let steps = |of: [f64; 2]| ((of[1] - of[0]) / CELL_M).ceil().max(1.0) as usize;
        let at = |of: [f64; 2], i: usize| of[0] + (of[1] - of[0]) * (i as f64 + 0.5) / steps(of) as f64;
        for (i, j) in (0..steps(u)).flat_map(|i| (0..steps(v)).map(move |j| (i, j))) {
            let (u, v) = (at(u, i), at(v, j));
            out.extend(self.cell(u * cos - v * sin, u * sin + v * cos));
        }
    }

    fn zones(&self, footprint: &Footprint, zones: &[[[f64; 2]; 2]]) -> Vec<usize> {
        let mut out = Vec::new();
        zones.iter().for_each(|z| self.cells(footprint, z[0], z[1], &mut out));
        out.sort_unstable();
        out.dedup();
        out
    }

    /// Greatest height on a footprint, and points beyond both ends of its axes.
    fn around(&self, f: &Footprint) -> (f64, [f64; 2]) {
        let on = self.zones(f, &[[[f.low[0], f.high[0]], [f.low[1], f.high[1]]]]);
        let top = on.iter().map(|&c| self.tops[c]).fold(0.0, f32::max);
        let beyond = |axis: usize| {
            let [near, far] = BESIDE_M;
            let along = [f.low[1 - axis], f.high[1 - axis]];
            let ends = [[f.low[axis] - far, f.low[axis] - near], [f.high[axis] + near, f.high[axis] + far]];
            let zones = ends.map(|end| if axis == 0 { [end, along] } else { [along, end] });
            self.zones(f, &zones).iter().map(|&c| f64::from(self.counts[c])).sum()
        };
        (f64::from(top), [beyond(0), beyond(1)])
    }
}

impl Shape {
    /// Of some of the points that stand; none if there are none, or if they are longer than an object.
    pub(super) fn of(
        members: &[u32],
        standing: &Standing,
        around: &Surroundings,
        params: &OutdoorParams,
    ) -> Option<Self> {
        let points: Vec<&Point3<f32>> = members.iter().map(|&i| &standing.points[i as usize]).collect();
        let flat: Vec<Point2<f64>> = points.iter().map(|p| p.xy().cast()).collect();
        let is_long = |f: &Footprint| f.extent(0).max(f.extent(1)) > params.max_length_m;
        // Whatever is much longer along one direction is longer along every other but few.
        if [0.0, std::f64::consts::FRAC_PI_4]
            .iter()
            .all(|&yaw| Footprint::along(&flat, yaw).is_none_or(|f| is_long(&f)))
        {
            return None;
        }
        let footprint = Footprint::of(&flat).filter(|f| !is_long(f))?;
        let mut heights: Vec<f64> = members.iter().map(|&i| f64::from(standing.heights[i as usize])).collect();
        heights.sort_unstable_by(f64::total_cmp);
        let num = heights.len();
        let top = heights[num - 1 - (num as f64 * TOP_SHARE) as usize];
        let mut grounds: Vec<f64> =
            members.iter().map(|&i| f64::from(standing.points[i as usize].z - standing.heights[i as usize])).collect();
        let ground = *grounds.select_nth_unstable_by(num / 2, f64::total_cmp).1;
        let long = usize::from(footprint.extent(1) > footprint.extent(0));
        let (length, width) = (footprint.extent(long), footprint.extent(1 - long));
        let mean = heights.iter().sum::<f64>() / num as f64;
        let spread = (heights.iter().map(|h| (h - mean).powi(2)).sum::<f64>() / num as f64).sqrt();
        let direction = footprint.yaw + std::f64::consts::FRAC_PI_2 * long as f64;
        let half = |is_upper: bool| {
            let (sin, cos) = direction.sin_cos();
            let of_half = members
                .iter()
                .zip(&flat)
                .filter(|(i, _)| (f64::from(standing.heights[**i as usize]) > 0.6 * top) == is_upper);
            let (low, high) = of_half
                .map(|(_, p)| p.x * cos + p.y * sin)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
            (high - low).max(0.0) / length.max(0.1)
        };
        let center = flat.iter().fold(nalgebra::Vector2::zeros(), |sum, p| sum + p.coords) / num as f64;
        let range = center.norm().max(1.0);
        // Width across the line of sight of the footprint's rectangle, from its two sides.
        let off = (direction - center.y.atan2(center.x)).sin().abs();
        let across = length * off + width * (1.0 - off * off).sqrt();
        let expected = around.density * across.max(0.1) * (top - params.min_height_m).max(0.1) / (range * range);
        let (above, beyond) = around.around(&footprint);
        let beside = |axis: usize| ((beyond[axis] + 1.0) / num as f64).ln().max(-4.0);
        let highest = around.slope * range - ground;
        let traits = [
            length.max(0.1).ln(),
            width.max(0.05).ln(),
            top.max(0.1).ln(),
            heights[0],
            mean / top,
            spread / top,
            footprint.closeness,
            (num as f64 / expected).max(0.01).ln(),
            half(true),
            half(false),
            (above - top).max(0.1).ln(),
            beside(long),
            beside(1 - long),
            (highest - top).clamp(-0.5, 3.0),
            (depth(&points, params) + 0.02).ln(),
        ];
        Some(Self { footprint, top, ground, traits })
    }
}

/// Beams so many steps apart are beside each other, along a ring and from ring to ring.
const BESIDE_STEPS: [f64; 2] = [4.0, 2.0];

/// How far, on the mean, the ranges of beams beside each other differ, metres; 0 if none are.
fn depth(points: &[&Point3<f32>], params: &OutdoorParams) -> f64 {
    let bin = |angle: f64, step: f64| (angle / step.max(1e-4)).floor() as i64;
    let mut beams: Vec<(i64, i64, f64)> = points
        .iter()
        .map(|p| {
            let (x, y, z) = (f64::from(p.x), f64::from(p.y), f64::from(p.z));
            let range = x.hypot(y);
            let along = bin(y.atan2(x), BESIDE_STEPS[0] * params.horizontal_step_rad);
            (along, bin(z / range, BESIDE_STEPS[1] * params.vertical_step_rad), range)
        })
        .collect();
    beams.sort_unstable_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)).then(a.2.total_cmp(&b.2)));
    let groups = beams.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).filter(|g| g.len() > 1);
    let (sum, count) = groups.fold((0.0, 0.0), |(sum, n), g| (sum + g[g.len() - 1].2 - g[0].2, n + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}
