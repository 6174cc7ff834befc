//! Grids, clouds, files of maps, cut into chunks.

use super::{draco, geometry, required};
use crate::v1;
use bytes::Bytes;
use nalgebra::{Point2, Point3};
use percept_geometry::{GridGeometry, Timestamp};
use percept_pipeline::{Loop, LoopId, LoopState};
use percept_service::reason;
use percept_service::{CloudAnswer, Error, GridAnswer, MapFile, MapFormat, MapSummary, Result, Vetoed};

/// Payload of a chunk, bytes: well under gRPC's default limit of 4 MiB.
pub(super) const CHUNK_BYTES: usize = 1 << 20;

/// The session whose live map a request is about.
///
/// # Errors
/// `FIELD_MISSING`.
pub fn session_id(source: Option<&v1::MapSource>) -> Result<&str> {
    let source = required("source", source)?;
    match required("source.session_id", source.source.as_ref())? {
        v1::map_source::Source::SessionId(id) => Ok(id),
    }
}

/// A loop as a message.
pub fn loop_to(l: &Loop) -> v1::Loop {
    let state = match l.state {
        LoopState::Pending => v1::LoopState::Pending,
        LoopState::Active => v1::LoopState::Active,
        LoopState::Rejected => v1::LoopState::Rejected,
        LoopState::Vetoed => v1::LoopState::Vetoed,
    };
    v1::Loop {
        loop_id: l.id.0,
        from_keyframe_id: l.closure.from.0,
        to_keyframe_id: l.closure.to.0,
        t_from_to: Some(geometry::pose_to(&l.closure.t_from_to)),
        inlier_ratio: l.closure.inlier_ratio,
        state: state.into(),
    }
}

/// The loop that a veto is about.
pub fn loop_id(r: &v1::SetLoopVetoRequest) -> LoopId {
    LoopId(r.loop_id)
}

/// What a veto did, as a message.
pub fn vetoed_to(v: &Vetoed) -> v1::SetLoopVetoResponse {
    v1::SetLoopVetoResponse {
        r#loop: Some(loop_to(&v.changed)),
        num_keyframes_moved: v.moved.num_keyframes as u64,
        map_version: v.moved.map_version,
    }
}

/// A region: its lower-left and upper-right corner.
///
/// # Errors
/// Missing or non-finite corners.
pub fn region(r: Option<&v1::Region2>) -> Result<Option<(Point2<f64>, Point2<f64>)>> {
    let Some(r) = r else { return Ok(None) };
    let min = geometry::point2("region.min", &required("region.min", r.min)?)?;
    let max = geometry::point2("region.max", &required("region.max", r.max)?)?;
    Ok(Some((min, max)))
}

/// The ball that a cloud is asked for.
///
/// # Errors
/// A center without a positive radius, or a radius without a center.
pub fn around(center: Option<&v1::Vector3>, radius_m: Option<f64>) -> Result<Option<(Point3<f64>, f64)>> {
    if center.is_none() && radius_m.is_none() {
        return Ok(None);
    }
    let center = required("centre", center)?;
    let radius = required("radius_m", radius_m)?;
    if !(radius.is_finite() && radius > 0.0) {
        return Err(Error::invalid(
            reason::OUT_OF_RANGE,
            "radius_m",
            format!("radius_m is {radius}; it must be positive"),
        ));
    }
    Ok(Some((geometry::vector("centre", center)?.into(), radius)))
}

