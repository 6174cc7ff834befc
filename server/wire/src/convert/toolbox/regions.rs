//! Ground, smooth regions, convex parts: parameters of requests, and answers.

use super::{bytes_of_indices, bytes_of_labels};
use crate::convert::geometry;
use crate::v1;
use nalgebra::{Point3, Vector3};
use percept_perception::cloud::Clusters;
use percept_perception::segmentation::{
    ConvexityParams, Ground, GroundParams, Objects, ObjectsParams, RegionGrowingParams, Supervoxel, SupervoxelParams,
    Supervoxels,
};
use percept_service::{Error, Result};

/// How ground is fitted.
pub fn ground_params(r: &v1::SegmentGroundRequest) -> GroundParams {
    let mut params = GroundParams::default();
    lay_over!(params, r: sensor_height_m, min_range_m, max_range_m, distance_m, seed_height_m);
    lay_over!(params, r: num_lowest, min_points, num_fits, max_slope_rad, max_below_m);
    params
}

/// How regions grow.
pub fn region_params(r: &v1::GrowRegionsRequest) -> RegionGrowingParams {
    let mut params = RegionGrowingParams::default();
    lay_over!(params, r: radius_m, max_neighbours, max_angle_rad, min_points);
    params
}

/// How supervoxels are cut, and the viewpoint.
///
/// # Errors
/// A viewpoint that is not finite.
pub fn supervoxel_params(r: &v1::ComputeSupervoxelsRequest) -> Result<(SupervoxelParams, Point3<f64>)> {
    let mut params = SupervoxelParams::default();
    lay_over!(params, r: voxel_size_m, seed_size_m, normal_radius_m, spatial_weight, normal_weight);
    let viewpoint = geometry::vector("viewpoint_m", &r.viewpoint_m.unwrap_or_default())?;
    Ok((params, viewpoint.into()))
}

/// How supervoxels are grouped, and the size of their seeds, metres.
pub fn convexity_params(r: &v1::GroupConvexRequest) -> (ConvexityParams, f64) {
    let mut params = ConvexityParams::default();
    lay_over!(params, r: concavity_tolerance_rad, max_step_m, min_supervoxels);
    (params, r.seed_size_m.unwrap_or(SupervoxelParams::default().seed_size_m))
}

/// Supervoxels without the points that they were cut from.
///
/// # Errors
/// `SIZE_MISMATCH`, `NOT_FINITE`, `INDEX_OUT_OF_RANGE` naming the field.
pub fn supervoxels(r: &v1::GroupConvexRequest) -> Result<Supervoxels> {
    let count = r.centres.len() / 12;
    let wide = |x, y, z| Vector3::new(f64::from(x), f64::from(y), f64::from(z));
    let centers = geometry::triples("centres", &r.centres, count, wide)?;
    let normals = geometry::triples("normals", &r.normals, count, wide)?;
    for (field, values) in [("centres", &centers), ("normals", &normals)] {
        if let Some(i) = values.iter().position(|v| !v.iter().all(|c| c.is_finite())) {
            let words = format!("{field}[{i}] is not finite; leave it out, and its edges");
            return Err(Error::invalid("NOT_FINITE", field, words));
        }
    }
    let supervoxel = |(center, normal): (Vector3<f64>, Vector3<f64>)| Supervoxel {
        center: center.into(),
        normal: normal.try_normalize(1e-9).unwrap_or_default(),
        num_voxels: 0,
    };
    let supervoxels = centers.into_iter().zip(normals).map(supervoxel).collect();
    Ok(Supervoxels { labels: Vec::new(), supervoxels, edges: edges(&r.edges, count)? })
}

