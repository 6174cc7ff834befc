//! Clouds and meshes packed by Draco.

use super::maps::{CHUNK_BYTES, stamp_to};
use crate::v1;
use bytes::Bytes;
use percept_formats::draco::{self, BOUNDS_M};
use percept_geometry::TriangleMesh;
use percept_service::layers::OfMap;
use percept_service::reason;
use percept_service::{CloudAnswer, Error, Result};

/// By how much positions are off where nobody says, metres: a tenth of what the sensors' noise is.
pub(super) const USUAL_M: f64 = 1e-3;

/// A bound that was sent, metres.
///
/// # Errors
/// `OUT_OF_RANGE`.
pub fn bound(field: &str, sent: Option<f64>) -> Result<Option<f64>> {
    if sent.is_none_or(|m| BOUNDS_M.contains(&m)) {
        return Ok(sent);
    }
    let (shown, least, most) = (sent.unwrap_or_default(), BOUNDS_M.start(), BOUNDS_M.end());
    let message = format!("{field} is {shown}; it must be {least} to {most}, metres");
    Err(Error::invalid(reason::OUT_OF_RANGE, field, message))
}

/// A surface, packed.
///
/// # Errors
/// `INTERNAL` if it cannot be.
pub fn mesh_to(found: &OfMap<TriangleMesh>, max_error_m: f64) -> Result<v1::GetMeshResponse> {
    let bytes = if found.answer.is_empty() { Ok(vec![]) } else { draco::encode_mesh(&found.answer, max_error_m) };
    Ok(v1::GetMeshResponse {
        stamp: Some(stamp_to(found.map_version, found.stamp)),
        draco: bytes.map_err(Error::internal)?.into(),
        ..Default::default()
    })
}

/// A cloud, packed, in parts; at least one, which holds the head.
///
/// # Errors
/// `INTERNAL` if it cannot be.
pub fn cloud_parts(answer: &CloudAnswer, max_error_m: f64) -> Result<Vec<v1::GetCloudResponse>> {
    let bytes = if answer.cloud.is_empty() { Ok(vec![]) } else { draco::encode_cloud(&answer.cloud, max_error_m) };
    let bytes = Bytes::from(bytes.map_err(Error::internal)?);
    let head = || v1::CloudChunk {
        stamp: Some(stamp_to(answer.map_version, answer.stamp)),
        total_points: Some(answer.cloud.len() as u64),
        voxel_size_m: Some(answer.voxel_size_m),
        cloud: None,
    };
    let part = |start: usize| v1::GetCloudResponse {
        chunk: (start == 0).then(head),
        draco: bytes.slice(start..(start + CHUNK_BYTES).min(bytes.len())),
    };
    Ok((0..bytes.len().max(1)).step_by(CHUNK_BYTES).map(part).collect())
}