/// The file that is asked for.
///
/// # Errors
/// `ENUM_UNKNOWN`; `OUT_OF_RANGE` for a bound out of range, and for one that the format has no use for.
pub fn format(r: &v1::ExportMapRequest) -> Result<MapFormat> {
    use v1::MapFormat as F;
    let format = F::try_from(r.format);
    if let (Some(_), false) = (r.max_error_m, matches!(format, Ok(F::CloudDraco | F::MeshDraco))) {
        let message = "max_error_m belongs to CLOUD_DRACO and MESH_DRACO; leave it out, or ask for one of these";
        return Err(Error::invalid(reason::OUT_OF_RANGE, "max_error_m", message));
    }
    let bound = || Result::Ok(draco::bound("max_error_m", r.max_error_m)?.unwrap_or(draco::USUAL_M));
    Ok(match format {
        Ok(F::CloudDraco) => MapFormat::CloudDraco { max_error_m: bound()? },
        Ok(F::MeshDraco) => MapFormat::MeshDraco { max_error_m: bound()? },
        Ok(F::OccupancyPng) => MapFormat::OccupancyPng,
        Ok(F::Nav2Pgm) => MapFormat::Nav2Pgm,
        Ok(F::Nav2Yaml) => MapFormat::Nav2Yaml,
        Ok(F::CloudPly) => MapFormat::CloudPly,
        Ok(F::CloudPcd) => MapFormat::CloudPcd,
        Ok(F::CloudLas) => MapFormat::CloudLas,
        Ok(F::CloudLaz) => MapFormat::CloudLaz,
        Ok(F::CloudGlb) => MapFormat::CloudGlb,
        Ok(F::VoxelsBt) => MapFormat::VoxelsBt,
        Ok(F::VoxelsOt) => MapFormat::VoxelsOt,
        Ok(F::OccupancyTiff) => MapFormat::OccupancyTiff,
        Ok(F::OccupancyPgw) => MapFormat::OccupancyPgw,
        Ok(F::MeshPly) => MapFormat::MeshPly,
        Ok(F::MeshGlb) => MapFormat::MeshGlb,
        Ok(F::TrajectoryTum) => MapFormat::TrajectoryTum,
        Ok(F::OverviewPng) => MapFormat::OverviewPng,
        Ok(F::CloudTopPng) => MapFormat::CloudTopPng,
        Ok(F::CloudViewPng) => MapFormat::CloudViewPng,
        Ok(F::MeshViewPng) => MapFormat::MeshViewPng,
        Ok(F::VoxelsViewPng) => MapFormat::VoxelsViewPng,
        Ok(F::HeightsPng) => MapFormat::HeightsPng,
        Ok(F::TraversabilityPng) => MapFormat::TraversabilityPng,
        Ok(F::LayersPng) => MapFormat::LayersPng,
        _ => return Err(super::unknown_enum("format", r.format)),
    })
}

/// Which state of the map, as a message.
pub fn stamp_to(map_version: u64, stamp: Timestamp) -> v1::MapStamp {
    v1::MapStamp { map_version, stamp_ns: stamp.nanos(), frame_id: "map".to_owned() }
}

/// Where a grid lies, as a message.
pub(super) fn grid_geometry_to(g: &GridGeometry, width: usize, height: usize) -> v1::GridGeometry {
    v1::GridGeometry {
        resolution_m: g.resolution_m,
        origin: Some(v1::Vector2 { x: g.origin.x, y: g.origin.y }),
        width: width as u32,
        height: height as u32,
    }
}

/// Sizes of a map as a message.
pub fn summary_to(s: &MapSummary) -> v1::GetMapSummaryResponse {
    v1::GetMapSummaryResponse {
        stamp: Some(stamp_to(s.map_version, s.stamp)),
        occupancy: s.occupancy.as_ref().map(|(g, w, h)| grid_geometry_to(g, *w, *h)),
        num_points: s.num_points as u64,
        voxel_size_m: s.voxel_size_m,
        num_keyframes: s.num_keyframes as u64,
        memory: Some(v1::MapMemory {
            scans_bytes: s.memory.map.scans as u64,
            submaps_bytes: s.memory.map.layers as u64,
            composed_bytes: s.memory.map.tiles as u64,
            places_bytes: s.memory.places as u64,
            graph_bytes: s.memory.graph as u64,
            odometry_bytes: s.memory.odometry as u64,
            live_bytes: s.memory.live as u64,
        }),
        missing_submaps: s.missing_submaps.iter().map(|id| format!("{}/{}/{}", id.robot, id.run, id.number)).collect(),
    }
}

