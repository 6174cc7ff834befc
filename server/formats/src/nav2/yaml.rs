//! The YAML file, in and out.

use super::{FORMAT, MapYaml, Mode};
use crate::text::{Line, Lines, parse};
use crate::{FormatError, Place};
use nalgebra::Point2;
use percept_geometry::{GeometryError, GridGeometry};
use std::io::Write;

/// Reads the keys of a `map_server` YAML file; keys that it does not know are stepped over.
///
/// # Errors
/// `Malformed` with the line; `Missing` for image, resolution or origin; `Unsupported` for a turned origin.
pub fn parse_yaml(bytes: &[u8]) -> Result<MapYaml, FormatError> {
    let (mut image, mut resolution_m, mut origin) = (None, None, None);
    let (mut negate, mut occupied_thresh, mut free_thresh, mut mode) = (false, 0.65, 0.25, Mode::Trinary);
    let mut lines = Lines::new(FORMAT, bytes).contents().peekable();
    while let Some(line) = lines.next() {
        let Some(colon) = line.bytes.iter().position(|&b| b == b':') else {
            continue;
        };
        let (key, value) = (line.bytes[..colon].trim_ascii(), plain_value(&line.bytes[colon + 1..]));
        let number = |name: &str| {
            let number = parse::<f64>(value).filter(|v| v.is_finite());
            number.ok_or_else(|| line.malformed(name, value, "a finite number"))
        };
        match key {
            b"image" => image = Some(String::from_utf8_lossy(value).into_owned()),
            b"resolution" => resolution_m = Some(number("resolution")?),
            b"origin" if value.is_empty() => {
                let is_item = |l: &Line<'_>| l.bytes.trim_ascii_start().starts_with(b"-");
                let items: Vec<Line<'_>> = std::iter::from_fn(|| lines.next_if(is_item)).collect();
                let items: Vec<&[u8]> = items.iter().map(|l| plain_value(&l.bytes.trim_ascii_start()[1..])).collect();
                origin = Some(parse_origin(&line, &items)?);
            }
            b"origin" => {
                let inner = value.strip_prefix(b"[").and_then(|v| v.strip_suffix(b"]")).unwrap_or(value);
                let items: Vec<&[u8]> = inner.split(|&b| b == b',').map(<[u8]>::trim_ascii).collect();
                origin = Some(parse_origin(&line, &items)?);
            }
            b"negate" => negate = matches!(value, b"true" | b"True" | b"1"),
            b"occupied_thresh" => occupied_thresh = number("occupied_thresh")?,
            b"free_thresh" => free_thresh = number("free_thresh")?,
            b"mode" => {
                mode = match value {
                    b"trinary" => Mode::Trinary,
                    b"scale" => Mode::Scale,
                    b"raw" => Mode::Raw,
                    other => return Err(line.malformed("mode", other, "trinary, scale or raw")),
                }
            }
            _ => {}
        }
    }
    let missing = |field| FormatError::Missing { format: FORMAT, field };
    let resolution_m: f64 = resolution_m.ok_or(missing("resolution"))?;
    if resolution_m <= 0.0 {
        let (field, requirement) = ("resolution", "positive and finite");
        return Err(GeometryError::OutOfRange { field, value: resolution_m, requirement }.into());
    }
    let (image, origin) = (image.ok_or(missing("image"))?, origin.ok_or(missing("origin"))?);
    Ok(MapYaml { image, resolution_m, origin, negate, occupied_thresh, free_thresh, mode })
}

/// A value without spaces, trailing comment and quotes.
fn plain_value(bytes: &[u8]) -> &[u8] {
    let end = bytes.windows(2).position(|w| w == b" #").unwrap_or(bytes.len());
    let value = bytes[..end].trim_ascii();
    match value {
        [b'"', inner @ .., b'"'] | [b'\'', inner @ .., b'\''] => inner,
        _ => value,
    }
}

fn parse_origin(line: &Line<'_>, items: &[&[u8]]) -> Result<Point2<f64>, FormatError> {
    let number = |token: &[u8]| {
        let number = parse::<f64>(token).filter(|v| v.is_finite());
        number.ok_or_else(|| line.malformed("origin", token, "a finite number"))
    };
    let [x, y, yaw] = items else {
        return Err(line.malformed("origin", line.bytes, "[x, y, yaw]"));
    };
    let yaw = number(yaw)?;
    if yaw != 0.0 {
        let value = yaw.to_string();
        return Err(FormatError::Unsupported { format: FORMAT, field: "yaw of the origin", value, supported: "0" });
    }
    Ok(Point2::new(number(x)?, number(y)?))
}

/// Writes the YAML file that belongs to the image of [`write_pgm`].
///
/// The thresholds are ROS 1's 0.65 and 0.196: with nav2's newer 0.25, the grey of unknown would read as free.
///
/// # Errors
/// `Malformed` if `image_name` holds a line end; `Write` if the writer refuses.
pub fn write_yaml(out: &mut impl Write, geometry: &GridGeometry, image_name: &str) -> Result<(), FormatError> {
    if image_name.contains(['\n', '\r']) {
        let place = Place::Line(1);
        return Err(FormatError::malformed(FORMAT, place, "image", image_name.as_bytes(), "a name in one line"));
    }
    let (x, y) = (geometry.origin.x, geometry.origin.y);
    write!(
        out,
        "image: {image_name}\nmode: trinary\nresolution: {:?}\norigin: [{x:?}, {y:?}, 0.0]\nnegate: 0\n\
         occupied_thresh: 0.65\nfree_thresh: 0.196\n",
        geometry.resolution_m
    )?;
    Ok(())
}
