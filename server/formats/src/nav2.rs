//! Occupancy grids as nav2's and ROS 1's `map_server` keep them: an image and a YAML file beside it.
//!
//! Source: the documentation of nav2's map server. Pixels are darker where occupied; the image's first row
//! is the one with the largest y.

use crate::images::Gray16;
use crate::text::{Line, Lines, parse};
use crate::{FormatError, Limits, Place, pgm};
use nalgebra::Point2;
use percept_geometry::{GeometryError, GridGeometry};
use std::io::Write;
use std::path::Path;

const FORMAT: &str = "nav2 map";

/// What `map_saver` draws: free, occupied, unknown.
const FREE: u8 = 254;
const OCCUPIED: u8 = 0;
const UNKNOWN: u8 = 205;

/// An occupancy grid in the convention of ROS's `OccupancyGrid` message.
#[derive(Debug, Clone, PartialEq)]
pub struct GridMap {
    /// Cell (0, 0)'s lower-left corner and the edge of a cell.
    pub geometry: GridGeometry,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `H x W`, row-major, row 0 at the smallest y: -1 unknown, 0 free … 100 occupied.
    pub cells: Vec<i8>,
}

/// How pixels become cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Free, occupied or unknown.
    Trinary,
    /// Unknown becomes a share between 1 and 99.
    Scale,
    /// The pixel's value is the cell's; above 100 is unknown.
    Raw,
}

/// What the YAML file says.
#[derive(Debug, Clone, PartialEq)]
pub struct MapYaml {
    /// Image file, relative to the YAML file.
    pub image: String,
    /// Edge of a cell, metres.
    pub resolution_m: f64,
    /// Lower-left corner of the map, metres.
    pub origin: Point2<f64>,
    /// Whether light means occupied.
    pub negate: bool,
    /// Occupancy above this is occupied, 0..1.
    pub occupied_thresh: f64,
    /// Occupancy below this is free, 0..1.
    pub free_thresh: f64,
    /// How pixels become cells.
    pub mode: Mode,
}

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

/// The grid that a YAML file and its image (PGM or PNG) make.
///
/// # Errors
/// Those of [`pgm::decode`] and [`crate::images::decode_gray16`].
pub fn decode(yaml: &MapYaml, image: &[u8], limits: &Limits) -> Result<GridMap, FormatError> {
    let (width, height, white, data) = if image.starts_with(b"\x89PNG") {
        let Gray16 { width, height, bits, data } = crate::images::decode_gray16(image, limits)?;
        (width, height, if bits == 8 { 255 } else { 65535 }, data)
    } else {
        let pgm = pgm::decode(image, limits)?;
        (pgm.width, pgm.height, pgm.max_value, pgm.data)
    };
    let mut cells = Vec::with_capacity(data.len());
    if width > 0 {
        for row in data.chunks_exact(width).rev() {
            cells.extend(row.iter().map(|&v| cell(yaml, v, white)));
        }
    }
    Ok(GridMap { geometry: GridGeometry::new(yaml.resolution_m, yaml.origin), width, height, cells })
}

/// A pixel's meaning, as `loadMapFromFile` of nav2 has it.
fn cell(yaml: &MapYaml, value: u16, white: u16) -> i8 {
    let shade = f64::from(value) / f64::from(white);
    let occupancy = if yaml.negate { shade } else { 1.0 - shade };
    match yaml.mode {
        Mode::Raw => {
            let value = (f64::from(value) * 255.0 / f64::from(white)).round();
            if value <= 100.0 { value as i8 } else { -1 }
        }
        _ if occupancy > yaml.occupied_thresh => 100,
        _ if occupancy < yaml.free_thresh => 0,
        Mode::Trinary => -1,
        Mode::Scale => {
            let span = (yaml.occupied_thresh - yaml.free_thresh).max(f64::EPSILON);
            (1.0 + 98.0 * (occupancy - yaml.free_thresh) / span).clamp(1.0, 99.0) as i8
        }
    }
}

/// Reads a map from its YAML file and the image that it names.
///
/// # Errors
/// `Io`, and those of [`parse_yaml`] and [`decode`] with the file's name.
pub fn read(yaml_path: &Path, limits: &Limits) -> Result<GridMap, FormatError> {
    let yaml = parse_yaml(&crate::read_file(yaml_path, limits)?).map_err(|e| e.in_file(yaml_path))?;
    let image_path = yaml_path.parent().unwrap_or(Path::new("")).join(&yaml.image);
    decode(&yaml, &crate::read_file(&image_path, limits)?, limits).map_err(|e| e.in_file(&image_path))
}

