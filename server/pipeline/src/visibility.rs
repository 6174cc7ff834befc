//! Which boxes the newest scan saw through: a range image of the scan, asked about points in the box.

use nalgebra::Point3;
use percept_geometry::{KeyframeScan, OrientedBox3, Pose};
use percept_scene::Visibility;

/// Bins of 2 degrees.
const COLUMNS: usize = 180;
const ROWS: usize = 90;
/// A surface must lie this far behind a point to count as seen through it, metres.
const MARGIN_M: f32 = 0.3;
/// Share of the box's sample points that must be seen through.
const SHARE: f64 = 0.6;

/// Nearest range in every direction around the sensor.
pub(crate) struct RangeImage {
    t_base_sensor: Pose,
    /// ROWS x COLUMNS, metres; infinite where nothing was measured.
    nearest: Vec<f32>,
}

impl RangeImage {
    pub(crate) fn new(scan: &KeyframeScan) -> Self {
        let t_sensor_base = scan.t_base_sensor.inverse();
        let mut nearest = vec![f32::INFINITY; ROWS * COLUMNS];
        for p in &scan.hits.positions {
            let q = t_sensor_base * p.cast::<f64>();
            if let Some(i) = bin(&q) {
                nearest[i] = nearest[i].min(q.coords.norm() as f32);
            }
        }
        Self { t_base_sensor: scan.t_base_sensor, nearest }
    }

    /// Whether surfaces were measured behind most of a box in the map, by a robot at `t_map_base`.
    pub(crate) fn visibility(&self, t_map_base: &Pose, bbox: &OrientedBox3) -> Visibility {
        let t_sensor_map = (t_map_base * self.t_base_sensor).inverse();
        let (mut through, mut hit, mut total) = (0.0, 0.0, 0.0);
        for p in sample_points(bbox) {
            total += 1.0;
            let q = t_sensor_map * p;
            let range = q.coords.norm() as f32;
            let Some(i) = bin(&q) else { continue };
            match self.nearest[i] {
                measured if !measured.is_finite() => {}
                measured if measured > range + MARGIN_M => through += 1.0,
                measured if measured > range - MARGIN_M => hit += 1.0,
                _ => {}
            }
        }
        if through / total >= SHARE {
            Visibility::SeenThrough
        } else if (through + hit) / total >= SHARE {
            Visibility::Occupied
        } else {
            Visibility::Unseen
        }
    }
}

fn bin(p_sensor: &Point3<f64>) -> Option<usize> {
    let range = p_sensor.coords.norm();
    if range < 1e-6 {
        return None;
    }
    use std::f64::consts::{PI, TAU};
    let column = ((p_sensor.y.atan2(p_sensor.x) + PI) / TAU * COLUMNS as f64) as usize % COLUMNS;
    let row = (((p_sensor.z / range).clamp(-1.0, 1.0).asin() + PI / 2.0) / PI * ROWS as f64) as usize;
    Some(row.min(ROWS - 1) * COLUMNS + column)
}

/// A 3 x 3 x 3 lattice in the inner 60 % of the box.
fn sample_points(bbox: &OrientedBox3) -> impl Iterator<Item = Point3<f64>> + '_ {
    (0..27).map(move |i| {
        let at = |k: i32, size: f64| f64::from(k - 1) * 0.3 * size;
        bbox.t_frame_box * Point3::new(at(i % 3, bbox.size.x), at(i / 3 % 3, bbox.size.y), at(i / 9, bbox.size.z))
    })
}
