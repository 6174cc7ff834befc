//! Read maps: sizes, grids, clouds, loops.

use super::sessions::{Page, page_by_number};
use crate::reason;
use crate::session::command::{Moved, Vetoed};
use crate::{CloudDetail, Error, Progress, Result, Service, Session, check_id};
use nalgebra::{Point2, Point3};
use percept_formats::GridMap;
use percept_geometry::{Cell, GridGeometry, PointCloud, Timestamp};
use percept_mapping::{Occupancy, SubmapId};
use percept_pipeline::{Loop, LoopId, SessionMemory, Snapshot};
use std::sync::Arc;

/// A part of the occupancy grid, dense.
#[derive(Debug, Clone)]
pub struct GridAnswer {
    /// Version of the map.
    pub map_version: u64,
    /// Stamp of the newest frame in it.
    pub stamp: Timestamp,
    /// Where it lies, and what is in it: -1 unknown, 0 to 100.
    pub grid: GridMap,
}

/// A part of the fused cloud.
#[derive(Debug, Clone)]
pub struct CloudAnswer {
    /// Version of the map.
    pub map_version: u64,
    /// Stamp of the newest frame in it.
    pub stamp: Timestamp,
    /// Map frame.
    pub cloud: PointCloud,
    /// Edge of the voxels that its points are means of, metres.
    pub voxel_size_m: f64,
}

/// Sizes of a map.
#[derive(Debug, Clone)]
pub struct MapSummary {
    /// Version of the map.
    pub map_version: u64,
    /// Stamp of the newest frame in it.
    pub stamp: Timestamp,
    /// Whole grid: geometry, columns, rows; none while nothing was mapped.
    pub occupancy: Option<(GridGeometry, usize, usize)>,
    /// Points of the fused cloud.
    pub num_points: usize,
    /// Edge of its voxels, metres.
    pub voxel_size_m: f64,
    /// Keyframes in it.
    pub num_keyframes: usize,
    /// What it takes in memory.
    pub memory: SessionMemory,
    /// Submaps that could not be read when they were needed.
    pub missing_submaps: Vec<SubmapId>,
}

pub(super) fn stamp_of(snapshot: &Snapshot) -> Timestamp {
    snapshot.pose.as_ref().map(|p| p.stamp).unwrap_or_default()
}

/// Lower-left and upper-right cell of all that was mapped, or of the part of it that lies in a region.
pub(super) fn cells_of(
    geometry: GridGeometry,
    bounds: Option<(Cell, Cell)>,
    region: Option<(Point2<f64>, Point2<f64>)>,
) -> Result<Option<(Cell, Cell)>> {
    let Some(bounds) = bounds else { return Ok(None) };
    let Some((min, max)) = region else { return Ok(Some(bounds)) };
    if !(min.x < max.x && min.y < max.y) {
        let message =
            format!("region from ({}, {}) to ({}, {}) is empty; min must be below max", min.x, min.y, max.x, max.y);
        return Err(Error::invalid(reason::REGION_EMPTY, "region", message));
    }
    let far = || {
        Error::invalid(reason::REGION_TOO_FAR, "region", "region lies beyond what cells can number; bring it nearer")
    };
    let (a, b) = (geometry.cell(&min).ok_or_else(far)?, geometry.cell(&max).ok_or_else(far)?);
    Ok(Some((a, b)))
}

