//! Questions about space: what is at points, in boxes, along rays, in voxels, and where the map changed.

use super::maps::{cells_of, stamp_of};
use crate::reason;
use crate::{Error, ErrorCode, Limits, Result, Service};
use nalgebra::{Point2, Point3, Unit, Vector3};
use percept_geometry::{Aabb3, OrientedBox3, Timestamp, TriangleMesh, Voxel};
use percept_mapping::height::{DenseHeights, Storey, Traversability};
use percept_mapping::voxels::{MAX_RAY_VOXELS, VoxelReader, VoxelState};
use percept_mapping::{Composed, DenseGrid, Layer, MapLayers, MappingError, MeshData, MeshOptions, VoxelBlock};
use percept_pipeline::Snapshot;

/// Points or rays of one question.
const MAX_QUERIES: usize = 100_000;
/// Boxes of one question, and voxels that all of them may hold.
const MAX_BOXES: usize = 10_000;
const MAX_BOX_VOXELS: f64 = 16e6;
/// Voxels that are drawn.
const MAX_PICTURE_VOXELS: usize = 64 << 20;

/// A layer of the map that can be asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapLayer {
    /// The 2D grid.
    Occupancy,
    /// Occupancy in three dimensions.
    Voxels,
    /// The fused cloud.
    Cloud,
    /// Heights of the ground.
    Height,
    /// The surface.
    Surface,
}

/// An answer of one state of the map.
#[derive(Debug, Clone)]
pub struct OfMap<T> {
    /// Version of the map.
    pub map_version: u64,
    /// Stamp of the newest frame in it.
    pub stamp: Timestamp,
    /// What was asked.
    pub answer: T,
}

/// What is at a point.
#[derive(Debug, Clone, Copy)]
pub struct PointAnswer {
    /// What it is.
    pub state: VoxelState,
    /// To the surface of the nearest occupied cell or voxel, metres; negative inside.
    pub distance_m: f64,
    /// Which way, and how fast, that grows.
    pub gradient: Vector3<f64>,
}

/// What is at some points, as a layer says.
#[derive(Debug, Clone)]
pub struct PointAnswers {
    /// Which was asked.
    pub layer: MapLayer,
    /// Nothing is told to be farther, metres.
    pub max_distance_m: f64,
    /// One a point.
    pub points: Vec<PointAnswer>,
}

/// A ray, map frame.
#[derive(Debug, Clone, Copy)]
pub struct SpaceRay {
    /// Where it starts, metres.
    pub origin: Point3<f64>,
    /// Which way; any length but zero.
    pub direction: Vector3<f64>,
    /// How far it is followed, metres.
    pub max_range_m: f64,
}

/// Where a ray ended.
#[derive(Debug, Clone, Copy)]
pub struct RayAnswer {
    /// What ended it; free if nothing did.
    pub state: VoxelState,
    /// From the origin, metres.
    pub distance_m: f64,
    /// Map frame.
    pub point: Point3<f64>,
}

/// What is in a box.
#[derive(Debug, Clone, Copy, Default)]
pub struct BoxAnswer {
    /// Voxels that are occupied.
    pub num_occupied: u64,
    /// That are free.
    pub num_free: u64,
    /// That nobody saw.
    pub num_unknown: u64,
}

/// Voxels of a part of the map.
#[derive(Debug, Clone)]
pub struct VoxelAnswer {
    /// Edge of one, metres.
    pub voxel_size_m: f64,
    /// Ascending.
    pub blocks: Vec<VoxelBlock>,
}

/// Where a layer changed: squares of the map, by their corners.
#[derive(Debug, Clone)]
pub struct ChangeAnswer {
    /// Which was asked.
    pub layer: MapLayer,
    /// Smallest and largest x and y, metres.
    pub regions: Vec<(Point2<f64>, Point2<f64>)>,
}

/// Heights of a region, and where a robot can drive in it; none if nothing was mapped.
pub type HeightAnswer = Option<(DenseHeights, Traversability)>;

