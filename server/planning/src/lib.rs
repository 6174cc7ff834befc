//! A map and two poses in; a path, or the reason for none, out.
//!
//! Comes in: an [`Occupancy`](percept_mapping::Occupancy) (or a [`DenseGrid`](percept_mapping::DenseGrid) cut
//! from one), start and goal in its frame. Goes out: [`PlanOutcome`]: waypoints with their cost and clearance, or a
//! [`NoPathReason`]. The robot is a disc; nothing here follows the path. Start with [`plan()`].

mod answer;
pub mod astar;
mod bits;
pub mod costmap;
mod distance;
mod ends;
mod fit;
mod flood;
mod footprint;
mod hybrid;
mod jump;
mod params;
mod plan;
mod queue;
mod request;
pub mod smooth;
pub mod steering;
pub mod theta;

pub use answer::{NoPathReason, Path, PlanOutcome, Waypoint};
pub use astar::{GridPath, SearchGrid};
pub use costmap::Costmap;
pub use distance::clearance_in_cells;
pub use footprint::Footprint;
pub use hybrid::HybridParams;
pub use jump::shortest_path;
pub use params::PlanParams;
pub use plan::{plan, plan_dense, plan_over, plan_path};
pub use request::{Goal, PathRequest, Planner, Pose2};

/// Why planning could not be tried: the facts.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// A parameter is out of its bounds.
    #[error("{field}: {value} is refused, {remedy}")]
    InvalidParam {
        /// Field name.
        field: &'static str,
        /// The value as given.
        value: f64,
        /// What to set instead.
        remedy: &'static str,
    },
    /// A coordinate is NaN or infinite.
    #[error("{field}: {value} is not finite")]
    NotFinite {
        /// `start` or `goal`.
        field: &'static str,
        /// The coordinate as given.
        value: f64,
    },
    /// The map has more cells than may be searched.
    #[error("map of {cells} cells is larger than the limit of {limit}")]
    GridTooLarge {
        /// Cells of the map.
        cells: u64,
        /// Cells allowed.
        limit: u64,
    },
    /// The map is not a sound grid.
    #[error(transparent)]
    Map(percept_mapping::MappingError),
}