/// How many of the map's cells make one of the answer's.
fn shrink_factor(
    own_m: f64,
    asked_m: Option<f64>,
    limits: &crate::Limits,
    region: Option<(Point2<f64>, Point2<f64>)>,
) -> Result<i32> {
    let Some(asked) = asked_m else { return Ok(1) };
    if !(asked.is_finite() && asked > 0.0) {
        return Err(Error::invalid(
            reason::OUT_OF_RANGE,
            "resolution_m",
            format!("resolution_m is {asked}; it must be positive"),
        ));
    }
    if let Some((min, max)) = region {
        let cells = ((max.x - min.x) / asked).ceil() * ((max.y - min.y) / asked).ceil();
        if cells > limits.max_grid_cells as f64 {
            return Err(too_large(cells, limits));
        }
    }
    let factor = asked / own_m;
    let rounded = factor.round();
    if !(1.0..=1e4).contains(&rounded) || (factor - rounded).abs() > 1e-6 * factor {
        let message = format!("resolution_m is {asked}; the map's own is {own_m}, ask for that or a multiple of it");
        return Err(Error::invalid(reason::RESOLUTION_NOT_A_MULTIPLE, "resolution_m", message));
    }
    Ok(rounded as i32)
}

fn too_large(cells: f64, limits: &crate::Limits) -> Error {
    let limit = limits.max_grid_cells;
    Error::exhausted(
        reason::GRID_TOO_LARGE,
        "region",
        format!(
            "the answer would have {cells:.3e} cells, the limit is {limit}; ask for a smaller region or a coarser resolution"
        ),
    )
}

/// The cells of a part of the map, dense; empty if nothing was mapped.
///
/// # Errors
/// `GRID_TOO_LARGE`, `REGION_EMPTY`, `RESOLUTION_NOT_A_MULTIPLE`.
pub fn dense(
    grid: &impl Occupancy,
    region: Option<(Point2<f64>, Point2<f64>)>,
    resolution_m: Option<f64>,
    limits: &crate::Limits,
) -> Result<GridMap> {
    let own = grid.geometry();
    let factor = shrink_factor(own.resolution_m, resolution_m, limits, region)?;
    let resolution = own.resolution_m * f64::from(factor);
    let Some((a, b)) = cells_of(own, grid.bounds(), region)? else {
        return Ok(GridMap { geometry: GridGeometry::new(resolution, own.origin), width: 0, height: 0, cells: vec![] });
    };
    let (ax, ay) = (a.x.div_euclid(factor), a.y.div_euclid(factor));
    let width = i64::from(b.x.div_euclid(factor)) - i64::from(ax) + 1;
    let height = i64::from(b.y.div_euclid(factor)) - i64::from(ay) + 1;
    let cells = width as f64 * height as f64;
    if cells > limits.max_grid_cells as f64 {
        return Err(too_large(cells, limits));
    }
    let (width, height) = (width as usize, height as usize);
    let (lo, hi) = (Cell::new(ax * factor, ay * factor), b);
    let part = grid.region(lo, hi, usize::MAX).map_err(Error::internal)?;
    let mut out = vec![-1i8; width * height];
    for (i, &percent) in part.cells.iter().enumerate() {
        let (x, y) = ((i % part.width) / factor as usize, (i / part.width) / factor as usize);
        let slot = &mut out[y * width + x];
        *slot = (*slot).max(percent);
    }
    let geometry = GridGeometry::new(resolution, own.corner(lo));
    Ok(GridMap { geometry, width, height, cells: out })
}

impl Service {
    /// Loops by number, those not believed included, and the version of the map that they belong to.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `PAGE_TOKEN_INVALID`.
    pub async fn list_loops(&self, session: &str, page_size: u32, page_token: &str) -> Result<(Page<Loop>, u64)> {
        let snapshot = self.snapshot(session).await?;
        Ok((page_by_number(&snapshot.loops, |l| l.id.0, page_size, page_token)?, snapshot.map_version))
    }

