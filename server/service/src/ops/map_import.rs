//! A map that comes from elsewhere begins a session.

use crate::session::command::Imported;
use crate::toolbox::SessionCloud;
use crate::{Error, ErrorCode, Limits, Progress, Result, Service, Session, check_id, reason};
use nalgebra::{Point3, Vector3};
use percept_formats::OctreeMap;
use percept_geometry::{PointCloud, Pose, SensorKind, SensorSpec, Voxel};
use percept_mapping::given::{GivenOptions, GivenSpace, GivenViews, views_of_grid, views_of_space};
use percept_mapping::{DenseGrid, MappingError};
use percept_pipeline::{PipelineParams, Snapshot};
use std::sync::Arc;

/// A map that comes from elsewhere.
#[derive(Debug, Clone)]
pub enum GivenMap {
    /// Occupancy of the floor.
    Grid(DenseGrid),
    /// Occupancy of space.
    Octree(OctreeMap),
    /// Points, z up.
    Cloud {
        /// In metres.
        cloud: Arc<PointCloud>,
        /// Points of the floor on which the robot stood that saw it, as far as that is known.
        stood: Vec<Point3<f64>>,
    },
}

/// How it is taken in.
#[derive(Debug, Clone, Copy, Default)]
pub struct ImportOptions {
    /// Base to map, where the robot starts; none: it is looked for.
    pub start: Option<Pose>,
    /// Of the sensor above the ground, metres; none: as the sensors that are declared, or [`PLANAR_HEIGHT_M`] and [`SPATIAL_HEIGHT_M`].
    pub sensor_height_m: Option<f64>,
    /// Edge of the voxels by which points hide each other, metres; none: [`VOXEL_M`].
    pub voxel_size_m: Option<f64>,
}

/// What became of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImportedMap {
    /// Views that it was made into.
    pub num_keyframes: usize,
    /// Share of its occupied cells, or points, that they show, 0 to 1.
    pub occupied_share: f64,
    /// Share of its free cells that they show, 0 to 1.
    pub free_share: f64,
    /// Of the map with it.
    pub map_version: u64,
    /// The kind of sensor that is found in it.
    pub found_by: SensorKind,
}

/// Steps of an import, counted from the reading of what was sent, which is the first.
pub(crate) const READING: usize = 0;
const LOOKING: usize = 1;
const ENTERING: usize = 2;
const STORING: usize = 3;
pub(crate) const STEPS: usize = 4;

/// Usual heights of sensors above the ground, metres: of a safety lidar, and of one that looks over furniture.
const PLANAR_HEIGHT_M: f64 = 0.3;
const SPATIAL_HEIGHT_M: f64 = 1.0;
const MAX_HEIGHT_M: f64 = 10.0;
/// Points of maps lie some centimetres apart: what is nearer than this hides what is behind.
const VOXEL_M: f64 = 0.1;
/// Of voxels, metres.
const VOXEL_RANGE_M: (f64, f64) = (0.02, 2.0);
/// Voxels of a map that may be taken in: 12 bytes and a place in a table each.
const MAX_VOXELS: u64 = 20_000_000;
/// How far a view shows, metres: farther away cells of 0.05 m are thinner than the beams are apart.
const RANGE_M: f64 = 30.0;

