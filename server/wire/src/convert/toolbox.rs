//! Requests to the toolbox, laid over the defaults; answers back.

use super::{geometry, required, scene, sensors};
use crate::v1;
use nalgebra::Point3;
use percept_geometry::{CameraIntrinsics, DepthImage, PointCloud, RgbImage};
use percept_perception::cloud::{
    ClusterParams, Clusters, DbscanParams, NormalParams, PlaneKind, PlaneParams, PlanesParams, ShapeFeatures,
    StatisticalOutlierParams, TypedPlane,
};
use percept_perception::depth::UnprojectParams;
use percept_perception::detection::Detection;
use percept_perception::registration::{IcpParams, IcpResult};
use percept_service::toolbox::{Clustering, RegistrationMethod};
use percept_service::{Limits, Result};

/// The cloud of a request, checked.
///
/// # Errors
/// Naming the channel.
pub fn cloud(field: &'static str, c: Option<&v1::PointCloud>, limits: &Limits) -> Result<PointCloud> {
    geometry::cloud(required(field, c)?, limits).map_err(|e| e.within(field))
}

fn set<T>(slot: &mut T, sent: Option<T>) {
    if let Some(value) = sent {
        *slot = value;
    }
}

fn count(sent: Option<u32>) -> Option<usize> {
    sent.map(|n| n as usize)
}

/// Parameters of the outlier filter.
pub fn outlier_params(r: &v1::RemoveStatisticalOutliersRequest) -> StatisticalOutlierParams {
    let mut params = StatisticalOutlierParams::default();
    set(&mut params.num_neighbors, count(r.num_neighbors));
    set(&mut params.std_ratio, r.std_ratio);
    params
}

/// Parameters of normals, and the viewpoint.
///
/// # Errors
/// A viewpoint that is not finite.
pub fn normal_params(r: &v1::EstimateNormalsRequest) -> Result<(NormalParams, Point3<f64>)> {
    let mut params = NormalParams::default();
    set(&mut params.radius_m, r.radius_m);
    set(&mut params.max_neighbors, count(r.max_neighbors));
    let viewpoint = geometry::vector("viewpoint_m", &r.viewpoint_m.unwrap_or_default())?;
    Ok((params, viewpoint.into()))
}

/// Parameters of plane segmentation.
pub fn planes_params(r: &v1::SegmentPlanesRequest) -> PlanesParams {
    let mut plane = PlaneParams { seed: r.seed, min_points: 100, ..PlaneParams::default() };
    set(&mut plane.distance_m, r.distance_m);
    set(&mut plane.max_iterations, count(r.max_iterations));
    set(&mut plane.min_points, count(r.min_points));
    PlanesParams { plane, max_planes: count(r.max_planes).unwrap_or(1), ..PlanesParams::default() }
}

/// How points are clustered.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn clustering(r: &v1::ClusterPointsRequest) -> Result<Clustering> {
    use v1::ClusterMethod as M;
    match M::try_from(r.method) {
        Ok(M::Unspecified | M::Euclidean) => {
            let mut params = ClusterParams::default();
            set(&mut params.eps_m, r.eps_m);
            set(&mut params.min_points, count(r.min_points));
            Ok(Clustering::Euclidean(params))
        }
        Ok(M::Dbscan) => {
            let mut params = DbscanParams::default();
            set(&mut params.eps_m, r.eps_m);
            set(&mut params.min_points, count(r.min_points));
            Ok(Clustering::Dbscan(params))
        }
        Err(_) => Err(super::unknown_enum("method", r.method)),
    }
}

/// Method and parameters of a registration.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn registration(r: &v1::RegisterCloudsRequest) -> Result<(RegistrationMethod, IcpParams)> {
    use v1::RegistrationMethod as M;
    let method = match M::try_from(r.method) {
        Ok(M::Unspecified | M::PointToPlane) => RegistrationMethod::PointToPlane,
        Ok(M::PointToPoint) => RegistrationMethod::PointToPoint,
        Err(_) => return Err(super::unknown_enum("method", r.method)),
    };
    let mut params = IcpParams::default();
    set(&mut params.max_distance_m, r.max_distance_m);
    set(&mut params.max_iterations, count(r.max_iterations));
    Ok((method, params))
}

