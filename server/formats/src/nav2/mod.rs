//! Occupancy grids as nav2's and ROS 1's `map_server` keep them: an image and a YAML file beside it.
//!
//! Source: the documentation of nav2's map server. Pixels are darker where occupied; the image's first row
//! is the one with the largest y.

mod image;
mod yaml;

use crate::{FormatError, Limits};
use nalgebra::Point2;
use percept_geometry::GridGeometry;
use std::path::Path;

pub use image::{decode, write_pgm};
pub use yaml::{parse_yaml, write_yaml};

const FORMAT: &str = "nav2 map";

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

/// Reads a map from its YAML file and the image that it names.
///
/// # Errors
/// `Io`, and those of [`parse_yaml`] and [`decode`] with the file's name.
pub fn read(yaml_path: &Path, limits: &Limits) -> Result<GridMap, FormatError> {
    let yaml = parse_yaml(&crate::read_file(yaml_path, limits)?).map_err(|e| e.in_file(yaml_path))?;
    let image_path = yaml_path.parent().unwrap_or(Path::new("")).join(&yaml.image);
    decode(&yaml, &crate::read_file(&image_path, limits)?, limits).map_err(|e| e.in_file(&image_path))
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
