//! Where the floor is free and where something stands: an unbounded 2D grid of log-odds.
//!
//! A keyframe becomes a [`ScanUpdate`] (which cells it saw free or hit, each once), and the update is added
//! to the [`OccupancyGrid`]. [`DenseGrid`] is the rectangle of ROS values that leaves the crate.

mod dense;
mod grid;
mod params;
mod update;

pub use dense::DenseGrid;
pub use grid::OccupancyGrid;
pub use params::OccupancyParams;
pub use update::ScanUpdate;
