//! Files of clouds.

use crate::convert::{required, unknown_enum};
use crate::v1;
use percept_geometry::PointCloud;
use percept_service::toolbox::{self, CloudFormat};
use percept_service::{Limits, Result};

/// A file format; none if it is to be told by the first bytes.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn format(field: &'static str, value: i32) -> Result<Option<CloudFormat>> {
    use v1::CloudFormat as F;
    Ok(Some(match F::try_from(value) {
        Ok(F::Unspecified) => return Ok(None),
        Ok(F::Ply) => CloudFormat::Ply,
        Ok(F::PlyAscii) => CloudFormat::PlyAscii,
        Ok(F::Pcd) => CloudFormat::Pcd,
        Ok(F::KittiBin) => CloudFormat::KittiBin,
        Err(_) => return Err(unknown_enum(field, value)),
    }))
}

/// A file format as a message.
pub fn format_to(format: CloudFormat) -> v1::CloudFormat {
    match format {
        CloudFormat::Ply => v1::CloudFormat::Ply,
        CloudFormat::PlyAscii => v1::CloudFormat::PlyAscii,
        CloudFormat::Pcd => v1::CloudFormat::Pcd,
        CloudFormat::KittiBin => v1::CloudFormat::KittiBin,
    }
}

/// The points of a request's file.
///
/// # Errors
/// `FILE_INVALID`, `FORMAT_UNKNOWN`, `ENUM_UNKNOWN`.
pub fn decoded(file: Option<&v1::CloudFile>, limits: &Limits) -> Result<PointCloud> {
    let file = required("file", file)?;
    let format = format("format", file.format).map_err(|e| e.within("file"))?;
    toolbox::decode_cloud(&file.data, format, limits).map_err(|e| e.within("file"))
}

/// A cloud as a file.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn encoded(cloud: &PointCloud, value: i32) -> Result<v1::CloudFile> {
    let format = format("format", value)?.unwrap_or(CloudFormat::Ply);
    let data = toolbox::encode_cloud(cloud, format)?.into();
    Ok(v1::CloudFile { data, format: format_to(format).into() })
}