impl Service {
    /// Begins a session with a map; it is durable when this answers.
    ///
    /// # Errors
    /// `MAP_NOT_EMPTY` if the session has a map; `MAP_UNUSABLE` if it shows no place to look from; `GRID_TOO_LARGE`,
    /// `OUT_OF_RANGE`, `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn import_map(&self, session: &str, given: GivenMap, options: ImportOptions) -> Result<ImportedMap> {
        self.import_map_telling(session, given, options, &Progress::default()).await
    }

    /// What can be said against an import before the map is looked at.
    ///
    /// # Errors
    /// `OUT_OF_RANGE`, `MAP_NOT_EMPTY`, `SESSION_NOT_FOUND`.
    pub(crate) async fn check_import(&self, session: &str, options: &ImportOptions) -> Result<Arc<Snapshot>> {
        check_id("session_id", session)?;
        options.check()?;
        let before = self.snapshot(session).await?;
        // A robot that only localises has been nowhere before there is a map.
        let has_been_nowhere = before.pose.as_ref().is_none_or(|pose| pose.state.is_lost());
        if before.keyframes.is_empty() && has_been_nowhere { Ok(before) } else { Err(not_empty()) }
    }

    /// Where robots stood that mapped these sessions, on the floor, map frame, metres: base's height over it is that of its first
    /// pose, since the floor there is z = 0.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub(crate) async fn stood_in(&self, clouds: &[SessionCloud]) -> Result<Vec<Point3<f64>>> {
        let mut out = vec![];
        for wanted in clouds {
            let snapshot = self.snapshot(&wanted.session).await?;
            let poses = || snapshot.trajectory().map(|(t_map_base, _)| Point3::from(t_map_base.translation.vector));
            let height_m = poses().next().map_or(0.0, |first| first.z);
            let is_within =
                |p: &Point3<f64>| wanted.around.is_none_or(|(center, radius)| (p - center).norm() <= radius);
            out.extend(poses().filter(is_within).map(|p| p - Vector3::z() * height_m));
        }
        Ok(out)
    }

    /// [`import_map`](Self::import_map), saying how far it is. If it is cancelled or fails, the session is as it was.
    ///
    /// # Errors
    /// As [`import_map`](Self::import_map); `OPERATION_CANCELLED`.
    pub(crate) async fn import_map_telling(
        &self,
        session: &str,
        given: GivenMap,
        options: ImportOptions,
        progress: &Progress,
    ) -> Result<ImportedMap> {
        progress.check()?;
        progress.step(LOOKING, STEPS, "looking at the map");
        let before = self.check_import(session, &options).await?;
        let sensors = self.registry.awake(session, |s: Arc<Session>| async move { Ok(s.meta().sensors) }).await?;
        let sensors: Vec<SensorSpec> = sensors.into_iter().map(|d| d.spec).collect();
        let (found_by, limits, start) = (given.found_by(), Arc::clone(&self.limits), options.start);
        let params = before.params.clone();
        let look = move || given.views(&options, &sensors, &params, &limits);
        let GivenViews { views, occupied_share, free_share } =
            self.compute.query(&self.asker(session)?, look).await??;
        progress.check()?;
        progress.step(ENTERING, STEPS, "entering it");
        let num_keyframes = views.len();
        // A session that is woken anew is asked anew.
        let enter = |s: Arc<Session>| {
            let (views, before) = (views.clone(), Arc::clone(&before));
            async move {
                let done: Imported = s.import(views, start, progress).await?.ok_or_else(not_empty)?;
                progress.step(STORING, STEPS, "storing it");
                s.wait_imported(done.ticket, before).await.map(|()| done)
            }
        };
        let Imported { map_version, .. } = self.registry.awake(session, enter).await?;
        Ok(ImportedMap { num_keyframes, occupied_share, free_share, map_version, found_by })
    }
}

fn not_empty() -> Error {
    let message = "the session has a map already; create a session for this one, and import before frames come";
    Error::new(ErrorCode::FailedPrecondition, reason::MAP_NOT_EMPTY, message)
}

impl ImportOptions {
    fn check(&self) -> Result<()> {
        let within = |field: &str, value: Option<f64>, least: f64, most: f64| match value {
            Some(v) if !(v >= least && v <= most) => {
                let message = format!("{field} is {v}; choose {least} to {most}, or leave it out");
                Err(Error::invalid(reason::OUT_OF_RANGE, field, message))
            }
            _ => Ok(()),
        };
        within("sensor_height_m", self.sensor_height_m, 0.0, MAX_HEIGHT_M)?;
        within("voxel_size_m", self.voxel_size_m, VOXEL_RANGE_M.0, VOXEL_RANGE_M.1)
    }

