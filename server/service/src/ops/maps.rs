//! Read maps: grids, clouds, files.

use super::pictures;
use super::sessions::{Page, page_by_number};
use crate::reason;
use crate::session::command::{Moved, Vetoed};
use crate::{Error, Progress, Result, Service, Session, check_id};
use nalgebra::{Point2, Point3};
use percept_formats::{GridMap, OctreeLeaf, OctreeMap, geotiff, gltf, las, nav2, octomap, pcd, ply, trajectory};
use percept_geometry::{Aabb3, Cell, GridGeometry, PointCloud, Stamped, Timestamp, Voxel};
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

/// Files that a map can be read as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapFormat {
    /// Occupancy as a picture.
    OccupancyPng,
    /// nav2's image.
    Nav2Pgm,
    /// nav2's description of it.
    Nav2Yaml,
    /// Cloud, binary little-endian PLY.
    CloudPly,
    /// Cloud, binary PCD.
    CloudPcd,
    /// Cloud, LAS.
    CloudLas,
    /// Cloud, LAZ.
    CloudLaz,
    /// Cloud, binary glTF.
    CloudGlb,
    /// Voxels, free or occupied, as OctoMap has them.
    VoxelsBt,
    /// Voxels with log-odds, as OctoMap has them.
    VoxelsOt,
    /// Occupancy, GeoTIFF.
    OccupancyTiff,
    /// Where the picture of the occupancy lies.
    OccupancyPgw,
    /// Surface, binary little-endian PLY.
    MeshPly,
    /// Surface, binary glTF.
    MeshGlb,
    /// Trajectory, TUM text.
    TrajectoryTum,
    /// Occupancy with trajectory and objects.
    OverviewPng,
    /// Top view of the cloud.
    CloudTopPng,
}

/// A file.
#[derive(Debug, Clone)]
pub struct MapFile {
    /// Version of the map.
    pub map_version: u64,
    /// Stamp of the newest frame in it.
    pub stamp: Timestamp,
    /// Suggested name.
    pub file_name: String,
    /// IANA media type.
    pub media_type: &'static str,
    /// The content.
    pub bytes: Vec<u8>,
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

    /// A part of the occupancy grid.
    ///
    /// # Errors
    /// As [`dense`]; `SESSION_NOT_FOUND`.
    pub async fn occupancy_grid(
        &self,
        session: &str,
        region: Option<(Point2<f64>, Point2<f64>)>,
        resolution_m: Option<f64>,
    ) -> Result<GridAnswer> {
        let s = self.snapshot(session).await?;
        let (map_version, stamp, limits) = (s.map_version, stamp_of(&s), Arc::clone(&self.limits));
        let copy = move || dense(&s.layers.occupancy, region, resolution_m, &limits);
        Ok(GridAnswer { map_version, stamp, grid: self.compute.query(&self.asker(session)?, copy).await?? })
    }

    /// The fused cloud, or the part of it around a point (m, map frame; radius m).
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn cloud(&self, session: &str, around: Option<(Point3<f64>, f64)>) -> Result<CloudAnswer> {
        let s = self.snapshot(session).await?;
        let (map_version, stamp) = (s.map_version, stamp_of(&s));
        let extract = move || match around {
            Some((center, radius)) => s.layers.cloud.points_within(&center, radius),
            None => s.layers.cloud.to_cloud(),
        };
        Ok(CloudAnswer { map_version, stamp, cloud: self.compute.query(&self.asker(session)?, extract).await? })
    }

    /// The map as a file.
    ///
    /// # Errors
    /// `MAP_EMPTY` if nothing was mapped, `GRID_TOO_LARGE`, `SESSION_NOT_FOUND`.
    pub async fn export_map(&self, session: &str, format: MapFormat) -> Result<MapFile> {
        self.export_map_telling(session, format, Progress::default(), Ok).await
    }

