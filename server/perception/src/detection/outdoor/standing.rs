//! What stands on the ground: the points above it, and how high above it they are.

use super::OutdoorParams;
use crate::segmentation::segment_ground;
use nalgebra::Point3;
use percept_geometry::GeometryError;

/// Edge of the cells in which the ground is level, metres: half the width of a lane, less than a ramp rises much in.
const CELL_M: f64 = 1.0;

/// Height of the ground around the sensor, everywhere within range.
struct GroundHeights {
    cells: Vec<f32>,
    /// Cells along an edge; the sensor stands in the middle.
    edge: usize,
}

impl GroundHeights {
    /// Cells without ground points take the mean of those beside them that have a height, from these outward.
    fn new(points: &[Point3<f32>], is_ground: &[bool], params: &OutdoorParams) -> Self {
        let edge = 2 * (params.ground.max_range_m / CELL_M).ceil() as usize;
        let mut out = Self { cells: vec![f32::NAN; edge * edge], edge };
        let mut sums = vec![(0.0f64, 0u32); edge * edge];
        for (p, _) in points.iter().zip(is_ground).filter(|(_, is_ground)| **is_ground) {
            if let Some(cell) = out.cell(p) {
                sums[cell].0 += f64::from(p.z);
                sums[cell].1 += 1;
            }
        }
        let mut border = Vec::new();
        for (cell, (sum, count)) in sums.iter().enumerate().filter(|(_, s)| s.1 > 0) {
            out.cells[cell] = (sum / f64::from(*count)) as f32;
            border.push(cell);
        }
        if border.is_empty() {
            out.cells.fill(-params.ground.sensor_height_m as f32);
        }
        while !border.is_empty() {
            border = out.grow(&border);
        }
        out
    }

    /// Fills the empty cells beside `border`, all from what was filled before, and says which these are.
    fn grow(&mut self, border: &[usize]) -> Vec<usize> {
        let mut empty: Vec<usize> =
            border.iter().flat_map(|&c| self.around(c)).filter(|&c| self.cells[c].is_nan()).collect();
        empty.sort_unstable();
        empty.dedup();
        let filled: Vec<f32> = empty
            .iter()
            .map(|&cell| {
                let known = self.around(cell).map(|c| self.cells[c]).filter(|z| !z.is_nan());
                let (sum, count) = known.fold((0.0, 0.0), |(sum, count), z| (sum + z, count + 1.0));
                sum / count
            })
            .collect();
        empty.iter().zip(filled).for_each(|(&cell, z)| self.cells[cell] = z);
        empty
    }

    fn around(&self, cell: usize) -> impl Iterator<Item = usize> + use<> {
        let edge = self.edge as isize;
        let (x, y) = (cell as isize % edge, cell as isize / edge);
        (-1..=1)
            .flat_map(move |dy| (-1..=1).map(move |dx| (x + dx, y + dy)))
            .filter(move |&(x, y)| (0..edge).contains(&x) && (0..edge).contains(&y))
            .map(move |(x, y)| (y * edge + x) as usize)
    }

    fn cell(&self, p: &Point3<f32>) -> Option<usize> {
        let half = self.edge as f32 * 0.5;
        let at = |v: f32| {
            let i = (v / CELL_M as f32 + half).floor();
            (i >= 0.0 && i < self.edge as f32).then_some(i as usize)
        };
        Some(at(p.y)? * self.edge + at(p.x)?)
    }
}

/// The points of a scan that stand on the ground.
pub(super) struct Standing {
    /// In the scan's frame, metres.
    pub(super) points: Vec<Point3<f32>>,
    /// Height of each above the ground under it, metres.
    pub(super) heights: Vec<f32>,
    /// Points that stand higher than any object, and their heights.
    pub(super) above: Vec<(Point3<f32>, f32)>,
}

impl Standing {
    /// Of a scan in the sensor's frame.
    pub(super) fn of(points: &[Point3<f32>], params: &OutdoorParams) -> Result<Self, GeometryError> {
        let is_ground = segment_ground(points, &params.ground)?.is_ground;
        let ground = GroundHeights::new(points, &is_ground, params);
        let (near, far) = (params.ground.min_range_m as f32, params.ground.max_range_m as f32);
        let (low, high) = (params.min_height_m as f32, params.max_height_m as f32);
        let mut out = Self { points: Vec::new(), heights: Vec::new(), above: Vec::new() };
        for (p, _) in points.iter().zip(&is_ground).filter(|(_, is_ground)| !**is_ground) {
            let range = p.x.hypot(p.y);
            // False for NaN.
            if !(range >= near && range <= far) {
                continue;
            }
            let Some(cell) = ground.cell(p) else { continue };
            let height = p.z - ground.cells[cell];
            if height > high {
                out.above.push((*p, height));
            } else if height >= low {
                out.points.push(*p);
                out.heights.push(height);
            }
        }
        Ok(out)
    }
}