impl Service {
    async fn of_map<T: Send + 'static>(
        &self,
        session: &str,
        ask: impl FnOnce(&Snapshot) -> Result<T> + Send + 'static,
    ) -> Result<OfMap<T>> {
        let s = self.snapshot(session).await?;
        let work = move || Ok(OfMap { map_version: s.map_version, stamp: stamp_of(&s), answer: ask(&s)? });
        self.compute.query(&self.asker(session)?, work).await?
    }

    /// The voxels within a box of the map, or all; of those columns only that changed after a version.
    ///
    /// # Errors
    /// `LAYER_OFF`, `GRID_TOO_LARGE`, `SESSION_NOT_FOUND`.
    pub async fn voxels(
        &self,
        session: &str,
        region: Option<Aabb3>,
        occupied_only: bool,
        since_version: u64,
    ) -> Result<OfMap<VoxelAnswer>> {
        let limit = self.limits.max_grid_cells;
        let ask = move |s: &Snapshot| {
            need_voxels(&s.layers)?;
            let found = s.layers.voxels.blocks(region.as_ref(), occupied_only, since_version, limit);
            let blocks = found.map_err(|e| too_many_voxels(&e))?;
            Ok(VoxelAnswer { voxel_size_m: s.layers.voxels.params().voxel_size_m, blocks })
        };
        self.of_map(session, ask).await
    }

    /// What is at points of the map. No layer: voxels where the session has them, the grid otherwise.
    ///
    /// # Errors
    /// `TOO_MANY_QUERIES`, `OUT_OF_RANGE` for points where nothing has a number, `LAYER_OFF`, `SESSION_NOT_FOUND`.
    pub async fn query_points(
        &self,
        session: &str,
        points: Vec<Point3<f64>>,
        layer: Option<MapLayer>,
    ) -> Result<OfMap<PointAnswers>> {
        at_most("points", points.len(), MAX_QUERIES)?;
        self.of_map(session, move |s| match layer {
            Some(MapLayer::Cloud | MapLayer::Height | MapLayer::Surface) => {
                let message = "layer knows no free space; ask OCCUPANCY or VOXELS";
                Err(Error::invalid(reason::ENUM_UNKNOWN, "layer", message))
            }
            None if !s.layers.voxels.params().enabled => in_grid(&s.layers, &points),
            Some(MapLayer::Occupancy) => in_grid(&s.layers, &points),
            None | Some(MapLayer::Voxels) => in_voxels(&s.layers, &points),
        })
        .await
    }

    /// What rays hit first among the voxels.
    ///
    /// # Errors
    /// `TOO_MANY_QUERIES`, `OUT_OF_RANGE` naming the ray, `LAYER_OFF`, `SESSION_NOT_FOUND`.
    pub async fn cast_rays(
        &self,
        session: &str,
        rays: Vec<SpaceRay>,
        unknown_ends: bool,
    ) -> Result<OfMap<Vec<RayAnswer>>> {
        at_most("rays", rays.len(), MAX_QUERIES)?;
        self.of_map(session, move |s| {
            need_voxels(&s.layers)?;
            let mut reader = VoxelReader::new(&s.layers.voxels);
            let cast = |(i, ray): (usize, &SpaceRay)| {
                cast(&mut reader, ray, unknown_ends).map_err(|e| e.within(&format!("rays[{i}]")))
            };
            rays.iter().enumerate().map(cast).collect()
        })
        .await
    }

    /// What is in boxes of the map.
    ///
    /// # Errors
    /// `TOO_MANY_QUERIES`, `GRID_TOO_LARGE`, `OUT_OF_RANGE`, `LAYER_OFF`, `SESSION_NOT_FOUND`.
    pub async fn check_boxes(&self, session: &str, boxes: Vec<OrientedBox3>) -> Result<OfMap<Vec<BoxAnswer>>> {
        at_most("boxes", boxes.len(), MAX_BOXES)?;
        self.of_map(session, move |s| {
            need_voxels(&s.layers)?;
            let size = s.layers.voxels.params().voxel_size_m;
            let voxels: f64 = boxes.iter().map(|b| (around(b).size() / size).add_scalar(2.0).product()).sum();
            if voxels.is_nan() || voxels > MAX_BOX_VOXELS {
                let message = format!(
                    "the boxes hold some {voxels:.3e} voxels, the limit is {MAX_BOX_VOXELS:.0e}; ask for fewer or smaller ones"
                );
                return Err(Error::exhausted(reason::GRID_TOO_LARGE, "boxes", message));
            }
            let mut reader = VoxelReader::new(&s.layers.voxels);
            let check = |(i, b): (usize, &OrientedBox3)| {
                check_box(&mut reader, b, size).ok_or_else(|| too_far(&format!("boxes[{i}]")))
            };
            boxes.iter().enumerate().map(check).collect()
        })
        .await
    }

    /// How high the ground is in a region of the map (its corners), or everywhere, and where a robot can drive.
    ///
    /// # Errors
    /// `LAYER_OFF`, `GRID_TOO_LARGE`, `REGION_EMPTY`, `REGION_TOO_FAR`, `SESSION_NOT_FOUND`.
    pub async fn heights(
        &self,
        session: &str,
        region: Option<(Point2<f64>, Point2<f64>)>,
        storey: Storey,
    ) -> Result<OfMap<HeightAnswer>> {
        let limit = self.limits.max_grid_cells;
        self.of_map(session, move |s| {
            let heights = &s.layers.height;
            need(heights.params().enabled, "heights", "height")?;
            let Some((min, max)) = cells_of(heights.geometry(), heights.bounds(), region)? else { return Ok(None) };
            let found = heights.region(min, max, storey, limit);
            let found = found.and_then(|h| Ok((h, heights.traversability(min, max, storey, limit)?)));
            found.map(Some).map_err(|e| too_many_voxels(&e))
        })
        .await
    }

    /// The surface within a box of the map, or all, as triangles.
    ///
    /// # Errors
    /// `LAYER_OFF`, `MESH_TOO_LARGE`, `SESSION_NOT_FOUND`.
    pub async fn mesh(
        &self,
        session: &str,
        region: Option<Aabb3>,
        max_triangles: Option<usize>,
    ) -> Result<OfMap<TriangleMesh>> {
        self.of_map(session, move |s| mesh_of(&s.layers, region, max_triangles)).await
    }

    /// Where a layer changed after a version; all of it after a version that is newer than the map's.
    ///
    /// # Errors
    /// `LAYER_OFF`, `SESSION_NOT_FOUND`.
    pub async fn map_changes(
        &self,
        session: &str,
        layer: Option<MapLayer>,
        since_version: u64,
    ) -> Result<OfMap<ChangeAnswer>> {
        self.of_map(session, move |s| {
            let layers = &s.layers;
            // A version that this map never had is another map's: all of it is new to who has that.
            let since_version = if since_version > s.map_version { 0 } else { since_version };
            let has_voxels = layers.voxels.params().enabled;
            let layer = layer.unwrap_or(if has_voxels { MapLayer::Voxels } else { MapLayer::Occupancy });
            let regions = match layer {
                MapLayer::Occupancy => changed(&layers.occupancy, since_version),
                MapLayer::Cloud => changed(&layers.cloud, since_version),
                MapLayer::Height => {
                    need(layers.height.params().enabled, "heights", "height")?;
                    changed(&layers.height, since_version)
                }
                MapLayer::Surface => {
                    need(layers.surface.params().enabled, "surface", "surface")?;
                    changed(&layers.surface, since_version)
                }
                MapLayer::Voxels => {
                    need_voxels(layers)?;
                    changed(&layers.voxels, since_version)
                }
            };
            Ok(ChangeAnswer { layer, regions })
        })
        .await
    }
}