/// Writes the image of a map, trinary: 254 free (up to 25), 0 occupied (from 65), 205 unknown (between, and -1).
///
/// # Errors
/// `Geometry` if `cells` does not hold `width * height` values; `Write` if the writer refuses.
pub fn write_pgm(out: &mut impl Write, map: &GridMap) -> Result<(), FormatError> {
    let expected = map.width.saturating_mul(map.height);
    if map.cells.len() != expected {
        let actual = map.cells.len();
        return Err(GeometryError::ShapeMismatch { field: "cells", expected, actual }.into());
    }
    write!(out, "P5\n# resolution {} m\n{} {}\n255\n", map.geometry.resolution_m, map.width, map.height)?;
    let pixel = |&c: &i8| match c {
        0..=25 => FREE,
        65..=100 => OCCUPIED,
        _ => UNKNOWN,
    };
    if map.width > 0 {
        for row in map.cells.chunks_exact(map.width).rev() {
            out.write_all(&row.iter().map(pixel).collect::<Vec<u8>>())?;
        }
    }
    Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip(map: &GridMap) -> GridMap {
        let (mut image, mut yaml) = (vec![], vec![]);
        write_pgm(&mut image, map).unwrap();
        write_yaml(&mut yaml, &map.geometry, "map.pgm").unwrap();
        decode(&parse_yaml(&yaml).unwrap(), &image, &Limits::default()).unwrap()
    }

    #[test]
    fn a_map_survives_and_its_first_image_row_is_the_highest_y() {
        let geometry = GridGeometry::new(0.05, Point2::new(-1.23456789, 2.5e-7));
        let map = GridMap { geometry, width: 3, height: 2, cells: vec![0, 100, -1, -1, -1, 0] };
        assert_eq!(round_trip(&map), map);
        let mut image = vec![];
        write_pgm(&mut image, &map).unwrap();
        assert!(image.ends_with(&[205, 205, 254, 254, 0, 205]));
        let graded = GridMap { cells: vec![10, 70, 50, -1, 25, 65], ..map };
        assert_eq!(round_trip(&graded).cells, [0, 100, -1, -1, 0, 100]);
    }

    #[test]
    fn pixels_mean_what_map_server_says() {
        let yaml = |text: &str| {
            parse_yaml(
                format!("image: \"a b.pgm\" # x\nresolution: 0.1\norigin:\n  - -1\n  - 2.5\n  - 0\n{text}").as_bytes(),
            )
            .unwrap()
        };
        let image = b"P5 4 1 255 \x00\xcd\xfe\x80";
        let cells = |text: &str| decode(&yaml(text), image, &Limits::default()).unwrap().cells;
        assert_eq!(yaml("").image, "a b.pgm");
        assert_eq!(yaml("").origin, Point2::new(-1.0, 2.5));
        assert_eq!(cells("free_thresh: 0.196\n"), [100, -1, 0, -1]);
        assert_eq!(cells("free_thresh: 0.25\n"), [100, 0, 0, -1]);
        assert_eq!(cells("negate: 1\nfree_thresh: 0.196\n"), [0, 100, 100, -1]);
        assert_eq!(cells("mode: raw\n"), [0, -1, -1, -1]);
        assert_eq!(cells("mode: scale\nfree_thresh: 0.196\n"), [100, 1, 0, 66]);
    }

    #[test]
    fn bad_yaml_is_named() {
        let error = |text: &str| parse_yaml(text.as_bytes()).unwrap_err().to_string();
        assert_eq!(error("image: a\norigin: [0, 0, 0]\n"), "nav2 map: resolution is missing");
        assert_eq!(
            error("image: a\nresolution: five\n"),
            "nav2 map, line 2: resolution is 'five', expected a finite number"
        );
        assert!(error("image: a\nresolution: 0.1\norigin: [0, 0, 1.57]\n").contains("yaw"));
        assert!(error("image: a\nresolution: 0.1\norigin: [0, 0]\n").contains("[x, y, yaw]"));
        assert!(error("image: a\nresolution: -0.1\norigin: [0, 0, 0]\n").contains("positive"));
    }
}
