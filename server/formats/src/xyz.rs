//! Points as text, a line each: `x y z`, `x y z intensity`, `x y z r g b`, or `x y z r g b nx ny nz`.
//!
//! Numbers are parted by blanks, commas or semicolons; lines from `#` or `//` on are comments, and a first line of names
//! is stepped over. There is no standard: this is what CloudCompare, Open3D and spreadsheets write. Colours are 0..255;
//! if every one in the file lies within 0..1 and one is broken, they are shares of 255.

use crate::layout::unit_or_zero;
use crate::text::{Line, Lines, parse};
use crate::{FormatError, Limits};
use nalgebra::{Point3, Vector3};
use percept_geometry::PointCloud;

const FORMAT: &str = "XYZ";
/// Most columns that are understood.
const MAX_COLUMNS: usize = 9;
/// Coordinates beyond this (m) make the decoder state an origin: f32 steps by 2 mm there.
const FAR_M: f64 = 16384.0;

/// A cloud from a text of points, and the origin (m) that its positions are relative to.
///
/// The origin is zero unless a coordinate exceeds 16384 m; then it is the first point in whole metres, so that map
/// coordinates (UTM) lose nothing that f32 can hold near the points.
///
/// # Errors
/// `Malformed` naming the line (not a number, another number of columns than the first line), `Unsupported` (columns
/// other than 3, 4, 6 or 9), `TooLarge`.
pub fn decode(bytes: &[u8], limits: &Limits) -> Result<(PointCloud, [f64; 3]), FormatError> {
    let mut rows: Vec<[f64; 3]> = vec![];
    let mut rest: Vec<f32> = vec![];
    let mut columns = 0;
    let mut heading = None;
    for line in Lines::new(FORMAT, bytes).contents().filter(|l| !l.bytes.trim_ascii_start().starts_with(b"//")) {
        let mut row = [0.0; MAX_COLUMNS];
        if columns == 0 && heading.is_none() && is_heading(&line) {
            heading = Some(line);
            continue;
        }
        let found = numbers(&line, &mut row)?;
        if columns == 0 {
            columns = supported(found)?;
        } else if found != columns {
            let text = format!("{found} columns");
            return Err(line.malformed("row", text.as_bytes(), "as many columns as in the first row"));
        }
        limits.points(rows.len() as u64 + 1)?;
        rows.push([row[0], row[1], row[2]]);
        rest.extend(row[3..columns].iter().map(|&v| v as f32));
    }
    // A table without rows is an empty cloud; words are none.
    if rows.is_empty()
        && let Some(words) = heading.filter(|h| !tokens(h).any(|t| t.eq_ignore_ascii_case(b"x")))
    {
        return Err(words.malformed("row", words.bytes, "numbers: x y z, and what else is known of a point"));
    }
    let origin = origin(&rows);
    let local = |p: &[f64; 3]| Point3::from([0, 1, 2].map(|k| (p[k] - origin[k]) as f32));
    let mut cloud = PointCloud::from_positions(rows.iter().map(local).collect());
    add_channels(&mut cloud, columns, &rest);
    Ok((cloud, origin))
}

fn supported(columns: usize) -> Result<usize, FormatError> {
    match columns {
        3 | 4 | 6 | 9 => Ok(columns),
        _ => Err(FormatError::Unsupported {
            format: FORMAT,
            field: "number of columns",
            value: columns.to_string(),
            supported: "3 (x y z), 4 (intensity), 6 (r g b) and 9 (r g b nx ny nz)",
        }),
    }
}

fn tokens<'a>(line: &Line<'a>) -> impl Iterator<Item = &'a [u8]> + use<'a> {
    let is_gap = |b: &u8| b.is_ascii_whitespace() || matches!(b, b',' | b';');
    line.bytes.split(is_gap).filter(|t| !t.is_empty())
}

/// Whether no field of a line is a number: names of columns.
fn is_heading(line: &Line<'_>) -> bool {
    tokens(line).all(|t| parse::<f64>(t).is_none())
}

/// Fills `row`, and tells how many columns there are.
fn numbers(line: &Line<'_>, row: &mut [f64; MAX_COLUMNS]) -> Result<usize, FormatError> {
    let mut found = 0;
    for token in tokens(line) {
        let value = parse::<f64>(token).ok_or_else(|| line.malformed("row", token, "a number"))?;
        if let Some(slot) = row.get_mut(found) {
            *slot = value;
        }
        found += 1;
    }
    Ok(found)
}

/// See [`decode`].
pub(crate) fn origin(rows: &[[f64; 3]]) -> [f64; 3] {
    let far = rows.iter().flatten().any(|v| v.is_finite() && v.abs() > FAR_M);
    let first = rows.iter().find(|p| p.iter().all(|v| v.is_finite()));
    first.filter(|_| far).map_or([0.0; 3], |p| p.map(f64::floor))
}

