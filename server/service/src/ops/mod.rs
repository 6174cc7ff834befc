//! The operations, one file a noun. A door decodes, calls one of these, encodes.

pub(crate) mod changes;
pub(crate) mod cloud_detail;
pub(crate) mod detectors;
mod errors;
pub mod evaluation;
pub mod exploration;
pub(crate) mod fleet;
mod labels;
pub mod layers;
pub(crate) mod map_comparison;
pub mod map_files;
pub(crate) mod map_import;
pub mod maps;
pub mod navigation;
pub(crate) mod operations;
pub mod path_picture;
pub(crate) mod path_watch;
pub mod pictures;
mod recordings;
pub mod rooms;
pub(crate) mod scene;
mod sensors;
pub(crate) mod server;
pub(crate) mod session_watch;
pub(crate) mod sessions;
pub mod toolbox;
pub(crate) mod transforms;
pub(crate) mod zone_masks;
pub(crate) mod zones;

use crate::Error;
use crate::reason;
use percept_perception::detection::ImageDetectors;
use percept_pipeline::{ParamsError, PipelineParams};

/// Checks that a learned detector that parameters name is there, among those that their tenant may use.
///
/// # Errors
/// `PARAMETER_OUT_OF_RANGE`.
pub(crate) fn check_learned(params: &PipelineParams, detectors: &ImageDetectors) -> crate::Result<()> {
    let name = params.detection.learned.as_str();
    if name.is_empty() || detectors.get(name).is_some() {
        return Ok(());
    }
    Err(unknown_detector("params.detection.learned", name, detectors, reason::PARAMETER_OUT_OF_RANGE))
}

/// A detector that is not there.
pub(crate) fn unknown_detector(field: &str, name: &str, detectors: &ImageDetectors, reason: &'static str) -> Error {
    let shown: String = name.chars().take(80).collect();
    let known: Vec<&str> = detectors.iter().map(|(name, _)| name).collect();
    let known =
        if known.is_empty() { "none; upload one, or put some into detectors.dir".to_owned() } else { known.join(", ") };
    Error::invalid(reason, field, format!("this server has no learned detector {shown:?}; there are: {known}"))
}

/// A parameter out of bounds.
pub(crate) fn params_error(e: &ParamsError) -> Error {
    Error::invalid(reason::PARAMETER_OUT_OF_RANGE, format!("params.{}", e.section), e.message.clone())
}
