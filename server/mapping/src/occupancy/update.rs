//! One keyframe as marks on cells: which it saw free, which it hit, each once.

use super::OccupancyParams;
use super::columns::Columns;
use super::marks::{Frame, Heights, Mark, ScanUpdate};
use crate::ground::{Ground, GroundParams};
use nalgebra::{Point3, Vector3};
use percept_geometry::{Cell, GridGeometry, KeyframeScan, Pose};

impl ScanUpdate {
    /// The marks of a scan taken at `t_map_base`.
    ///
    /// **Planar scans**: each return within `range_max_m` marks its own end and frees the cells before it; misses
    /// and returns beyond only free. **Others**: heights are taken along the map's z, from the ground that the scan
    /// shows, which goes on from the floor under base. Returns in the band mark their ends, unless the ground there is in more doubt
    /// than they are high. In each azimuth column seen from the sensor, the cells up to the nearest of them are
    /// free, or without one, up to the farthest floor return, far return or end of a miss (each only as far as its
    /// beam stays in the band); behind it, those between ground and ground that were seen over it. Where the ground drops, its edge
    /// is marked. Free cells hold the heights at which the beams of the column pass there, so
    /// that looking under a table does not free its top. Points that are not finite, or beyond the range
    /// of the indices, say nothing.
    pub fn new(params: &OccupancyParams, geometry: &GridGeometry, t_map_base: &Pose, scan: &KeyframeScan) -> Self {
        let sensor = Point3::from((t_map_base * scan.t_base_sensor).translation.vector);
        let in_map = |p: &Point3<f32>| t_map_base * p.cast::<f64>();
        let ends = scan.hits.positions.iter().chain(&scan.misses);
        let ranges = ends.map(|p| (in_map(p) - sensor).xy().norm()).filter(|r| r.is_finite());
        let half = (ranges.fold(0.0, f64::max).min(params.range_max()) / geometry.resolution_m).ceil() as i32 + 1;
        let min = geometry.cell(&sensor.xy()).and_then(|c| {
            c.x.checked_add(half).and(c.y.checked_add(half))?;
            Some(Cell::new(c.x.checked_sub(half)?, c.y.checked_sub(half)?))
        });
        let Some(min) = min else {
            return Self { min: Cell::new(0, 0), width: 0, planar: true, marks: Vec::new() };
        };
        let width = 2 * half as usize + 1;
        let mut update = Self { min, width, planar: scan.planar, marks: vec![Mark::Unseen; width * width] };
        let frame = Frame { params, geometry, sensor, floor_z: t_map_base.translation.vector.z - scan.base_height_m };
        if scan.planar {
            frame.mark_beams(&mut update, &scan.hits.positions, &scan.misses, in_map);
        } else {
            let hits: Vec<Point3<f64>> = scan.hits.positions.iter().map(in_map).collect();
            let misses: Vec<Point3<f64>> = scan.misses.iter().map(in_map).collect();
            let up = t_map_base * Vector3::z();
            let (range_min_m, range_max_m) = (params.range_min_m, params.range_max());
            let of = GroundParams { range_min_m, range_max_m, clearance_m: params.band_max_m };
            let ground = Ground::new(&of, &sensor, (frame.floor_z, &up), &hits);
            Columns::new(&frame, &ground).mark(&mut update, &hits, &misses);
        }
        update
    }
}

impl Frame<'_> {
    fn mark_beams(
        &self,
        update: &mut ScanUpdate,
        hits: &[Point3<f32>],
        misses: &[Point3<f32>],
        in_map: impl Fn(&Point3<f32>) -> Point3<f64>,
    ) {
        let heights = Heights::of_plane(self.params, self.sensor.z - self.floor_z);
        let passed = |_| Mark::Free(heights);
        for p in hits {
            let end = in_map(p).xy();
            let range = (end - self.sensor.xy()).norm();
            if range > self.params.range_max() {
                self.free_towards(update, &end, range, passed);
            } else if range >= self.params.range_min_m {
                self.hit_at(update, &end, heights);
                self.free_before(update, &end, passed);
            }
        }
        for p in misses {
            let end = in_map(p).xy();
            self.free_towards(update, &end, (end - self.sensor.xy()).norm(), passed);
        }
    }
}
