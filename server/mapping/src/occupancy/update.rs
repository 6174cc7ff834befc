//! One keyframe as marks on cells: which it saw free, which it hit, each once.

use super::OccupancyParams;
use super::columns::Columns;
use super::driven::Way;
use super::mark::{Heights, Mark};
use super::marks::{Frame, Marks, ScanUpdate};
use crate::KeyframeView;
use crate::ground::GroundParams;
use percept_geometry::{Cell, GridGeometry};

impl ScanUpdate {
    /// The marks of a keyframe.
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
    ///
    /// **The robot's own way** is free up to its sensor: see [`OccupancyParams::footprint_radius_m`].
    pub fn new(params: &OccupancyParams, geometry: &GridGeometry, view: &KeyframeView<'_>) -> Self {
        let (sensor, scan, way) = (view.sensor(), view.scan, Way::of(params, view));
        let ends = view.hits().iter().chain(view.misses());
        let squares = ends.map(|p| (p - sensor).xy().norm_squared()).filter(|r| r.is_finite());
        let range = squares
            .fold(0.0, f64::max)
            .sqrt()
            .min(params.range_max())
            .max(way.as_ref().map_or(0.0, |w| w.reach_m(&sensor)));
        let half = (range / geometry.resolution_m).ceil() as i32 + 1;
        let min = geometry.cell(&sensor.xy()).and_then(|c| {
            c.x.checked_add(half).and(c.y.checked_add(half))?;
            Some(Cell::new(c.x.checked_sub(half)?, c.y.checked_sub(half)?))
        });
        let Some(min) = min else {
            return Self { min: Cell::new(0, 0), width: 0, planar: true, marks: Marks::Each(vec![]) };
        };
        let width = 2 * half as usize + 1;
        let frame = Frame { params, geometry, sensor, floor_z: view.floor_z() };
        let heights = Heights::of_plane(params, sensor.z - frame.floor_z);
        let marks = if scan.planar {
            Marks::Planar(frame.mark_beams(heights, view.hits(), view.misses()))
        } else {
            Marks::Each(vec![Mark::Unseen; width * width])
        };
        let mut update = Self { min, width, planar: scan.planar, marks };
        if !scan.planar {
            let (range_min_m, range_max_m) = (params.range_min_m, params.range_max());
            let ground = view.ground(&GroundParams { range_min_m, range_max_m, clearance_m: params.band_max_m });
            Columns::new(&frame, &ground).mark(&mut update, view.hits(), view.misses());
        }
        if let Some(way) = way {
            way.mark(&frame, &mut update);
        }
        update
    }
}
