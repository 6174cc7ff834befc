//! The operations, one file a noun. A door decodes, calls one of these, encodes.

pub(crate) mod changes;
pub(crate) mod cloud_detail;
pub mod evaluation;
pub mod exploration;
pub(crate) mod fleet;
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
pub mod rooms;
pub(crate) mod scene;
mod sensors;
pub(crate) mod server;
pub(crate) mod sessions;
pub mod toolbox;
pub(crate) mod transforms;
pub(crate) mod zone_masks;
pub(crate) mod zones;

use crate::Error;
use crate::reason;
use percept_pipeline::ParamsError;

/// A parameter out of bounds.
pub(crate) fn params_error(e: &ParamsError) -> Error {
    Error::invalid(reason::PARAMETER_OUT_OF_RANGE, format!("params.{}", e.section), e.message.clone())
}
