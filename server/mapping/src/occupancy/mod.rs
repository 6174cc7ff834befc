//! Where the floor is free and where something stands: unbounded 2D grids of log-odds.
//!
//! A keyframe becomes a [`ScanUpdate`] (which cells it saw free or hit, each once), and the update is added to the
//! [`OccupancyGrid`] of its submap. [`OccupancyMap`] is the grid of the whole map, which lays those of the submaps over each
//! other; [`Occupancy`] reads either. [`DenseGrid`] is the rectangle of ROS values that leaves the crate.

mod beams;
mod columns;
mod compose;
mod dense;
mod driven;
mod evidence;
mod fan;
mod grid;
mod kinds;
mod lean;
mod mark;
mod marks;
mod params;
mod planar;
mod read;
mod tile;
mod update;

pub use compose::{OccupancyMap, OccupancyTile};
pub use dense::DenseGrid;
pub use grid::OccupancyGrid;
pub use marks::ScanUpdate;
pub use params::OccupancyParams;
pub use read::{Occupancy, Visit};
pub(crate) use read::{TILE, locate, overlap};