fn changed<L: Layer>(layer: &Composed<L>, since_version: u64) -> Vec<(Point2<f64>, Point2<f64>)> {
    let edge = L::tile_edge_m(layer.params());
    let corner = |x: i32, y: i32| Point2::new(f64::from(x) * edge, f64::from(y) * edge);
    layer.changed_since(since_version).map(|(x, y)| (corner(x, y), corner(x + 1, y + 1))).collect()
}

pub(super) fn need_voxels(layers: &MapLayers) -> Result<()> {
    need(layers.voxels.params().enabled, "voxels", "voxels")
}

fn need(is_there: bool, what: &str, params: &str) -> Result<()> {
    if is_there {
        return Ok(());
    }
    let message = format!("the session keeps no {what}; create one with params.map.{params}.enabled");
    Err(Error { field: "layer".to_owned(), ..Error::new(ErrorCode::FailedPrecondition, reason::LAYER_OFF, message) })
}

/// The surface of a map as triangles.
pub(super) fn mesh_of(layers: &MapLayers, region: Option<Aabb3>, max_triangles: Option<usize>) -> Result<TriangleMesh> {
    let mesh = mesh_data_of(layers, region, max_triangles)?;
    TriangleMesh::new(mesh.positions, mesh.normals, mesh.colors, mesh.triangles).map_err(Error::internal)
}

