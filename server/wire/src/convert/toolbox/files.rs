//! Files of clouds.

use crate::convert::{geometry, required, unknown_enum};
use crate::v1;
use percept_formats::{pcd, ply};
use percept_geometry::PointCloud;
use percept_service::toolbox::{self, CloudFormat};
use percept_service::{Limits, Result};

/// A file format; none if it is to be told by the content.
///
/// # Errors
/// `ENUM_UNKNOWN`.
pub fn format(field: &'static str, value: i32) -> Result<Option<CloudFormat>> {
    use v1::CloudFormat as F;
    Ok(Some(match F::try_from(value) {
        Ok(F::Unspecified) => return Ok(None),
        Ok(F::Ply) => CloudFormat::Ply(ply::Encoding::BinaryLittleEndian),
        Ok(F::PlyAscii) => CloudFormat::Ply(ply::Encoding::Ascii),
        Ok(F::PlyBigEndian) => CloudFormat::Ply(ply::Encoding::BinaryBigEndian),
        Ok(F::Pcd) => CloudFormat::Pcd(pcd::Encoding::Binary),
        Ok(F::PcdAscii) => CloudFormat::Pcd(pcd::Encoding::Ascii),
        Ok(F::PcdCompressed) => CloudFormat::Pcd(pcd::Encoding::BinaryCompressed),
        Ok(F::Xyz) => CloudFormat::Xyz,
        Ok(F::KittiBin) => CloudFormat::KittiBin,
        Ok(F::Las) => CloudFormat::Las,
        Ok(F::Laz) => CloudFormat::Laz,
        Err(_) => return Err(unknown_enum(field, value)),
    }))
}

/// The points of a request's file, and their origin, metres.
///
/// # Errors
/// `FILE_INVALID`, `FORMAT_UNKNOWN`, `FORMAT_MISMATCH`, `CLOUD_TOO_LARGE`, `ENUM_UNKNOWN`.
pub fn decoded(file: Option<&v1::CloudFile>, limits: &Limits) -> Result<(PointCloud, v1::Vector3)> {
    let file = required("file", file)?;
    let format = format("format", file.format).map_err(|e| e.within("file"))?;
    let (cloud, [x, y, z]) = toolbox::decode_cloud(&file.data, format, limits).map_err(|e| e.within("file"))?;
    Ok((cloud, v1::Vector3 { x, y, z }))
}

/// A cloud as a file; PLY if no format is said.
///
/// # Errors
/// `ENUM_UNKNOWN`, `ORIGIN_UNSUPPORTED`.
pub fn encoded(cloud: &PointCloud, origin_m: Option<v1::Vector3>, value: i32) -> Result<v1::CloudFile> {
    let said = format("format", value)?;
    let origin_m = geometry::vector("origin_m", &origin_m.unwrap_or_default())?.into();
    let chosen = said.unwrap_or(CloudFormat::Ply(ply::Encoding::BinaryLittleEndian));
    let data = toolbox::encode_cloud(cloud, origin_m, chosen)?.into();
    let format = if said.is_some() { value } else { v1::CloudFormat::Ply.into() };
    Ok(v1::CloudFile { data, format })
}
