//! Operations on one cloud.

use super::cloud_error;
use crate::{Error, Result};
use nalgebra::{Point3, Unit, Vector3};
use percept_geometry::{CameraIntrinsics, DepthImage, OrientedBox3, PointCloud, RgbImage};
use percept_perception::cloud::{
    self, ClusterParams, Clusters, DbscanParams, NormalParams, PlanesParams, RadiusOutlierParams, ShapeFeatures,
    SpanningTreeParams, StatisticalOutlierParams, TypedPlane,
};
use percept_perception::depth::{self, UnprojectParams};
use percept_perception::detection::outdoor::{OutdoorDetector, OutdoorParams};
use percept_perception::detection::{Detection, DetectionParams, Detector};

/// What connects points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Clustering {
    /// Every pair nearer than the distance.
    Euclidean(ClusterParams),
    /// Only points with enough neighbours.
    Dbscan(DbscanParams),
}

/// Points whose mean distance to their neighbours is no outlier, and their indices.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter.
pub fn remove_statistical_outliers(
    cloud: &PointCloud,
    params: &StatisticalOutlierParams,
) -> Result<(PointCloud, Vec<usize>)> {
    let kept = cloud::statistical_outliers(&cloud.positions, params)?;
    Ok((cloud.select(&kept), kept))
}

/// Points with enough neighbours nearby, and their indices.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter.
pub fn remove_radius_outliers(cloud: &PointCloud, params: &RadiusOutlierParams) -> Result<(PointCloud, Vec<usize>)> {
    let kept = cloud::radius_outliers(&cloud.positions, params)?;
    Ok((cloud.select(&kept), kept))
}

/// One centroid a voxel.
///
/// # Errors
/// `OUT_OF_RANGE`, `VOXEL_TOO_SMALL`.
pub fn downsample_voxels(cloud: &PointCloud, voxel_size_m: f64) -> Result<PointCloud> {
    cloud::voxel_downsample(cloud, voxel_size_m).map_err(cloud_error)
}

/// To which side normals look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NormalOrientation {
    /// Towards this point, metres.
    Viewpoint(Point3<f64>),
    /// To one side of the surface, from neighbour to neighbour.
    SpanningTree(SpanningTreeParams),
}

/// The cloud with normals.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter.
pub fn estimate_normals(
    cloud: &PointCloud,
    params: &NormalParams,
    orientation: &NormalOrientation,
) -> Result<PointCloud> {
    let normals = match orientation {
        NormalOrientation::Viewpoint(viewpoint) => cloud::estimate_normals(&cloud.positions, params, Some(viewpoint))?,
        NormalOrientation::SpanningTree(tree) => {
            tree.validate()?;
            let mut normals = cloud::estimate_normals(&cloud.positions, params, None)?;
            cloud::orient_by_spanning_tree(&cloud.positions, &mut normals, tree)?;
            normals
        }
    };
    Ok(PointCloud { normals: Some(normals), ..cloud.clone() })
}

/// Planes in turn, largest first; `up` is against gravity in the cloud's frame.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter.
pub fn segment_planes(cloud: &PointCloud, up: &Unit<Vector3<f64>>, params: &PlanesParams) -> Result<Vec<TypedPlane>> {
    Ok(cloud::segment_planes(&cloud.positions, up, params)?)
}

/// Connected groups of points.
///
/// # Errors
/// `OUT_OF_RANGE` naming the parameter.
pub fn cluster_points(cloud: &PointCloud, method: &Clustering) -> Result<Clusters> {
    Ok(match method {
        Clustering::Euclidean(params) => cloud::cluster(&cloud.positions, params)?,
        Clustering::Dbscan(params) => cloud::dbscan(&cloud.positions, params)?,
    })
}

/// Shape of a set of points, and the smallest upright box around it.
///
/// # Errors
/// `CLOUD_EMPTY` without a finite point.
pub fn shape_features(points: &[Point3<f32>]) -> Result<(ShapeFeatures, OrientedBox3)> {
    ShapeFeatures::of(points).zip(cloud::upright_box(points)).ok_or_else(|| {
        let n = points.len();
        let words = format!("cloud has {n} points and none is finite; send at least one");
        Error::invalid("CLOUD_EMPTY", "cloud", words)
    })
}

/// What surrounds objects that are looked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Environment {
    /// Rooms, in a frame whose floor is near z = 0.
    Indoor,
    /// Streets, in one scan of a lidar in its own frame.
    Outdoor(OutdoorParams),
}

/// Objects in a cloud whose z is up; `params` are those for rooms.
///
/// # Errors
/// Clouds whose channels do not fit; `OUT_OF_RANGE` naming a parameter for streets.
pub fn detect_objects(
    cloud: &PointCloud,
    params: &DetectionParams,
    environment: &Environment,
) -> Result<Vec<Detection>> {
    match environment {
        Environment::Indoor => Detector::new(*params).map_err(Error::internal)?.detect(cloud),
        Environment::Outdoor(params) => OutdoorDetector::new(*params).and_then(|detector| detector.detect(cloud)),
    }
    .map_err(cloud_error)
}

/// A depth image as a cloud in the optical frame.
///
/// # Errors
/// `OUT_OF_RANGE`, `SIZE_MISMATCH` naming the field.
pub fn unproject_depth(
    depth: &DepthImage,
    color: Option<&RgbImage>,
    intrinsics: &CameraIntrinsics,
    params: &UnprojectParams,
) -> Result<PointCloud> {
    Ok(depth::unproject(depth, color, intrinsics, params)?)
}