    /// The same, counting what is written, and made into an answer in the same turn.
    ///
    /// # Errors
    /// As [`export_map`](Self::export_map); `OPERATION_CANCELLED`.
    pub(crate) async fn export_map_telling<T: Send + 'static>(
        &self,
        session: &str,
        format: MapFormat,
        progress: Progress,
        answer: impl FnOnce(MapFile) -> Result<T> + Send + 'static,
    ) -> Result<T> {
        let s = self.snapshot(session).await?;
        let (name, limits) = (session.to_owned(), self.limits.clone());
        let work = move || {
            let file = export_telling(&s, &name, format, &limits, &progress)?;
            progress.stage("making the answer");
            answer(file)
        };
        self.compute.query(&self.asker(session)?, work).await?
    }
}

/// A snapshot as a file.
///
/// # Errors
/// `MAP_EMPTY`, `GRID_TOO_LARGE`.
pub fn export(s: &Snapshot, name: &str, format: MapFormat, limits: &crate::Limits) -> Result<MapFile> {
    export_telling(s, name, format, limits, &Progress::default())
}

fn export_telling(
    s: &Snapshot,
    name: &str,
    format: MapFormat,
    limits: &crate::Limits,
    progress: &Progress,
) -> Result<MapFile> {
    use MapFormat as F;
    progress.check()?;
    progress.stage("reading the map");
    let grid = || {
        let grid = dense(&s.layers.occupancy, None, None, limits)?;
        if grid.cells.is_empty() { Err(map_empty()) } else { Ok(grid) }
    };
    let cloud = || {
        let cloud = s.layers.cloud.to_cloud();
        if cloud.is_empty() { Err(map_empty()) } else { Ok(cloud) }
    };
    let writing = || {
        progress.stage("writing the file");
        progress.check()
    };
    let (suffix, media_type, bytes) = match format {
        F::OccupancyPng => {
            let grid = grid()?;
            writing()?;
            ("png", "image/png", pictures::occupancy(&grid)?)
        }
        F::Nav2Pgm => {
            let grid = decided(grid()?, s.params.planning.occupied_probability);
            writing()?;
            let bytes = progress.written(Some(grid.cells.len()), |out| nav2::write_pgm(out, &grid))?;
            ("pgm", "image/x-portable-graymap", bytes)
        }
        F::Nav2Yaml => {
            let geometry = grid()?.geometry;
            let bytes = progress.written(None, |out| nav2::write_yaml(out, &geometry, "map.pgm"))?;
            ("yaml", "application/yaml", bytes)
        }
        F::CloudPly => {
            let cloud = cloud()?;
            writing()?;
            let (size, order) = (cloud.len() * bytes_of_point(&cloud, 3), ply::Encoding::BinaryLittleEndian);
            ("ply", "application/octet-stream", progress.written(Some(size), |out| ply::write(out, &cloud, order))?)
        }
        F::CloudPcd => {
            let cloud = cloud()?;
            writing()?;
            let size = cloud.len() * bytes_of_point(&cloud, 4);
            ("pcd", "application/octet-stream", progress.written(Some(size), |out| pcd::write(out, &cloud))?)
        }
        F::CloudLas | F::CloudLaz => {
            let cloud = cloud()?;
            writing()?;
            let packed = format == F::CloudLaz;
            let bytes = las::encode(&cloud, [0.0; 3], packed).map_err(Error::internal)?;
            (if packed { "laz" } else { "las" }, "application/vnd.las", bytes)
        }
        F::CloudGlb => {
            let cloud = cloud()?;
            writing()?;
            ("glb", "model/gltf-binary", gltf::encode_cloud(&cloud, "map").map_err(Error::internal)?)
        }
        F::VoxelsBt | F::VoxelsOt => {
            let (octree, is_binary) = (octree(s)?, format == F::VoxelsBt);
            writing()?;
            let encoding = if is_binary { octomap::Encoding::Binary } else { octomap::Encoding::Full };
            let bytes = octomap::encode(&octree, encoding);
            (if is_binary { "bt" } else { "ot" }, "application/octet-stream", bytes)
        }
        F::OccupancyTiff => {
            let grid = grid()?;
            writing()?;
            ("tif", "image/tiff", geotiff::encode(&grid, "map").map_err(Error::internal)?)
        }
        F::OccupancyPgw => {
            let grid = grid()?;
            ("pgw", "text/plain", geotiff::world_file(&grid.geometry, grid.height).into_bytes())
        }
        F::MeshPly | F::MeshGlb => {
            let mesh = super::layers::mesh_of(&s.layers, None, None)?;
            if mesh.is_empty() {
                return Err(map_empty());
            }
            writing()?;
            if format == F::MeshGlb {
                ("mesh.glb", "model/gltf-binary", gltf::encode_mesh(&mesh, "map").map_err(Error::internal)?)
            } else {
                let bytes = ply::encode_mesh(&mesh, ply::Encoding::BinaryLittleEndian).map_err(Error::internal)?;
                ("mesh.ply", "application/octet-stream", bytes)
            }
        }
        F::TrajectoryTum => {
            writing()?;
            let mut rows = s.trajectory_in_one_unit().map(|(value, e)| (Stamped { stamp: e.stamp, value }, e.tracked));
            let tum = progress.written(None, |out| {
                rows.try_for_each(|(pose, is_tracked)| trajectory::write_tum_row(out, &pose, is_tracked))
            })?;
            ("tum", "text/plain", tum)
        }
        F::OverviewPng => {
            let grid = grid()?;
            writing()?;
            ("overview.png", "image/png", pictures::overview(&grid, &pictures::Overlay::of(s))?)
        }
        F::CloudTopPng => {
            let cloud = cloud()?;
            writing()?;
            ("cloud.png", "image/png", pictures::cloud_top(&cloud)?)
        }
    };
    let file_name = format!("{name}.{suffix}");
    Ok(MapFile { map_version: s.map_version, stamp: stamp_of(s), file_name, media_type, bytes })
}

