//! How far one keyframe saw in each direction.

use super::CloudParams;
use nalgebra::{Point3, Vector3};
use std::f64::consts::{PI, TAU};

const COLUMNS: usize = 720;
const ROWS: usize = 360;

/// The shortest beam in each half degree of azimuth and elevation around the sensor, along the map's axes.
#[derive(Debug, Clone)]
pub(super) struct RangeImage {
    sensor: Point3<f64>,
    max_range: f64,
    /// Rows of `COLUMNS`, empty where no beam went: a planar scan fills few.
    rows: Vec<Vec<Bin>>,
}

/// Range (m), infinite without a beam, and the beam's unit direction.
type Bin = (f32, Vector3<f32>);

impl RangeImage {
    /// From the ends of beams in the map frame, returns and misses alike; ends that are not finite are left out.
    pub(super) fn new(sensor: Point3<f64>, ends: impl Iterator<Item = Point3<f64>>) -> Self {
        let mut out = Self { sensor, max_range: 0.0, rows: Vec::new() };
        for end in ends {
            let beam = end - sensor;
            let range = beam.norm();
            if !(range.is_finite() && range > 1e-6) {
                continue;
            }
            if out.rows.is_empty() {
                out.rows = vec![Vec::new(); ROWS];
            }
            out.max_range = out.max_range.max(range);
            let (row, column) = bin(&beam, range);
            let row = &mut out.rows[row];
            if row.is_empty() {
                *row = vec![(f32::INFINITY, Vector3::zeros()); COLUMNS];
            }
            let slot = &mut row[column];
            if (range as f32) < slot.0 {
                *slot = (range as f32, (beam / range).cast());
            }
        }
        out
    }

    /// Where the beams start, map frame.
    pub(super) fn sensor(&self) -> &Point3<f64> {
        &self.sensor
    }

    /// Length of the longest beam, metres.
    pub(super) fn max_range(&self) -> f64 {
        self.max_range
    }

    /// Whether a beam passed within half a voxel of `p` and ended well behind it, while no beam beside it ended
    /// near `p` or before.
    pub(super) fn sees_through(&self, p: &Point3<f64>, params: &CloudParams) -> bool {
        let offset = p - self.sensor;
        let r = offset.norm();
        let behind = r + params.margin(r);
        if self.rows.is_empty() || r < params.range_min_m || behind > self.max_range {
            return false;
        }
        let (row, column) = bin(&offset, r);
        let Some(&(range, direction)) = self.rows[row].get(column) else { return false };
        let passes = offset.cross(&direction.cast()).norm() <= 0.5 * params.voxel_size_m;
        if !range.is_finite() || f64::from(range) < behind || !passes {
            return false;
        }
        let rows = row.saturating_sub(1)..=(row + 1).min(ROWS - 1);
        rows.flat_map(|y| [COLUMNS - 1, 0, 1].map(|dx| (y, (column + dx) % COLUMNS)))
            .all(|(y, x)| self.rows[y].get(x).is_none_or(|b| f64::from(b.0) >= behind))
    }
}

fn bin(v: &Vector3<f64>, norm: f64) -> (usize, usize) {
    let elevation = (v.z / norm).clamp(-1.0, 1.0).asin();
    let row = ((elevation / PI + 0.5) * ROWS as f64) as usize;
    let column = ((v.y.atan2(v.x) + PI) / TAU * COLUMNS as f64) as usize;
    (row.min(ROWS - 1), column.min(COLUMNS - 1))
}
