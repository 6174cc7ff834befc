//! GeoTIFF and world files: an occupancy grid where GIS software finds it, out.
//!
//! Source: Adobe, "TIFF Revision 6.0", 1992; OGC 19-008r4, "GeoTIFF Standard 1.1". The frame is local, in metres: the file
//! names it and says nothing of where on Earth it lies. Rows begin with the largest y, as images do. Nothing is read here.

mod tags;

use crate::nav2::{GridMap, check_cells, rows_from_above};
use crate::{FormatError, Place};
use percept_geometry::GridGeometry;
use tags::Tags;

const FORMAT: &str = "GeoTIFF";

/// The value of cells that are unknown.
pub const UNKNOWN: u8 = 255;

/// Bytes of a strip before it is packed, about: readers keep one at a time.
const STRIP_BYTES: usize = 1 << 16;

/// Bytes of a GeoTIFF of one band of 8 bits: 0 free … 100 occupied, [`UNKNOWN`] where nothing is known (the file's `nodata`).
///
/// `frame` names the coordinate system, of kind local, with metres along x and y; cells are areas. Packed by PackBits, which
/// every reader of TIFF knows.
///
/// # Errors
/// `Geometry` if `cells` does not hold `width * height` values; `Malformed` for a map without cells, or a frame that is not
/// printable ASCII; `TooLarge` beyond the 4 GiB or 2^32 cells a side that the format holds.
pub fn encode(map: &GridMap, frame: &str) -> Result<Vec<u8>, FormatError> {
    check_cells(map)?;
    let wrong = |field, found: &str, expected| {
        FormatError::malformed(FORMAT, Place::Byte(0), field, found.as_bytes(), expected)
    };
    if map.cells.is_empty() {
        return Err(wrong("size", &format!("{} x {}", map.width, map.height), "one cell or more"));
    }
    // '|' parts one text from the next.
    if frame.is_empty() || !frame.bytes().all(|b| matches!(b, b' '..=b'~') && b != b'|') {
        return Err(wrong("frame", frame, "printable ASCII without '|'"));
    }
    let (width, height) = (size(map.width)?, size(map.height)?);
    let rows_per_strip = STRIP_BYTES.div_ceil(map.width).min(map.height);
    let strips = strips(map, rows_per_strip);
    let geometry = &map.geometry;
    let top = geometry.origin.y + map.height as f64 * geometry.resolution_m;

    let mut tags = Tags::default();
    tags.longs(256, &[width]);
    tags.longs(257, &[height]);
    tags.shorts(258, &[8]);
    tags.shorts(259, &[PACK_BITS]);
    // The smallest value is black.
    tags.shorts(262, &[1]);
    tags.strips(273);
    tags.shorts(277, &[1]);
    tags.longs(278, &[size(rows_per_strip)?]);
    tags.longs(279, &strips.iter().map(|s| size(s.len())).collect::<Result<Vec<u32>, _>>()?);
    tags.text(305, "percept");
    // ModelPixelScale, ModelTiepoint (the upper left corner of the first pixel), GeoKeyDirectory, GeoAsciiParams.
    tags.doubles(33550, &[geometry.resolution_m, geometry.resolution_m, 0.0]);
    tags.doubles(33922, &[0.0, 0.0, 0.0, geometry.origin.x, top, 0.0]);
    tags.shorts(34735, geo_keys(frame.len()).as_flattened());
    tags.text(34737, &format!("{frame}|"));
    // GDAL's own.
    tags.text(42113, &UNKNOWN.to_string());
    tags.file(&strips)
}

/// TIFF's number of PackBits.
const PACK_BITS: u16 = 32773;

/// Version 1.1.0 and four keys: a model of the user's own, pixels that are areas, its name, metres.
fn geo_keys(frame_bytes: usize) -> [[u16; 4]; 5] {
    let citation_bytes = u16::try_from(frame_bytes + 1).unwrap_or(u16::MAX);
    [[1, 1, 0, 4], [1024, 0, 1, 32767], [1025, 0, 1, 1], [1026, 34737, citation_bytes, 0], [3076, 0, 1, 9001]]
}

/// The six lines of the world file (`.pgw` beside a PNG, `.wld`) of a grid of `height` rows.
///
/// Source: ESRI, "World files for raster datasets": width of a pixel, two turns, minus its height, then x and y of the centre
/// of the upper left one, metres.
pub fn world_file(geometry: &GridGeometry, height: usize) -> String {
    let edge = geometry.resolution_m;
    let (x, y) = (geometry.origin.x + 0.5 * edge, geometry.origin.y + (height as f64 - 0.5) * edge);
    format!("{edge:?}\n0.0\n0.0\n{:?}\n{x:?}\n{y:?}\n", -edge)
}

fn size(value: usize) -> Result<u32, FormatError> {
    let (value, limit) = (value as u64, u64::from(u32::MAX));
    u32::try_from(value).map_err(|_| FormatError::TooLarge { field: "num_bytes", value, limit })
}

/// The packed rows, so many in each strip.
fn strips(map: &GridMap, rows_per_strip: usize) -> Vec<Vec<u8>> {
    let mut strips = vec![];
    for (i, row) in rows_from_above(map).enumerate() {
        if i % rows_per_strip == 0 {
            strips.push(vec![]);
        }
        let values: Vec<u8> = row.iter().map(|&c| if (0..=100).contains(&c) { c as u8 } else { UNKNOWN }).collect();
        if let Some(strip) = strips.last_mut() {
            pack_row(&values, strip);
        }
    }
    strips
}

/// PackBits (TIFF 6.0, section 9): a run as one byte `1 - length` and its value, other bytes after `length - 1`.
fn pack_row(row: &[u8], out: &mut Vec<u8>) {
    let mut others: &[u8] = &[];
    let mut rest = row;
    while let Some(&first) = rest.first() {
        let run = rest.iter().take(128).take_while(|&&v| v == first).count();
        // A run of two within others would not make the row shorter.
        let is_run = run > 2 || (run == 2 && others.is_empty());
        let step = if is_run { run } else { 1 };
        if !is_run {
            others = &row[row.len() - rest.len() - others.len()..][..others.len() + 1];
        }
        rest = &rest[step..];
        if is_run || others.len() == 128 || rest.is_empty() {
            if let Some(last) = others.len().checked_sub(1) {
                out.push(last as u8);
                out.extend(others);
                others = &[];
            }
            if is_run {
                out.extend([(1i16 - run as i16) as u8, first]);
            }
        }
    }
}

#[cfg(test)]
mod tests;
