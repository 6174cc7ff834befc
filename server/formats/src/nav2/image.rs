//! Pixels to cells and back.

use super::{FORMAT, GridMap, MapYaml, Mode, turned};
use crate::images::{Shades, decode_png_shades, encode_png_la8};
use crate::{FormatError, Limits, pgm};
use percept_geometry::{GeometryError, GrayImage, GridGeometry};
use std::io::Write;

/// What `map_saver` draws: free, occupied, unknown.
const FREE: u8 = 254;
const OCCUPIED: u8 = 0;
const UNKNOWN: u8 = 205;

/// Kind of the image beside the YAML file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageKind {
    /// Grey of 8 bits, not packed.
    Pgm,
    /// Grey of 8 bits, packed; in [`Mode::Scale`] with transparency.
    Png,
}

/// The grid that a YAML file and its image (PGM or PNG) make. The image alone says how large it is.
///
/// Colours count by their mean, transparency as nav2 has it: in trinary one more channel, in scale unknown. A map whose
/// origin is turned comes back along the frame's axes, each cell with the largest value that it touches: walls may be thicker
/// by a cell, none has a gap.
///
/// # Errors
/// Those of [`pgm::decode`] and [`crate::images::decode_gray16`]; `TooLarge` for a turned map whose corners lie too far apart.
pub fn decode(yaml: &MapYaml, image: &[u8], limits: &Limits) -> Result<GridMap, FormatError> {
    let shades = if image.starts_with(b"\x89PNG") {
        decode_png_shades(image, limits)?
    } else {
        let pgm = pgm::decode(image, limits)?;
        Shades {
            width: pgm.width,
            height: pgm.height,
            white: pgm.max_value,
            channels: 1,
            has_alpha: false,
            data: pgm.data,
        }
    };
    let (width, height) = (shades.width, shades.height);
    let mut cells = Vec::with_capacity(width.saturating_mul(height));
    if width > 0 {
        for row in shades.data.chunks_exact(width * shades.channels).rev() {
            cells.extend(row.chunks_exact(shades.channels).map(|pixel| cell(yaml, &shades, pixel)));
        }
    }
    let geometry = GridGeometry::new(yaml.resolution_m, yaml.origin);
    let map = GridMap { geometry, width, height, cells };
    if yaml.yaw_rad == 0.0 { Ok(map) } else { turned::along_axes(&map, yaml.yaw_rad, limits) }
}

/// A pixel's meaning, as `loadMapFromFile` of nav2 has it.
fn cell(yaml: &MapYaml, shades: &Shades, pixel: &[u16]) -> i8 {
    let (colors, alpha) = pixel.split_at(pixel.len() - usize::from(shades.has_alpha));
    let averaged = if yaml.mode == Mode::Trinary { pixel } else { colors };
    let sum: f64 = averaged.iter().copied().map(f64::from).sum();
    let shade = sum / averaged.len() as f64 / f64::from(shades.white);
    let occupancy = if yaml.negate { shade } else { 1.0 - shade };
    match yaml.mode {
        Mode::Raw => {
            let value = (shade * 255.0).round();
            if value <= 100.0 { value as i8 } else { -1 }
        }
        Mode::Scale if alpha.iter().any(|&a| a < shades.white) => -1,
        _ if occupancy > yaml.occupied_thresh => 100,
        _ if occupancy < yaml.free_thresh => 0,
        Mode::Trinary => -1,
        Mode::Scale => {
            let span = (yaml.occupied_thresh - yaml.free_thresh).max(f64::EPSILON);
            (100.0 * (occupancy - yaml.free_thresh) / span).round_ties_even().clamp(0.0, 100.0) as i8
        }
    }
}

/// Bytes of the image of a map; [`super::write_yaml_of`] writes what belongs beside it.
///
/// Trinary keeps free (up to 25), occupied (from 65) and unknown (between, and -1). Raw and scale keep all 102 values.
///
/// # Errors
/// `Geometry` if `cells` does not hold `width * height` values; `Unsupported` for scale as PGM, which has no transparency
/// to say unknown with; `Image` for a PNG without pixels.
pub fn encode_image(map: &GridMap, mode: Mode, kind: ImageKind) -> Result<Vec<u8>, FormatError> {
    let pixels = |pixel: fn(i8) -> u8| rows_from_above(map).flatten().map(|&c| pixel(c)).collect::<Vec<u8>>();
    check_cells(map)?;
    match (mode, kind) {
        (Mode::Scale, ImageKind::Pgm) => {
            let (field, value, supported) = ("image of mode scale", "PGM".to_owned(), "PNG: it has transparency");
            Err(FormatError::Unsupported { format: FORMAT, field, value, supported })
        }
        (Mode::Scale, ImageKind::Png) => {
            let known = |c: i8| (0..=100).contains(&c);
            let shade = |c: i8| (f64::from(100 - c) * 2.55).round() as u8;
            let pixel = |&c: &i8| if known(c) { [shade(c), 255] } else { [UNKNOWN, 0] };
            let pixels: Vec<[u8; 2]> = rows_from_above(map).flatten().map(pixel).collect();
            encode_png_la8(map.width, map.height, pixels.as_flattened())
        }
        (_, ImageKind::Png) => {
            let image = GrayImage::new(map.width, map.height, pixels(gray(mode)))?;
            crate::images::encode_gray_png(&image)
        }
        (_, ImageKind::Pgm) => {
            let mut out = pgm_header(map).into_bytes();
            out.extend(pixels(gray(mode)));
            Ok(out)
        }
    }
}

/// Writes the image of a map, trinary: 254 free (up to 25), 0 occupied (from 65), 205 unknown (between, and -1).
///
/// # Errors
/// `Geometry` if `cells` does not hold `width * height` values; `Write` if the writer refuses.
pub fn write_pgm(out: &mut impl Write, map: &GridMap) -> Result<(), FormatError> {
    check_cells(map)?;
    out.write_all(pgm_header(map).as_bytes())?;
    for row in rows_from_above(map) {
        out.write_all(&row.iter().map(|&c| trinary(c)).collect::<Vec<u8>>())?;
    }
    Ok(())
}

pub(crate) fn check_cells(map: &GridMap) -> Result<(), FormatError> {
    let (expected, actual) = (map.width.saturating_mul(map.height), map.cells.len());
    let mismatch = GeometryError::ShapeMismatch { field: "cells", expected, actual };
    if actual == expected { Ok(()) } else { Err(mismatch.into()) }
}

/// Rows as images have them: the one with the largest y first.
pub(crate) fn rows_from_above(map: &GridMap) -> impl Iterator<Item = &[i8]> {
    map.cells.chunks_exact(map.width.max(1)).rev()
}

fn pgm_header(map: &GridMap) -> String {
    format!("P5\n# resolution {} m\n{} {}\n255\n", map.geometry.resolution_m, map.width, map.height)
}

fn gray(mode: Mode) -> fn(i8) -> u8 {
    if mode == Mode::Raw { raw } else { trinary }
}

fn trinary(cell: i8) -> u8 {
    match cell {
        0..=25 => FREE,
        65..=100 => OCCUPIED,
        _ => UNKNOWN,
    }
}

fn raw(cell: i8) -> u8 {
    u8::try_from(cell).ok().filter(|&c| c <= 100).unwrap_or(u8::MAX)
}