/// All that the voxels know, and their edge, metres.
pub(super) fn all_voxels(layers: &MapLayers) -> Result<(Vec<VoxelBlock>, f64)> {
    let voxels = &layers.voxels;
    need(voxels.params().enabled, "voxels", "voxels")?;
    let blocks = voxels.blocks(None, true, 0, MAX_PICTURE_VOXELS).map_err(|e| too_many_voxels(&e))?;
    Ok((blocks, voxels.params().voxel_size_m))
}

/// Heights of all the ground, and where a robot can drive; none if nothing was mapped.
pub(super) fn all_heights(layers: &MapLayers, limits: &Limits) -> Result<Option<(DenseHeights, Traversability)>> {
    let heights = &layers.height;
    need(heights.params().enabled, "heights", "height")?;
    let Some((min, max)) = heights.bounds() else { return Ok(None) };
    let limit = limits.max_grid_cells;
    let found = heights.region(min, max, Storey::Lowest, limit);
    let found = found.and_then(|h| Ok((h, heights.traversability(min, max, Storey::Lowest, limit)?)));
    found.map(Some).map_err(|e| too_many_voxels(&e))
}

/// Where a robot can drive on a storey, as planners take it; without a cell while nothing was mapped.
///
/// # Errors
/// `LAYER_OFF`, `GRID_TOO_LARGE`.
pub(super) fn drivable(layers: &MapLayers, storey: Storey, max_cells: usize) -> Result<DenseGrid> {
    let heights = &layers.height;
    need(heights.params().enabled, "heights", "height")?;
    let Some((min, max)) = heights.bounds() else {
        return Ok(DenseGrid { geometry: heights.geometry(), width: 0, height: 0, cells: vec![] });
    };
    let found = heights.traversability(min, max, storey, max_cells);
    found.map(|found| found.to_grid()).map_err(|e| too_many_voxels(&e))
}

pub(super) fn mesh_data_of(
    layers: &MapLayers,
    region: Option<Aabb3>,
    max_triangles: Option<usize>,
) -> Result<MeshData> {
    need(layers.surface.params().enabled, "surface", "surface")?;
    let most = MeshOptions::default().max_triangles;
    let max_triangles = max_triangles.map_or(most, |n| n.min(most));
    let mesh = layers.surface.mesh(&MeshOptions { region, max_triangles, ..MeshOptions::default() });
    mesh.map_err(|e| match e {
        MappingError::MeshTooLarge { limit } => {
            let message = format!("the mesh has more than {limit} triangles; ask for a region");
            Error::exhausted(reason::MESH_TOO_LARGE, "region", message)
        }
        e => Error::internal(e),
    })
}

pub(super) fn at_most(field: &str, num: usize, limit: usize) -> Result<()> {
    if num <= limit {
        return Ok(());
    }
    let message = format!("{num} {field} are more than the {limit} of one question; ask in several");
    Err(Error::exhausted(reason::TOO_MANY_QUERIES, field, message))
}

fn too_far(field: &str) -> Error {
    let message = "it lies farther out than the map has numbers for; bring it nearer to the map's origin";
    Error::invalid(reason::REGION_TOO_FAR, field, message)
}

pub(super) fn too_many_voxels(e: &MappingError) -> Error {
    let MappingError::RegionTooLarge { cells, limit } = e else { return Error::internal(e) };
    let message =
        format!("the answer would have {cells} voxels and more, the limit is {limit}; ask for a smaller region");
    Error::exhausted(reason::GRID_TOO_LARGE, "region", message)
}

