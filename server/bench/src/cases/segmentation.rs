//! Planes, clusters, ground, objects.

use super::files::read_cloud;
use super::{Case, timed};
use crate::{Args, BenchError};
use nalgebra::{Point3, Vector3};
use percept_perception::cloud::{
    Clusters, DbscanParams, PlaneParams, PlanesParams, ShapeFeatures, dbscan, minimal_box, segment_plane,
    segment_planes,
};
use percept_perception::segmentation::{GroundParams, ObjectsParams, segment_ground};
use serde_json::{Value, json};
use std::path::PathBuf;

fn plane_params(args: &Args) -> Result<PlaneParams, BenchError> {
    let params = PlaneParams::default();
    Ok(PlaneParams {
        distance_m: args.or("distance_m", params.distance_m)?,
        max_iterations: args.or("iterations", params.max_iterations)?,
        early_stop: args.or("early_stop", params.early_stop)?,
        seed: args.or("seed", params.seed)?,
        ..params
    })
}

/// `plane file= distance_m= iterations= early_stop=`: the largest plane, refined, with its points.
pub(super) fn plane(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let params = plane_params(args)?;
    let items = points.len();
    let work = move || segment_plane(&points, &params).map_err(BenchError::new);
    Ok(timed(items, work, |found| {
        let plane = found.as_ref().map(|f| [f.plane.normal.x, f.plane.normal.y, f.plane.normal.z, f.plane.offset]);
        json!({"inliers": found.as_ref().map_or(0, |f| f.inliers.len()), "plane": plane})
    }))
}

/// `planes file= distance_m= iterations= min_share=`: planes in turn until none holds the share of the cloud.
pub(super) fn planes(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let min_points = (args.or("min_share", 0.05)? * points.len() as f64).ceil() as usize;
    let plane = PlaneParams { min_points: min_points.max(3), ..plane_params(args)? };
    let params = PlanesParams { plane, max_planes: args.or("max_planes", 8)?, ..PlanesParams::default() };
    let items = points.len();
    let work = move || segment_planes(&points, &Vector3::z_axis(), &params).map_err(BenchError::new);
    Ok(timed(items, work, |found| {
        let sizes: Vec<usize> = found.iter().map(|p| p.segment.inliers.len()).collect();
        json!({"planes": sizes})
    }))
}

/// `clusters_dbscan file= eps_m= min_points=`: density-based clusters.
pub(super) fn clusters_dbscan(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let params = DbscanParams { eps_m: args.or("eps_m", 0.05)?, min_points: args.or("min_points", 10)? };
    let items = points.len();
    Ok(timed(items, move || dbscan(&points, &params).map_err(BenchError::new), sizes))
}

fn sizes(clusters: &Clusters) -> Value {
    let large = clusters.indices().iter().filter(|c| c.len() >= 100).count();
    json!({"clusters": clusters.num_clusters, "clusters_ge100": large})
}

/// `ground file= sensor_height_m=`: the ground of a lidar scan; `labels=` names a file for a byte a point.
pub(super) fn ground(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let defaults = GroundParams::default();
    let params = GroundParams { sensor_height_m: args.or("sensor_height_m", defaults.sensor_height_m)?, ..defaults };
    let labels: Option<PathBuf> = args.optional("labels")?;
    let items = points.len();
    Ok(timed(
        items,
        move || segment_ground(&points, &params).map_err(BenchError::new),
        move |ground| {
            if let Some(path) = &labels {
                let bytes: Vec<u8> = ground.is_ground.iter().map(|&g| u8::from(g)).collect();
                if let Err(e) = std::fs::write(path, bytes) {
                    return json!({"labels": e.to_string()});
                }
            }
            json!({"ground_points": ground.is_ground.iter().filter(|g| **g).count()})
        },
    ))
}

/// `segment_objects file=`: objects on the largest plane of one view from the origin; `labels=` as above, two bytes.
pub(super) fn segment_objects(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let labels: Option<PathBuf> = args.optional("labels")?;
    let params = ObjectsParams::default();
    let items = points.len();
    let work = move || {
        percept_perception::segmentation::segment_objects(&points, &Point3::origin(), &params).map_err(BenchError::new)
    };
    Ok(timed(items, work, move |objects| {
        if let Some(path) = &labels {
            let labels = &objects.clusters.labels;
            let bytes: Vec<u8> = labels.iter().flat_map(|l| l.map_or(-1, |l| l as i16).to_le_bytes()).collect();
            if let Err(e) = std::fs::write(path, bytes) {
                return json!({"labels": e.to_string()});
            }
        }
        json!({"objects": objects.clusters.num_clusters})
    }))
}

/// `cloud_features file=`: moments, boxes and hull of a whole cloud.
pub(super) fn cloud_features(args: &Args) -> Result<Box<dyn Case>, BenchError> {
    let points = read_cloud(&args.required::<PathBuf>("file")?)?.positions;
    let items = points.len();
    let work = move || {
        let features = ShapeFeatures::of(&points).ok_or_else(|| BenchError("no finite point".to_owned()))?;
        let least = minimal_box(&points).ok_or_else(|| BenchError("no finite point".to_owned()))?;
        Ok((features, least))
    };
    Ok(timed(items, work, |(features, least)| {
        json!({
            "hull_volume_m3": features.hull_volume_m3, "hull_area_m2": features.hull_area_m2,
            "upright_volume_m3": features.volume_m3, "minimal_volume_m3": least.volume(),
        })
    }))
}
