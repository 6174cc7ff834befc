//! Planes, clusters, shapes, objects: parameters of requests, and answers.

use super::{bytes_of_labels, count, set};
use crate::convert::{geometry, scene, unknown_enum};
use crate::v1;
use nalgebra::{Unit, Vector3};
use percept_geometry::{GeometryError, OrientedBox3};
use percept_perception::cloud::{
    ClusterParams, Clusters, DbscanParams, PlaneKind, PlaneParams, PlanesParams, ShapeFeatures, TypedPlane,
};
use percept_perception::detection::Detection;
use percept_perception::detection::outdoor::OutdoorParams;
use percept_service::Result;
use percept_service::toolbox::{Clustering, Environment};

/// Parameters of plane segmentation.
pub fn planes_params(r: &v1::SegmentPlanesRequest) -> PlanesParams {
    let mut plane = PlaneParams { seed: r.seed, min_points: 100, ..PlaneParams::default() };
    set(&mut plane.distance_m, r.distance_m);
    set(&mut plane.max_iterations, count(r.max_iterations));
    set(&mut plane.min_points, count(r.min_points));
    set(&mut plane.early_stop, r.early_stop);
    PlanesParams { plane, max_planes: count(r.max_planes).unwrap_or(1), ..PlanesParams::default() }
}

/// What is up in the cloud's frame.
///
/// # Errors
/// `OUT_OF_RANGE`: without a direction.
pub fn up(r: &v1::SegmentPlanesRequest) -> Result<Unit<Vector3<f64>>> {
    let Some(up) = &r.up else { return Ok(Vector3::z_axis()) };
    let up = geometry::vector("up", up)?;
    Unit::try_new(up, 1e-9).ok_or_else(|| {
        GeometryError::OutOfRange { field: "up", value: up.norm(), requirement: "a direction: longer than 1e-9" }.into()
    })
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
            set(&mut params.eps_slope, r.eps_slope);
            Ok(Clustering::Euclidean(params))
        }
        Ok(M::Dbscan) => {
            let mut params = DbscanParams::default();
            set(&mut params.eps_m, r.eps_m);
            set(&mut params.min_points, count(r.min_points));
            Ok(Clustering::Dbscan(params))
        }
        Err(_) => Err(unknown_enum("method", r.method)),
    }
}

/// Where objects are looked for.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn environment(r: &v1::DetectObjectsRequest) -> Result<Environment> {
    use v1::Environment as E;
    match E::try_from(r.environment) {
        Ok(E::Unspecified | E::Indoor) => Ok(Environment::Indoor),
        Ok(E::Outdoor) => {
            let mut params = OutdoorParams::default();
            set(&mut params.ground.sensor_height_m, r.sensor_height_m);
            Ok(Environment::Outdoor(params))
        }
        Err(_) => Err(unknown_enum("environment", r.environment)),
    }
}

/// Planes of a cloud of so many points as a message.
pub fn planes_to(planes: &[TypedPlane], num_points: usize) -> v1::SegmentPlanesResponse {
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
        num_points: p.segment.inliers.len() as u32,
        tilt_rad: p.tilt_rad,
    };
    let mut labels = vec![None; num_points];
    for (number, plane) in planes.iter().enumerate() {
        plane.segment.inliers.iter().for_each(|&i| labels[i] = Some(number as u32));
    }
    v1::SegmentPlanesResponse { planes: planes.iter().map(convert).collect(), labels: bytes_of_labels(&labels) }
}

/// Clusters as a message.
pub fn clusters_to(c: &Clusters) -> v1::ClusterPointsResponse {
    v1::ClusterPointsResponse { labels: bytes_of_labels(&c.labels), num_clusters: c.num_clusters as u32 }
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
        variance_m2: Some(geometry::vector_to(&f.variance)),
        hull_volume_m3: f.hull_volume_m3,
        hull_area_m2: f.hull_area_m2,
        eigenvectors: f.eigenvectors.iter().map(geometry::vector_to).collect(),
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

/// A shape and its box as a message.
pub fn shape_to((features, upright_box): &(ShapeFeatures, OrientedBox3)) -> v1::ComputeShapeFeaturesResponse {
    v1::ComputeShapeFeaturesResponse {
        features: Some(features_to(features)),
        upright_box: Some(geometry::box_to(upright_box)),
    }
}