    /// Makes the small corrections that wait for more; they are durable when this answers.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn optimise_map(&self, session: &str) -> Result<Moved> {
        self.optimise_map_telling(session, &Progress::default()).await
    }

    /// The same, saying what is being done. What has begun is finished: a map is never left between two states.
    ///
    /// # Errors
    /// As [`optimise_map`](Self::optimise_map); `OPERATION_CANCELLED`.
    pub(crate) async fn optimise_map_telling(&self, session: &str, progress: &Progress) -> Result<Moved> {
        let settle = |session: Arc<Session>| async move {
            progress.check()?;
            progress.stage("optimising");
            let done = session.settle().await?;
            progress.stage("storing");
            session.wait_durable(done.ticket).await.map(|()| done)
        };
        check_id("session_id", session)?;
        progress.stage("waking the session");
        self.registry.awake(session, settle).await
    }

    /// Takes a loop out of the map, or undoes that; the map follows at once, and it is durable when this answers.
    ///
    /// # Errors
    /// `LOOP_NOT_FOUND`, `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn set_loop_veto(&self, session: &str, id: LoopId, vetoed: bool) -> Result<Vetoed> {
        let veto = |session: Arc<Session>| async move {
            let done = session.veto(id, vetoed).await?.ok_or_else(|| {
                let message = format!("loop_id {} does not exist in this session; list the loops", id.0);
                Error::not_found(reason::LOOP_NOT_FOUND, "loop_id", message)
            })?;
            session.wait_durable(done.moved.ticket).await.map(|()| done)
        };
        check_id("session_id", session)?;
        self.registry.awake(session, veto).await
    }

    /// Sizes and version of a session's map.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn map_summary(&self, session: &str) -> Result<MapSummary> {
        let s = self.snapshot(session).await?;
        // Sizes are known once the map is composed, which may take a while after a correction.
        let measure = move || {
            let grid = &s.layers.occupancy;
            let occupancy = grid.bounds().map(|(a, b)| {
                let geometry = GridGeometry::new(grid.geometry().resolution_m, grid.geometry().corner(a));
                (geometry, (b.x - a.x + 1) as usize, (b.y - a.y + 1) as usize)
            });
            MapSummary {
                map_version: s.map_version,
                stamp: stamp_of(&s),
                occupancy,
                num_points: s.layers.cloud.len(),
                voxel_size_m: s.params.map.cloud.voxel_size_m,
                num_keyframes: s.living_keyframes().count(),
                memory: s.memory,
                missing_submaps: s.layers.missing(),
            }
        };
        self.compute.query(&self.asker(session)?, measure).await
    }

    /// A part of the occupancy grid; `live`: with what the newest frames see laid over it.
    ///
    /// # Errors
    /// As [`dense`]; `SESSION_NOT_FOUND`.
    pub async fn occupancy_grid(
        &self,
        session: &str,
        region: Option<(Point2<f64>, Point2<f64>)>,
        resolution_m: Option<f64>,
        live: bool,
    ) -> Result<GridAnswer> {
        let s = self.snapshot(session).await?;
        let (map_version, stamp, limits) = (s.map_version, stamp_of(&s), Arc::clone(&self.limits));
        let copy = move || {
            let grid = if live { &s.grid_now() } else { &s.layers.occupancy };
            dense(grid, region, resolution_m, &limits)
        };
        Ok(GridAnswer { map_version, stamp, grid: self.compute.query(&self.asker(session)?, copy).await?? })
    }

    /// The fused cloud, or the part of it around a point (m, map frame; radius m), so finely.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `OUT_OF_RANGE`.
    pub async fn cloud(
        &self,
        session: &str,
        around: Option<(Point3<f64>, f64)>,
        detail: CloudDetail,
    ) -> Result<CloudAnswer> {
        let s = self.snapshot(session).await?;
        detail.check()?;
        let (map_version, stamp, kept_m) = (s.map_version, stamp_of(&s), s.params.map.cloud.voxel_size_m);
        let extract = move || {
            let cloud = match around {
                Some((center, radius)) => s.layers.cloud.points_within(&center, radius),
                None => s.layers.cloud.to_cloud(),
            };
            detail.of(cloud, kept_m)
        };
        let (cloud, voxel_size_m) = self.compute.query(&self.asker(session)?, extract).await??;
        Ok(CloudAnswer { map_version, stamp, cloud, voxel_size_m })
    }
}
