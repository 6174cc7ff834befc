//! Maps as files.

use super::maps::{dense, stamp_of};
use super::{layers, pictures};
use crate::reason;
use crate::{Error, Progress, Result, Service, Zones};
use percept_formats::{GridMap, OctreeLeaf, OctreeMap, draco, geotiff, gltf, las, nav2, octomap, pcd, ply, trajectory};
use percept_geometry::{Aabb3, PointCloud, RgbImage, Stamped, Timestamp, Voxel};
use percept_pipeline::Snapshot;

/// Files that a map can be read as.
#[derive(Debug, Clone, Copy, PartialEq)]
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
    /// Cloud, as Draco packs it.
    CloudDraco {
        /// By how much positions may be off, metres; within [`draco::BOUNDS_M`].
        max_error_m: f64,
    },
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
    /// Surface, as Draco packs it.
    MeshDraco {
        /// By how much positions may be off, metres; within [`draco::BOUNDS_M`].
        max_error_m: f64,
    },
    /// Trajectory, TUM text.
    TrajectoryTum,
    /// Occupancy with trajectory and objects.
    OverviewPng,
    /// Top view of the cloud.
    CloudTopPng,
    /// The cloud from aside and above.
    CloudViewPng,
    /// The surface from aside and above.
    MeshViewPng,
    /// Occupied voxels from aside and above.
    VoxelsViewPng,
    /// Heights of the ground.
    HeightsPng,
    /// Where a robot can drive.
    TraversabilityPng,
    /// All of these layers side by side.
    LayersPng,
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

impl Service {
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
        let (s, zones) = self.snapshot_with_zones(session).await?;
        let (name, limits) = (session.to_owned(), self.limits.clone());
        let work = move || {
            let file = export_telling(&s, (&name, &zones), format, &limits, &progress)?;
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
    export_telling(s, (name, &Zones::default()), format, limits, &Progress::default())
}

fn export_telling(
    s: &Snapshot,
    (name, zones): (&str, &Zones),
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
        F::CloudDraco { max_error_m } => {
            let cloud = cloud()?;
            writing()?;
            ("drc", "application/octet-stream", draco::encode_cloud(&cloud, max_error_m).map_err(Error::internal)?)
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
        F::MeshPly | F::MeshGlb | F::MeshDraco { .. } => {
            let mesh = layers::mesh_of(&s.layers, None, None)?;
            if mesh.is_empty() {
                return Err(map_empty());
            }
            writing()?;
            let (suffix, media_type, bytes) = match format {
                F::MeshGlb => ("mesh.glb", "model/gltf-binary", gltf::encode_mesh(&mesh, "map")),
                F::MeshDraco { max_error_m } => {
                    ("mesh.drc", "application/octet-stream", draco::encode_mesh(&mesh, max_error_m))
                }
                _ => {
                    let bytes = ply::encode_mesh(&mesh, ply::Encoding::BinaryLittleEndian);
                    ("mesh.ply", "application/octet-stream", bytes)
                }
            };
            (suffix, media_type, bytes.map_err(Error::internal)?)
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
            ("overview.png", "image/png", pictures::overview(&grid, &pictures::overlay(s, zones), name)?)
        }
        F::CloudTopPng => {
            let cloud = cloud()?;
            writing()?;
            ("cloud.png", "image/png", pictures::cloud(&cloud, true, name)?)
        }
        F::CloudViewPng => {
            let cloud = cloud()?;
            writing()?;
            ("cloud-view.png", "image/png", pictures::cloud(&cloud, false, name)?)
        }
        F::MeshViewPng => {
            let mesh = layers::mesh_data_of(&s.layers, None, None)?;
            if mesh.triangles.is_empty() {
                return Err(map_empty());
            }
            writing()?;
            ("mesh-view.png", "image/png", pictures::mesh(&mesh, name)?)
        }
        F::VoxelsViewPng => {
            let (blocks, size) = layers::all_voxels(&s.layers)?;
            if blocks.is_empty() {
                return Err(map_empty());
            }
            writing()?;
            ("voxels-view.png", "image/png", pictures::voxels(&blocks, size, name)?)
        }
        F::HeightsPng | F::TraversabilityPng => {
            let (heights, drivable) = layers::all_heights(&s.layers, limits)?.ok_or_else(map_empty)?;
            writing()?;
            if format == F::HeightsPng {
                ("heights.png", "image/png", pictures::heights(&heights, name)?)
            } else {
                ("traversability.png", "image/png", pictures::traversability(&drivable, name)?)
            }
        }
        F::LayersPng => ("layers.png", "image/png", layers_picture(s, (name, zones), limits, progress)?),
    };
    let file_name = format!("{name}.{suffix}");
    Ok(MapFile { map_version: s.map_version, stamp: stamp_of(s), file_name, media_type, bytes })
}

/// Pictures of the layers that the session has, and that hold something, side by side.
fn layers_picture(
    s: &Snapshot,
    (name, zones): (&str, &Zones),
    limits: &crate::Limits,
    progress: &Progress,
) -> Result<Vec<u8>> {
    progress.stage("drawing the layers");
    let mut panels = vec![];
    let mut add = |caption, drawn: Result<Option<RgbImage>>| {
        panels.extend(drawn?.map(|image| (image, caption)));
        progress.check()
    };
    add("Occupancy", pictures::layers::overview(s, zones, name, limits))?;
    add("Heights", pictures::layers::heights(s, name, limits))?;
    add("Traversability", pictures::layers::traversability(s, name, limits))?;
    add("Voxels", pictures::layers::voxels(s, name))?;
    add("Surface", pictures::layers::surface(s, name))?;
    add("Cloud", pictures::layers::cloud(s, name))?;
    if panels.is_empty() {
        return Err(map_empty());
    }
    pictures::side_by_side(&panels)
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
    layers::need_voxels(&s.layers)?;
    let known = voxels.within(&Aabb3 { min: [-1e9; 3].into(), max: [1e9; 3].into() }, MAX_OCTREE_VOXELS);
    let known = known.map_err(|e| layers::too_many_voxels(&e))?;
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