/// A grid in one message.
pub fn grid_to(answer: &GridAnswer) -> v1::OccupancyGridChunk {
    let g = &answer.grid;
    v1::OccupancyGridChunk {
        stamp: Some(stamp_to(answer.map_version, answer.stamp)),
        geometry: Some(grid_geometry_to(&g.geometry, g.width, g.height)),
        offset: 0,
        cells: g.cells.iter().map(|&c| c as u8).collect::<Vec<u8>>().into(),
    }
}

/// A grid in chunks; at least one, which holds the head.
pub fn grid_chunks(answer: &GridAnswer) -> Vec<v1::OccupancyGridChunk> {
    let whole = grid_to(answer);
    let mut chunks = Vec::new();
    let mut offset = 0;
    loop {
        let end = (offset + CHUNK_BYTES).min(whole.cells.len());
        let head = offset == 0;
        chunks.push(v1::OccupancyGridChunk {
            stamp: whole.stamp.clone().filter(|_| head),
            geometry: whole.geometry.filter(|_| head),
            offset: offset as u64,
            cells: whole.cells.slice(offset..end),
        });
        offset = end;
        if offset == whole.cells.len() {
            return chunks;
        }
    }
}

/// A cloud in parts; at least one, which holds the head.
pub fn cloud_parts(answer: &CloudAnswer) -> Vec<v1::GetCloudResponse> {
    let chunk = |(i, cloud)| v1::CloudChunk {
        stamp: (i == 0).then(|| stamp_to(answer.map_version, answer.stamp)),
        total_points: (i == 0).then_some(answer.cloud.len() as u64),
        voxel_size_m: (i == 0).then_some(answer.voxel_size_m),
        cloud: Some(cloud),
    };
    let part = |chunk| v1::GetCloudResponse { chunk: Some(chunk), draco: Bytes::new() };
    geometry::cloud_parts(&answer.cloud).into_iter().enumerate().map(chunk).map(part).collect()
}

/// A map's file as one chunk. `sha256` is of the whole, lower-case hex.
pub fn file_to(file: MapFile, sha256: String) -> v1::FileChunk {
    let header = v1::FileHeader {
        stamp: Some(stamp_to(file.map_version, file.stamp)),
        file_name: file.file_name,
        media_type: file.media_type.to_owned(),
        size_bytes: file.bytes.len() as u64,
        sha256,
    };
    v1::FileChunk { header: Some(header), offset: 0, data: file.bytes.into() }
}

/// A file in chunks; at least one, which holds the head.
pub fn chunks_of_file(header: &v1::FileHeader, bytes: &Bytes) -> Vec<v1::FileChunk> {
    let starts = (0..bytes.len().max(1)).step_by(CHUNK_BYTES);
    starts
        .map(|start| v1::FileChunk {
            header: (start == 0).then(|| header.clone()),
            offset: start as u64,
            data: bytes.slice(start..(start + CHUNK_BYTES).min(bytes.len())),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_of_a_grid_join_to_the_whole() {
        for (width, height) in [(0, 0), (3, 2), (1500, 1500)] {
            let cells: Vec<i8> = (0..width * height).map(|i| (i % 102) as i8 - 1).collect();
            let grid = percept_formats::GridMap {
                geometry: GridGeometry::new(0.1, Point2::origin()),
                width,
                height,
                cells: cells.clone(),
            };
            let chunks = grid_chunks(&GridAnswer { map_version: 1, stamp: Timestamp(2), grid });
            let joined: Vec<i8> = chunks.iter().flat_map(|c| c.cells.iter().map(|&b| b as i8)).collect();
            assert_eq!(joined, cells);
            assert!(chunks[0].geometry.is_some() && chunks[1..].iter().all(|c| c.geometry.is_none()));
        }
    }
}