fn in_voxels(layers: &MapLayers, points: &[Point3<f64>]) -> Result<PointAnswers> {
    need_voxels(layers)?;
    let (mut reader, mut distances) = (VoxelReader::new(&layers.voxels), layers.voxel_distances());
    let mut answer = |(i, p): (usize, &Point3<f64>)| {
        let found = distances.at(p).map_err(|_| too_far(&format!("points[{i}]")))?;
        Ok(PointAnswer { state: reader.state_at(p), distance_m: found.distance_m, gradient: found.gradient })
    };
    let answers = points.iter().enumerate().map(&mut answer).collect::<Result<_>>()?;
    let max_distance_m = layers.voxel_distances().max_distance_m();
    Ok(PointAnswers { layer: MapLayer::Voxels, max_distance_m, points: answers })
}

fn in_grid(layers: &MapLayers, points: &[Point3<f64>]) -> Result<PointAnswers> {
    let mut distances = layers.grid_distances();
    let mut answer = |(i, p): (usize, &Point3<f64>)| {
        let found = distances.at(&p.xy()).map_err(|_| too_far(&format!("points[{i}]")))?;
        let state = match layers.occupancy.log_odds_at(&p.xy()) {
            None => VoxelState::Unknown,
            Some(v) if v > 0.0 => VoxelState::Occupied,
            Some(_) => VoxelState::Free,
        };
        let gradient = Vector3::new(found.gradient.x, found.gradient.y, 0.0);
        Ok(PointAnswer { state, distance_m: found.distance_m, gradient })
    };
    let answers = points.iter().enumerate().map(&mut answer).collect::<Result<_>>()?;
    let max_distance_m = layers.grid_distances().max_distance_m();
    Ok(PointAnswers { layer: MapLayer::Occupancy, max_distance_m, points: answers })
}

fn cast(reader: &mut VoxelReader<'_>, ray: &SpaceRay, unknown_ends: bool) -> Result<RayAnswer> {
    let Some(direction) = Unit::try_new(ray.direction, 1e-12) else {
        let message = "direction has no length; give one that is not zero";
        return Err(Error::invalid(reason::OUT_OF_RANGE, "direction", message));
    };
    if !(ray.max_range_m >= 0.0 && ray.max_range_m <= MAX_RAY_VOXELS * reader.voxel_size_m()) {
        let most = MAX_RAY_VOXELS * reader.voxel_size_m();
        let message = format!("max_range_m is {}; it must be 0 to {most}", ray.max_range_m);
        return Err(Error::invalid(reason::OUT_OF_RANGE, "max_range_m", message));
    }
    let hit = reader.cast(&ray.origin, &direction, ray.max_range_m, unknown_ends).ok_or_else(|| too_far("origin"))?;
    let point = ray.origin + direction.as_ref() * hit.distance_m;
    Ok(RayAnswer { state: hit.state, distance_m: hit.distance_m, point })
}

fn around(b: &OrientedBox3) -> Aabb3 {
    let mut out = Aabb3::empty();
    b.corners().iter().for_each(|c| out.grow(c));
    out
}

/// None if it lies where no voxel has a number.
fn check_box(reader: &mut VoxelReader<'_>, b: &OrientedBox3, size: f64) -> Option<BoxAnswer> {
    let within = around(b);
    let (low, high) = (Voxel::containing(&within.min, size)?, Voxel::containing(&within.max, size)?);
    let mut out = BoxAnswer::default();
    let mut count = |reader: &mut VoxelReader<'_>, voxel: Voxel| match reader.state(voxel) {
        VoxelState::Occupied => out.num_occupied += 1,
        VoxelState::Free => out.num_free += 1,
        VoxelState::Unknown => out.num_unknown += 1,
    };
    let mut any = false;
    for z in low.z..=high.z {
        for y in low.y..=high.y {
            for voxel in (low.x..=high.x).map(|x| Voxel::new(x, y, z)).filter(|v| b.contains(&v.center(size))) {
                any = true;
                count(reader, voxel);
            }
        }
    }
    if !any {
        count(reader, Voxel::containing(&b.center(), size)?);
    }
    Some(out)
}

impl BoxAnswer {
    /// What it comes to.
    pub fn state(&self) -> VoxelState {
        match self {
            Self { num_occupied: 1.., .. } => VoxelState::Occupied,
            Self { num_unknown: 1.., .. } => VoxelState::Unknown,
            _ => VoxelState::Free,
        }
    }
}
