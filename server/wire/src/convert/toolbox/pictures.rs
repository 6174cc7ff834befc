//! Pictures: parameters of requests.

use crate::convert::unknown_enum;
use crate::v1;
use percept_geometry::GeometryError;
use percept_perception::render::{Coloring, RenderParams, View};
use percept_service::{Error, Result};

/// How a cloud is drawn.
///
/// # Errors
/// `ENUM_UNKNOWN`, `SIZE_MISMATCH` for a background that is not three bytes.
pub fn render_params(r: &v1::RenderCloudRequest) -> Result<RenderParams> {
    use v1::{CloudColouring as C, CloudView as V};
    let view = match V::try_from(r.view) {
        Ok(V::Unspecified | V::Top) => View::Top,
        Ok(V::Front) => View::Front,
        Ok(V::Side) => View::Side,
        Ok(V::Perspective) => View::Perspective,
        Ok(V::Camera) => View::Camera,
        Err(_) => return Err(unknown_enum("view", r.view)),
    };
    let coloring = match C::try_from(r.colouring) {
        Ok(C::Unspecified) => Coloring::Auto,
        Ok(C::Own) => Coloring::Own,
        Ok(C::Height) => Coloring::Height,
        Ok(C::Normal) => Coloring::Normal,
        Ok(C::Label) => Coloring::Label,
        Ok(C::Intensity) => Coloring::Intensity,
        Err(_) => return Err(unknown_enum("colouring", r.colouring)),
    };
    let mut params = RenderParams { view, coloring, ..RenderParams::default() };
    lay_over!(params, r: width_px, height_px, point_size_px, shade);
    if let Some(color) = &r.background {
        let mismatch = GeometryError::ShapeMismatch { field: "background", expected: 3, actual: color.len() };
        params.background = (&color[..]).try_into().map_err(|_| mismatch)?;
    }
    Ok(params)
}

/// Labels of a request, one a point; negative is none.
///
/// # Errors
/// `SIZE_MISMATCH`.
pub fn labels(r: &v1::RenderCloudRequest) -> Result<Option<Vec<Option<u32>>>> {
    let Some(data) = &r.labels else { return Ok(None) };
    let (numbers, rest) = data.as_chunks::<4>();
    if !rest.is_empty() {
        let (expected, actual) = (numbers.len() + 1, numbers.len());
        return Err(GeometryError::ShapeMismatch { field: "labels", expected, actual }.into());
    }
    Ok(Some(numbers.iter().map(|b| u32::try_from(i32::from_le_bytes(*b)).ok()).collect()))
}

/// The range of a depth picture, metres.
///
/// # Errors
/// `FIELD_MISSING` if only one end is given.
pub fn depth_range(r: &v1::RenderDepthRequest) -> Result<Option<(f32, f32)>> {
    match (r.near_m, r.far_m) {
        (Some(near), Some(far)) => Ok(Some((near as f32, far as f32))),
        (None, None) => Ok(None),
        (near, _) => {
            let field = if near.is_none() { "near_m" } else { "far_m" };
            let words = format!("{field} is missing; near_m and far_m belong together, give both or neither");
            Err(Error::invalid("FIELD_MISSING", field, words))
        }
    }
}