/// Depth, colour, intrinsics and parameters of an unprojection.
///
/// # Errors
/// Images or intrinsics that lie.
pub fn unprojection(
    r: &v1::UnprojectDepthRequest,
    limits: &Limits,
) -> Result<(DepthImage, Option<RgbImage>, CameraIntrinsics, UnprojectParams)> {
    let depth = sensors::depth(required("depth", r.depth.as_ref())?, limits).map_err(|e| e.within("depth"))?;
    let color = r.color.as_ref().map(|c| sensors::color(c, limits)).transpose().map_err(|e| e.within("color"))?;
    let intrinsics = sensors::intrinsics(required("intrinsics", r.intrinsics.as_ref())?)?;
    let mut params = UnprojectParams::default();
    set(&mut params.stride_px, count(r.stride));
    set(&mut params.min_depth_m, r.min_depth_m);
    set(&mut params.max_depth_m, r.max_depth_m);
    Ok((depth, color, intrinsics, params))
}

/// Planes as a message.
pub fn planes_to(planes: &[TypedPlane]) -> Vec<v1::PlaneSegment> {
    let kind = |kind| match kind {
        PlaneKind::Floor => v1::PlaneKind::Floor,
        PlaneKind::Wall => v1::PlaneKind::Wall,
        PlaneKind::Ceiling => v1::PlaneKind::Ceiling,
        PlaneKind::Table => v1::PlaneKind::Table,
        PlaneKind::Other => v1::PlaneKind::Other,
    };
    let convert = |p: &TypedPlane| v1::PlaneSegment {
        plane: Some(geometry::plane_to(&p.segment.plane)),
        kind: kind(p.kind).into(),
        indices: p.segment.inliers.iter().map(|&i| i as u32).collect(),
    };
    planes.iter().map(convert).collect()
}

/// Clusters as a message.
pub fn clusters_to(c: &Clusters) -> v1::ClusterPointsResponse {
    let label = |l: &Option<u32>| l.map_or(-1, |l| l as i32);
    v1::ClusterPointsResponse { labels: c.labels.iter().map(label).collect(), num_clusters: c.num_clusters as u32 }
}

/// Shape features as a message.
pub fn features_to(f: &ShapeFeatures) -> v1::ShapeFeatures {
    let [x, y, z] = f.eigenvalues;
    v1::ShapeFeatures {
        num_points: f.num_points as u32,
        centroid: Some(geometry::vector_to(&f.centroid.coords)),
        extent_m: Some(geometry::vector_to(&f.extent)),
        volume_m3: f.volume_m3,
        eigenvalues_m2: Some(v1::Vector3 { x, y, z }),
        linearity: f.linearity,
        planarity: f.planarity,
        sphericity: f.sphericity,
    }
}

/// Detections as a message.
pub fn detections_to(found: &[Detection]) -> v1::DetectObjectsResponse {
    let convert = |d: &Detection| v1::Detection {
        object_class: scene::class_to(d.class).into(),
        confidence: d.confidence,
        r#box: Some(geometry::box_to(&d.bbox)),
        features: Some(features_to(&d.features)),
    };
    v1::DetectObjectsResponse { detections: found.iter().map(convert).collect() }
}

/// A registration as a message.
pub fn registration_to(r: &IcpResult) -> v1::RegisterCloudsResponse {
    v1::RegisterCloudsResponse {
        t_target_source: Some(geometry::pose_to(&r.t_target_source)),
        fitness: r.inlier_ratio,
        rmse_m: r.inlier_rmse_m,
        covariance: Some(geometry::covariance_to(&r.covariance)),
        iterations: r.iterations as u32,
        converged: r.converged,
        degenerate_axes: r.degenerate_axes.to_vec(),
    }
}