fn add_channels(cloud: &mut PointCloud, columns: usize, rest: &[f32]) {
    match columns {
        4 => cloud.intensities = Some(rest.to_vec()),
        6 | 9 => {
            let rows = || rest.chunks_exact(columns - 3);
            let colors = || rows().flat_map(|r| &r[..3]);
            let shares = colors().all(|v| (0.0..=1.0).contains(v)) && colors().any(|v| v.fract() != 0.0);
            let scale = if shares { 255.0 } else { 1.0 };
            cloud.colors = Some(rows().map(|r| [0, 1, 2].map(|k| (r[k] * scale).round() as u8)).collect());
            if columns == 9 {
                cloud.normals = Some(rows().map(|r| unit_or_zero(Vector3::new(r[3], r[4], r[5]))).collect());
            }
        }
        _ => {}
    }
}

/// Text of a cloud whose positions are relative to `origin` (m): x y z, then r g b and nx ny nz (normals come with
/// colours; black where there are none), else the intensity. Time offsets are left out.
///
/// # Errors
/// `Geometry` if a channel has another length than the positions.
pub fn encode(cloud: &PointCloud, origin: [f64; 3]) -> Result<Vec<u8>, FormatError> {
    use std::io::Write;
    cloud.validate()?;
    let mut out = Vec::with_capacity(cloud.len() * 32);
    let has_color = cloud.colors.is_some() || cloud.normals.is_some();
    let at_home = origin == [0.0; 3];
    for (i, p) in cloud.positions.iter().enumerate() {
        if at_home {
            write!(out, "{} {} {}", p.x, p.y, p.z)?;
        } else {
            let far = [0, 1, 2].map(|k| f64::from(p[k]) + origin[k]);
            write!(out, "{} {} {}", far[0], far[1], far[2])?;
        }
        if has_color {
            let [r, g, b] = cloud.colors.as_ref().map_or([0; 3], |c| c[i]);
            write!(out, " {r} {g} {b}")?;
        } else if let Some(intensities) = &cloud.intensities {
            write!(out, " {}", intensities[i])?;
        }
        if let Some(normals) = &cloud.normals {
            write!(out, " {} {} {}", normals[i].x, normals[i].y, normals[i].z)?;
        }
        out.push(b'\n');
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str) -> Result<(PointCloud, [f64; 3]), FormatError> {
        decode(text.as_bytes(), &Limits::default())
    }

    #[test]
    fn commas_comments_and_headings_are_understood() {
        let (cloud, origin) = read("// by hand\n# x\nX,Y;Z\n1, 2,3\n\n4\t5;6\r\n").unwrap();
        assert_eq!(cloud.positions, [Point3::new(1.0, 2.0, 3.0), Point3::new(4.0, 5.0, 6.0)]);
        assert_eq!(origin, [0.0; 3]);
        assert_eq!(read("1 2 3 0.5 0 1\n").unwrap().0.colors.unwrap(), [[128, 0, 255]]);
        assert_eq!(read("").unwrap().0.len(), 0);
    }

    #[test]
    fn map_coordinates_keep_their_millimetres() {
        let (cloud, origin) = read("500123.456 5400000.001 12.5\n500124.457 5400001.002 13.5\n").unwrap();
        assert_eq!(origin, [500_123.0, 5_400_000.0, 12.0]);
        let y = f64::from(cloud.positions[1].y) + origin[1];
        assert!((y - 5_400_001.002).abs() < 1e-6);
    }

    #[test]
    fn errors_name_the_line() {
        assert_eq!(read("1 2 3\n1 2 drei\n").unwrap_err().to_string(), "XYZ, line 2: row is 'drei', expected a number");
        assert!(matches!(read("1 2 3\n1 2\n"), Err(FormatError::Malformed { .. })));
        let words = "XYZ, line 1: row is 'hello world', expected numbers: x y z, and what else is known of a point";
        assert_eq!(read("hello world").unwrap_err().to_string(), words);
        assert!(matches!(read("dear all,\nwords in two lines\n1 2 3\n"), Err(FormatError::Malformed { .. })));
        // A table without rows.
        assert_eq!(read("X, Y, Z, intensity\n").unwrap().0.len(), 0);
        assert!(matches!(read("1 2\n"), Err(FormatError::Unsupported { .. })));
        let tight = Limits { max_points: 1, ..Limits::default() };
        assert!(matches!(decode(b"1 2 3\n1 2 3\n", &tight), Err(FormatError::TooLarge { .. })));
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back(
            values in prop::collection::vec((-1e4f32..1e4, 0u8..=255, 0f32..1.0), 0..40), kind in 0usize..4
        ) {
            let mut cloud = PointCloud::from_positions(values.iter().map(|v| Point3::new(v.0, -v.0, v.2)).collect());
            let color = |v: &(f32, u8, f32)| [v.1, 7, 255 - v.1];
            match kind {
                1 => cloud.intensities = Some(values.iter().map(|v| v.2).collect()),
                2 => cloud.colors = Some(values.iter().map(color).collect()),
                3 => {
                    cloud.colors = Some(values.iter().map(color).collect());
                    cloud.normals = Some(values.iter().map(|v| Vector3::new(v.2, 1.0, -v.2).normalize()).collect());
                }
                _ => {}
            }
            // An empty text has no columns.
            if cloud.is_empty() { cloud = PointCloud::default(); }
            let text = encode(&cloud, [0.0; 3]).unwrap();
            prop_assert_eq!(decode(&text, &Limits::default()).unwrap().0, cloud);
        }
    }
}
