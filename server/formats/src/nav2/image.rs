//! Pixels to cells and back.

use super::{GridMap, MapYaml, Mode};
use crate::images::Gray16;
use crate::{FormatError, Limits, pgm};
use percept_geometry::{GeometryError, GridGeometry};
use std::io::Write;

/// What `map_saver` draws: free, occupied, unknown.
const FREE: u8 = 254;
const OCCUPIED: u8 = 0;
const UNKNOWN: u8 = 205;

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
