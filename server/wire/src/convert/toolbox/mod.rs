//! Requests to the toolbox, laid over the defaults; answers back. One file a group.

/// Lays the fields that were sent over parameters of the same names.
macro_rules! lay_over {
    ($params:ident, $r:ident: $($field:ident),+) => {
        $(if let Some(value) = $r.$field { $params.$field = value as _; })+
    };
}

pub mod depth;
pub mod depth_images;
pub mod features;
pub mod files;
pub mod filters;
pub mod images;
pub mod pictures;
pub mod pipeline;
pub mod regions;
pub mod registration;
pub mod segmentation;
pub mod shapes;
pub mod sources;
pub mod subsets;

use super::geometry;
use crate::v1;
use bytes::Bytes;
use percept_geometry::PointCloud;
use percept_service::toolbox::{KeptCloud, KeptList, Toolbox};
use percept_service::{Error, Result};
use std::sync::Arc;

/// The cloud of a request's field.
///
/// # Errors
/// Naming the channel; `FIELD_MISSING`, `CLOUD_NOT_FOUND`, and those of files.
pub fn cloud(toolbox: &Toolbox, field: &'static str, source: Option<&v1::CloudSource>) -> Result<Arc<PointCloud>> {
    use v1::cloud_source::Source as S;
    let within = |inner: &str| format!("{field}.{inner}");
    match source.and_then(|s| s.source.as_ref()) {
        Some(S::Cloud(c)) => geometry::cloud(c, toolbox.limits()).map(Arc::new).map_err(|e| e.within(&within("cloud"))),
        Some(S::Handle(handle)) => toolbox.kept(&within("handle"), handle),
        Some(S::File(file)) => {
            files::decoded(Some(file), toolbox.limits()).map(|(c, _)| Arc::new(c)).map_err(|e| e.within(field))
        }
        Some(S::Session(_)) => toolbox.session_cloud(&within("session")),
        None => {
            let words = format!("{field} is missing; send one of {field}.cloud, handle, file and session");
            Err(Error::invalid("FIELD_MISSING", field, words))
        }
    }
}

/// A resulting cloud: sent, or kept and named.
///
/// # Errors
/// `KEPT_CLOUDS_FULL`.
pub fn result(
    toolbox: &Toolbox,
    cloud: PointCloud,
    keep: bool,
) -> Result<(Option<v1::PointCloud>, Option<v1::CloudHandle>)> {
    if keep {
        return Ok((None, Some(kept_to(&toolbox.keep(cloud, None)?))));
    }
    Ok((Some(geometry::cloud_to(&cloud)), None))
}

/// A kept cloud as a message.
pub fn kept_to(kept: &KeptCloud) -> v1::CloudHandle {
    v1::CloudHandle {
        handle: kept.handle.clone(),
        num_points: kept.num_points as u32,
        size_bytes: kept.size_bytes as u64,
        expires_ns: kept.expires_ns,
    }
}

/// The kept clouds as a message.
pub fn kept_list_to(list: &KeptList) -> v1::ListCloudsResponse {
    v1::ListCloudsResponse {
        clouds: list.clouds.iter().map(kept_to).collect(),
        used_bytes: list.used_bytes as u64,
        max_bytes: list.max_bytes as u64,
    }
}

/// Indices as uint32, little-endian.
pub fn bytes_of_indices(indices: &[usize]) -> Bytes {
    let mut out = vec![0; indices.len() * 4];
    out.chunks_exact_mut(4).zip(indices).for_each(|(out, &i)| out.copy_from_slice(&(i as u32).to_le_bytes()));
    out.into()
}

/// Labels as int32, little-endian; -1 for none.
pub fn bytes_of_labels(labels: &[Option<u32>]) -> Bytes {
    let mut out = vec![0; labels.len() * 4];
    let number = |l: &Option<u32>| l.map_or(-1, |l| l as i32).to_le_bytes();
    out.chunks_exact_mut(4).zip(labels).for_each(|(out, l)| out.copy_from_slice(&number(l)));
    out.into()
}

fn set<T>(slot: &mut T, sent: Option<T>) {
    if let Some(value) = sent {
        *slot = value;
    }
}

fn count(sent: Option<u32>) -> Option<usize> {
    sent.map(|n| n as usize)
}
