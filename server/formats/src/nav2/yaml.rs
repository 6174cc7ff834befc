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
/// `Malformed` with the line, thresholds that are no shares or the wrong way round included; `Missing` for image, resolution
/// or origin; `Geometry` for a resolution that is not positive.
pub fn parse_yaml(bytes: &[u8]) -> Result<MapYaml, FormatError> {
    let (mut image, mut resolution_m, mut origin) = (None, None, None);
    let (mut negate, mut occupied_thresh, mut free_thresh, mut mode) = (false, 0.65, 0.25, Mode::Trinary);
    let lines_end = Place::Line(Lines::new(FORMAT, bytes).count() as u64);
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
        let share = |name: &str| {
            let share = number(name)?;
            let is_share = (0.0..=1.0).contains(&share);
            if is_share { Ok(share) } else { Err(line.malformed(name, value, "a share from 0 to 1")) }
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
            b"negate" => {
                let truth = truth(value);
                negate = truth.ok_or_else(|| line.malformed("negate", value, "0 or 1, true or false"))?;
            }
            b"occupied_thresh" => occupied_thresh = share("occupied_thresh")?,
            b"free_thresh" => free_thresh = share("free_thresh")?,
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
    if free_thresh > occupied_thresh {
        let (found, expected) = (free_thresh.to_string(), "at most occupied_thresh");
        return Err(FormatError::malformed(FORMAT, lines_end, "free_thresh", found.as_bytes(), expected));
    }
    let (image, (origin, yaw_rad)) = (image.ok_or(missing("image"))?, origin.ok_or(missing("origin"))?);
    Ok(MapYaml { image, resolution_m, origin, yaw_rad, negate, occupied_thresh, free_thresh, mode })
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

/// A number or one of YAML's words for true and false.
fn truth(value: &[u8]) -> Option<bool> {
    match value.to_ascii_lowercase().as_slice() {
        b"true" | b"yes" | b"on" | b"y" => Some(true),
        b"false" | b"no" | b"off" | b"n" => Some(false),
        other => parse::<i64>(other).map(|n| n != 0),
    }
}

fn parse_origin(line: &Line<'_>, items: &[&[u8]]) -> Result<(Point2<f64>, f64), FormatError> {
    let number = |token: &[u8]| {
        let number = parse::<f64>(token).filter(|v| v.is_finite());
        number.ok_or_else(|| line.malformed("origin", token, "a finite number"))
    };
    let [x, y, yaw] = items else {
        return Err(line.malformed("origin", line.bytes, "[x, y, yaw]"));
    };
    Ok((Point2::new(number(x)?, number(y)?), number(yaw)?))
}

/// Writes the YAML file that belongs to the image of [`super::write_pgm`].
///
/// # Errors
/// Those of [`write_yaml_of`].
pub fn write_yaml(out: &mut impl Write, geometry: &GridGeometry, image_name: &str) -> Result<(), FormatError> {
    write_yaml_of(out, geometry, image_name, Mode::Trinary)
}

/// Writes the YAML file that belongs to the image of [`super::encode_image`].
///
/// The thresholds of trinary are ROS 1's 0.65 and 0.196: with nav2's newer 0.25, the grey of unknown would read as free. Those
/// of scale are 1 and 0, so that every value comes back.
///
/// # Errors
/// `Malformed` if `image_name` holds a line end; `Write` if the writer refuses.
pub fn write_yaml_of(
    out: &mut impl Write,
    geometry: &GridGeometry,
    image_name: &str,
    mode: Mode,
) -> Result<(), FormatError> {
    if image_name.contains(['\n', '\r']) {
        let place = Place::Line(1);
        return Err(FormatError::malformed(FORMAT, place, "image", image_name.as_bytes(), "a name in one line"));
    }
    let (name, occupied_thresh, free_thresh) = match mode {
        Mode::Trinary => ("trinary", "0.65", "0.196"),
        Mode::Scale => ("scale", "1.0", "0.0"),
        Mode::Raw => ("raw", "0.65", "0.196"),
    };
    let (x, y) = (geometry.origin.x, geometry.origin.y);
    write!(
        out,
        "image: {image_name}\nmode: {name}\nresolution: {:?}\norigin: [{x:?}, {y:?}, 0.0]\nnegate: 0\n\
         occupied_thresh: {occupied_thresh}\nfree_thresh: {free_thresh}\n",
        geometry.resolution_m
    )?;
    Ok(())
}
