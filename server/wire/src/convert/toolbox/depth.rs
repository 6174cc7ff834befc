//! Depth and colour images: parameters of requests, and answers.

use super::{count, set};
use crate::convert::{format_error, format_limits, required, sensors, unknown_enum};
use crate::v1;
use percept_formats::images;
use percept_geometry::{CameraIntrinsics, DepthImage, RgbImage};
use percept_perception::depth::UnprojectParams;
use percept_service::{Error, Limits, Result};

/// Depth, colour, intrinsics and parameters of an unprojection.
///
/// # Errors
/// Images or intrinsics that lie.
pub fn unprojection(
    r: &v1::UnprojectDepthRequest,
    limits: &Limits,
) -> Result<(DepthImage, Option<RgbImage>, CameraIntrinsics, UnprojectParams)> {
    let depth = sensors::depth(required("depth", r.depth.as_ref())?, limits).map_err(|e| e.within("depth"))?;
    let color = r.colour.as_ref().map(|c| sensors::color(c, limits)).transpose().map_err(|e| e.within("colour"))?;
    let intrinsics = sensors::intrinsics(required("intrinsics", r.intrinsics.as_ref())?)?;
    let mut params = UnprojectParams::default();
    set(&mut params.stride_px, count(r.stride));
    set(&mut params.min_depth_m, r.min_depth_m);
    set(&mut params.max_depth_m, r.max_depth_m);
    Ok((depth, color, intrinsics, params))
}

/// The depth image of a request; a PNG that declares no size has the file's.
///
/// # Errors
/// Those of [`sensors::depth`].
pub fn depth(field: &'static str, d: Option<&v1::DepthImage>, limits: &Limits) -> Result<DepthImage> {
    let d = required(field, d)?;
    let of_file = d.encoding == i32::from(v1::DepthEncoding::Png16) && (d.width_px, d.height_px) == (0, 0);
    if !of_file {
        return sensors::depth(d, limits).map_err(|e| e.within(field));
    }
    let scale = required("metres_per_unit", d.metres_per_unit).map_err(|e| e.within(field))?;
    images::decode_depth_png(&d.data, scale, &format_limits(limits)).map_err(|e| format_error(e).within(field))
}

/// The colour image of a request; a PNG or JPEG that declares no size has the file's.
///
/// # Errors
/// Those of [`sensors::color`].
pub fn color(field: &'static str, c: Option<&v1::ColourImage>, limits: &Limits) -> Result<RgbImage> {
    let c = required(field, c)?;
    use v1::ColourEncoding as E;
    let raw = matches!(E::try_from(c.encoding), Ok(E::Unspecified | E::Rgb8 | E::Grey8));
    if raw || (c.width_px, c.height_px) != (0, 0) {
        return sensors::color(c, limits).map_err(|e| e.within(field));
    }
    images::decode_color(&c.data, &format_limits(limits)).map_err(|e| format_error(e).within(field))
}

/// A depth image as a message of float32 metres.
pub fn depth_to(d: &DepthImage) -> v1::DepthImage {
    let mut data = vec![0; d.data().len() * 4];
    data.chunks_exact_mut(4).zip(d.data()).for_each(|(out, v)| out.copy_from_slice(&v.to_le_bytes()));
    v1::DepthImage {
        width_px: d.width() as u32,
        height_px: d.height() as u32,
        encoding: v1::DepthEncoding::F32.into(),
        metres_per_unit: None,
        row_stride_bytes: None,
        data: data.into(),
    }
}

/// A depth image in the encoding that is asked for.
///
/// # Errors
/// `ENUM_UNKNOWN`, `OUT_OF_RANGE` naming `metres_per_unit`.
pub fn converted_depth(d: &DepthImage, r: &v1::ConvertDepthRequest) -> Result<v1::DepthImage> {
    use v1::DepthEncoding as E;
    let encoding = E::try_from(r.encoding).map_err(|_| unknown_enum("encoding", r.encoding))?;
    if matches!(encoding, E::Unspecified | E::F32) {
        return Ok(depth_to(d));
    }
    let scale = r.metres_per_unit.unwrap_or(0.001);
    if !(scale.is_finite() && scale > 0.0) {
        let words = format!("metres_per_unit is {scale}; it must be positive and finite");
        return Err(Error::invalid("OUT_OF_RANGE", "metres_per_unit", words));
    }
    let data = if encoding == E::U16 {
        // As the PNG rounds: what exceeds 65534 units is no return.
        let unit = |m: f32| Some((f64::from(m) / scale).round()).filter(|u| *u <= 65534.0).map_or(0, |u| u as u16);
        d.data().iter().flat_map(|m| unit(*m).to_le_bytes()).collect()
    } else {
        images::encode_depth_png(d, scale).map_err(format_error)?
    };
    let (width_px, height_px) = (d.width() as u32, d.height() as u32);
    let encoding = encoding.into();
    Ok(v1::DepthImage {
        width_px,
        height_px,
        encoding,
        metres_per_unit: Some(scale),
        row_stride_bytes: None,
        data: data.into(),
    })
}

/// A colour image as a message of RGB8.
pub fn color_to(c: &RgbImage) -> v1::ColourImage {
    v1::ColourImage {
        width_px: c.width() as u32,
        height_px: c.height() as u32,
        encoding: v1::ColourEncoding::Rgb8.into(),
        row_stride_bytes: None,
        data: c.data().to_vec().into(),
    }
}

/// A colour image in the encoding that is asked for.
///
/// # Errors
/// `ENUM_UNKNOWN`, `OUT_OF_RANGE` naming `quality`.
pub fn converted_color(c: &RgbImage, r: &v1::ConvertColourRequest) -> Result<v1::ColourImage> {
    use v1::ColourEncoding as E;
    let quality = r.quality.unwrap_or(90);
    let quality = u8::try_from(quality).ok().filter(|q| (1..=100).contains(q)).ok_or_else(|| {
        Error::invalid("OUT_OF_RANGE", "quality", format!("quality is {quality}; it must be within 1 to 100"))
    })?;
    let (encoding, data) = match E::try_from(r.encoding) {
        Ok(E::Unspecified | E::Rgb8) => return Ok(color_to(c)),
        Ok(E::Jpeg) => (E::Jpeg, images::encode_jpeg(c, quality)),
        Ok(E::Png) => (E::Png, images::encode_rgb_png(c)),
        Ok(E::Grey8) => (E::Grey8, Ok(c.to_gray().data().to_vec())),
        Err(_) => return Err(unknown_enum("encoding", r.encoding)),
    };
    let (width_px, height_px) = (c.width() as u32, c.height() as u32);
    let data = data.map_err(format_error)?.into();
    Ok(v1::ColourImage { width_px, height_px, encoding: encoding.into(), row_stride_bytes: None, data })
}