/// What paths are planned in: cells below the planner's threshold are free, the others occupied. nav2's files know these two words,
/// and would call a cell that was seen free once unknown.
fn decided(mut grid: GridMap, occupied_probability: f64) -> GridMap {
    let limit = 100.0 * occupied_probability;
    grid.cells.iter_mut().filter(|c| **c >= 0).for_each(|c| *c = if f64::from(*c) >= limit { 100 } else { 0 });
    grid
}

/// Voxels of an octree: what one file may hold.
const MAX_OCTREE_VOXELS: usize = 16 << 20;

/// The voxels of the map as OctoMap has them.
fn octree(s: &Snapshot) -> Result<OctreeMap> {
    let voxels = &s.layers.voxels;
    super::layers::need_voxels(&s.layers)?;
    let known = voxels.within(&Aabb3 { min: [-1e9; 3].into(), max: [1e9; 3].into() }, MAX_OCTREE_VOXELS);
    let known = known.map_err(|e| super::layers::too_many_voxels(&e))?;
    if known.is_empty() {
        return Err(map_empty());
    }
    // What is as likely free as occupied is free here, and occupied there.
    let leaf = |(v, log_odds): &(Voxel, f32)| {
        OctreeLeaf::of_voxel(*v, if *log_odds == 0.0 { -f32::EPSILON } else { *log_odds })
    };
    let leaves: Option<Vec<OctreeLeaf>> = known.iter().map(leaf).collect();
    let leaves = leaves.ok_or_else(|| {
        let message = "the map reaches beyond the 32768 voxels around its origin that OctoMap's keys number; export a coarser one";
        Error::exhausted(reason::GRID_TOO_LARGE, "format", message)
    })?;
    OctreeMap::new(voxels.params().voxel_size_m, leaves).map_err(Error::internal)
}

/// What a point takes in a binary file whose colours take so many bytes.
fn bytes_of_point(cloud: &PointCloud, of_color: usize) -> usize {
    let channels = [
        (cloud.colors.is_some(), of_color),
        (cloud.intensities.is_some(), 4),
        (cloud.normals.is_some(), 12),
        (cloud.time_offsets_s.is_some(), 4),
    ];
    12 + channels.iter().map(|(there, bytes)| usize::from(*there) * bytes).sum::<usize>()
}

fn map_empty() -> Error {
    Error::new(crate::ErrorCode::FailedPrecondition, reason::MAP_EMPTY, "the map is empty; send frames first")
}
