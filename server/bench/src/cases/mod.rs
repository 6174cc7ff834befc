//! The operations that can be timed, one file an area.

mod depth;
mod files;
mod filters;
mod global;
mod images;
mod registration;
mod search;
mod segmentation;
mod slam;

use crate::{Args, BenchError};
use serde_json::{Map, Value};

/// One operation on loaded inputs.
pub trait Case {
    /// Points, pixels or frames of one run.
    fn items(&self) -> usize;

    /// One run, its result kept for [`Case::extra`]; a stream tells its number of frames, which the time is divided by.
    ///
    /// # Errors
    /// The operation refuses its input.
    fn run(&mut self) -> Result<Option<usize>, BenchError>;

    /// What came out of the last run, in numbers.
    fn extra(&self) -> Map<String, Value>;
}

/// Opens a case from its arguments: inputs are loaded, nothing is computed ahead.
type Open = fn(&Args) -> Result<Box<dyn Case>, BenchError>;

/// Operations by name.
pub const OPERATIONS: &[(&str, Open)] = &[
    ("load", files::load),
    ("fpfh", global::fpfh),
    ("register_global", global::register),
    ("voxel_downsample", filters::voxels),
    ("register", registration::register),
    ("outliers_statistical", filters::outliers_statistical),
    ("outliers_radius", filters::outliers_radius),
    ("search_build", search::build),
    ("search_knn_all", search::knn_all),
    ("normals", filters::normals),
    ("local_features", filters::features),
    ("plane", segmentation::plane),
    ("planes", segmentation::planes),
    ("clusters_dbscan", segmentation::clusters_dbscan),
    ("features_orb", images::orb),
    ("features_sift", images::sift),
    ("match_features", images::matching),
    ("essential", images::essential),
    ("ground", segmentation::ground),
    ("cloud_features", segmentation::cloud_features),
    ("segment_objects", segmentation::segment_objects),
    ("depth_to_cloud", depth::depth_to_cloud),
    ("depth_median", depth::depth_median),
    ("depth_bilateral", depth::depth_bilateral),
    ("depth_normals", depth::depth_normals),
    ("odometry_lidar3d", slam::lidar3d),
    ("odometry_rgbd", slam::rgbd),
    ("pose_graph", slam::graph),
];

/// The case of an operation.
///
/// # Errors
/// No operation of this name, or its arguments or files are not usable.
pub fn open(operation: &str, args: &Args) -> Result<Box<dyn Case>, BenchError> {
    match OPERATIONS.iter().find(|(name, _)| *name == operation) {
        Some((_, open)) => open(args),
        None => Err(BenchError(format!("operation {operation} is not there"))),
    }
}

/// A case made of a function: inputs stay in the closure, the last result is kept.
struct Timed<R, F, E> {
    items: usize,
    work: F,
    extra: E,
    last: Option<R>,
}

impl<R, F: FnMut() -> Result<R, BenchError>, E: Fn(&R) -> Value> Case for Timed<R, F, E> {
    fn items(&self) -> usize {
        self.items
    }

    fn run(&mut self) -> Result<Option<usize>, BenchError> {
        // The result before is freed outside of nobody's time but ours, as the others do it, too.
        self.last = None;
        self.last = Some((self.work)()?);
        Ok(None)
    }

    fn extra(&self) -> Map<String, Value> {
        match self.last.as_ref().map(&self.extra) {
            Some(Value::Object(map)) => map,
            _ => Map::new(),
        }
    }
}

/// A case from what is timed and what is told of its result (a JSON object).
fn timed<R: 'static>(
    items: usize,
    work: impl FnMut() -> Result<R, BenchError> + 'static,
    extra: impl Fn(&R) -> Value + 'static,
) -> Box<dyn Case> {
    Box::new(Timed { items, work, extra, last: None })
}