    /// Of the sensor that is to be found in the map, above the ground, metres.
    fn height(&self, kind: SensorKind, sensors: &[SensorSpec]) -> f64 {
        let declared = sensors.iter().find(|s| s.kind == kind).map(|s| s.t_base_sensor.translation.vector.z);
        // What a planar lidar sees speaks for its own height alone: the map's has to be that of the frames to come, the ground's too.
        // One in space that is declared at base's origin hangs on a robot whose base is up there.
        let (least, usual) = match kind {
            SensorKind::Lidar2d => (0.0, PLANAR_HEIGHT_M),
            _ => (f64::MIN_POSITIVE, SPATIAL_HEIGHT_M),
        };
        self.sensor_height_m.or(declared.filter(|z| (least..=MAX_HEIGHT_M).contains(z))).unwrap_or(usual)
    }
}

impl GivenMap {
    /// The same with where the robots stood whose map it is, if it is one of a session.
    pub(crate) fn with_stood(mut self, floor: Vec<Point3<f64>>) -> Self {
        if let Self::Cloud { stood, .. } = &mut self {
            *stood = floor;
        }
        self
    }

    fn found_by(&self) -> SensorKind {
        if matches!(self, Self::Grid(_)) { SensorKind::Lidar2d } else { SensorKind::Lidar3d }
    }

    fn views(
        &self,
        options: &ImportOptions,
        sensors: &[SensorSpec],
        params: &PipelineParams,
        limits: &Limits,
    ) -> Result<GivenViews> {
        let range_max_m = RANGE_M.min(params.map.occupancy.range_max());
        let sensor_height_m = options.height(self.found_by(), sensors);
        let look = GivenOptions { range_max_m, sensor_height_m };
        let seen = match self {
            Self::Grid(grid) => {
                let cells = grid.cells.len();
                if cells > limits.max_planning_cells {
                    let limit = limits.max_planning_cells;
                    let message = format!("the grid has {cells} cells, the limit is {limit}; send a coarser one");
                    return Err(Error::exhausted(reason::GRID_TOO_LARGE, "grid", message));
                }
                views_of_grid(grid, &look)
            }
            Self::Octree(octree) => space_of(octree).and_then(|space| views_of_space(&space, &look)),
            Self::Cloud { cloud, stood } => {
                let voxel_m = options.voxel_size_m.unwrap_or(VOXEL_M);
                let space = GivenSpace::of_points(cloud.as_ref().clone(), voxel_m);
                space.and_then(|s| views_of_space(&s.with_stood(stood.clone()), &look))
            }
        };
        seen.map_err(|e| self.refusal(&e))
    }

    fn refusal(&self, e: &MappingError) -> Error {
        let field = match self {
            Self::Grid(_) => "grid",
            Self::Octree(_) => "octomap",
            Self::Cloud { .. } => "cloud",
        };
        match e {
            MappingError::RegionTooLarge { cells, limit } => {
                let message =
                    format!("the map has {cells} voxels, the limit is {limit}; send a coarser or smaller one");
                Error::exhausted(reason::GRID_TOO_LARGE, field, message)
            }
            MappingError::NothingFree => Error::invalid(reason::MAP_UNUSABLE, field, e.to_string()),
            e => Error::invalid(reason::OUT_OF_RANGE, field, e.to_string()),
        }
    }
}

/// The voxels of an octree's leaves.
fn space_of(octree: &OctreeMap) -> std::result::Result<GivenSpace, MappingError> {
    let cells: u64 =
        octree.leaves().iter().map(|l| u64::from(l.edge_voxels()).saturating_pow(3)).fold(0, u64::saturating_add);
    if cells > MAX_VOXELS {
        return Err(MappingError::RegionTooLarge { cells, limit: MAX_VOXELS });
    }
    let voxels = |is_occupied: bool| {
        octree.leaves().iter().filter(move |l| l.is_occupied() == is_occupied).flat_map(|leaf| {
            let (low, edge) = (leaf.lowest_voxel(), leaf.edge_voxels() as i32);
            let along = move |from: i32| from..from + edge;
            along(low.z)
                .flat_map(move |z| along(low.y).flat_map(move |y| along(low.x).map(move |x| Voxel::new(x, y, z))))
        })
    };
    let occupied: Vec<Voxel> = voxels(true).collect();
    GivenSpace::of_voxels(&occupied, voxels(false), octree.resolution_m())
}
