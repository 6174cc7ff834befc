//! Occupancy grids as nav2's and ROS 1's `map_server` keep them: an image and a YAML file beside it.
//!
//! Source: the documentation of nav2's map server, and for rounding and transparency what its `map_io` does. Pixels are
//! darker where occupied; the image's first row is the one with the largest y.

mod image;
mod turned;
mod yaml;

use crate::{FormatError, Limits};
use nalgebra::Point2;
use percept_geometry::GridGeometry;
use std::path::Path;

pub use image::{ImageKind, decode, encode_image, write_pgm};
pub(crate) use image::{check_cells, rows_from_above};
pub use yaml::{parse_yaml, write_yaml, write_yaml_of};

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
    /// Between the thresholds a share from 0 to 100; transparent is unknown.
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
    /// How far the map is turned about that corner, radians, counter-clockwise.
    pub yaw_rad: f64,
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
mod tests;