/// Pairs of supervoxels.
fn edges(data: &[u8], count: usize) -> Result<Vec<(u32, u32)>> {
    let (rows, rest) = data.as_chunks::<8>();
    if !rest.is_empty() {
        let words = format!("edges ends with {} bytes of a pair; send E x 2 uint32", rest.len());
        return Err(Error::invalid("SIZE_MISMATCH", "edges", words));
    }
    let number = |b: &[u8; 8], i: usize| u32::from_le_bytes([b[i], b[i + 1], b[i + 2], b[i + 3]]);
    let pairs: Vec<(u32, u32)> = rows.iter().map(|b| (number(b, 0), number(b, 4))).collect();
    match pairs.iter().position(|&(a, b)| a.max(b) as usize >= count) {
        None => Ok(pairs),
        Some(i) => {
            let words = format!("edges[{i}] is {:?} and there are {count} centres; name two of them", pairs[i]);
            Err(Error::invalid("INDEX_OUT_OF_RANGE", "edges", words))
        }
    }
}

/// How objects on a support are told apart, and the viewpoint.
///
/// # Errors
/// A viewpoint that is not finite.
pub fn objects_params(r: &v1::SegmentObjectsRequest) -> Result<(ObjectsParams, Point3<f64>)> {
    let mut params = ObjectsParams::default();
    lay_over!(params, r: min_height_m, min_points);
    let (supervoxels, convexity) = (&mut params.supervoxels, &mut params.convexity);
    lay_over!(supervoxels, r: voxel_size_m, seed_size_m);
    lay_over!(convexity, r: concavity_tolerance_rad);
    params.plane.seed = r.seed;
    params.plane.distance_m = r.plane_distance_m.unwrap_or(params.plane.distance_m);
    let viewpoint = geometry::vector("viewpoint_m", &r.viewpoint_m.unwrap_or_default())?;
    Ok((params, viewpoint.into()))
}

/// Ground as a message.
pub fn ground_to(g: &Ground) -> v1::SegmentGroundResponse {
    let indices: Vec<usize> = (0..g.is_ground.len()).filter(|&i| g.is_ground[i]).collect();
    let patches = g.patches.iter().map(|p| v1::GroundPatch {
        plane: Some(geometry::plane_to(&p.plane)),
        centre: Some(geometry::vector_to(&p.center.coords)),
        num_points: p.num_points as u32,
    });
    v1::SegmentGroundResponse { indices: bytes_of_indices(&indices), patches: patches.collect() }
}

/// Regions as a message.
pub fn regions_to(c: &Clusters) -> v1::GrowRegionsResponse {
    v1::GrowRegionsResponse { labels: bytes_of_labels(&c.labels), num_regions: c.num_clusters as u32 }
}

/// Supervoxels as a message.
pub fn supervoxels_to(s: &Supervoxels) -> v1::ComputeSupervoxelsResponse {
    let floats = |triples: Vec<[f64; 3]>| -> Vec<u8> {
        triples.into_iter().flatten().flat_map(|v| (v as f32).to_le_bytes()).collect()
    };
    v1::ComputeSupervoxelsResponse {
        labels: bytes_of_labels(&s.labels),
        centres: floats(s.supervoxels.iter().map(|v| v.center.into()).collect()).into(),
        normals: floats(s.supervoxels.iter().map(|v| v.normal.into()).collect()).into(),
        edges: s.edges.iter().flat_map(|&(a, b)| [a, b]).flat_map(u32::to_le_bytes).collect::<Vec<u8>>().into(),
    }
}

/// Groups of supervoxels as a message.
pub fn groups_to(groups: &[u32]) -> v1::GroupConvexResponse {
    let labels = groups.iter().flat_map(|g| (*g as i32).to_le_bytes()).collect::<Vec<u8>>();
    v1::GroupConvexResponse { labels: labels.into(), num_groups: groups.iter().max().map_or(0, |m| m + 1) }
}

/// Objects on a support as a message.
pub fn objects_to(o: &Objects) -> v1::SegmentObjectsResponse {
    v1::SegmentObjectsResponse {
        labels: bytes_of_labels(&o.clusters.labels),
        num_objects: o.clusters.num_clusters as u32,
        support: o.support.as_ref().map(geometry::plane_to),
    }
}
