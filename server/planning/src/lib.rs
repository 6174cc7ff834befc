//! A map and two poses in; a path, or the reason for none, out.
//!
//! Comes in: an [`Occupancy`](percept_mapping::Occupancy) (or a [`DenseGrid`](percept_mapping::DenseGrid) cut
//! from one), and a [`PathRequest`] in its frame: two ends, a footprint, zones, and by which [`Planner`]. Goes out:
//! [`PlanOutcome`]: waypoints with their times, cost and clearance, or a [`NoPathReason`] and what is in the way. Nothing
//! here follows the path, or watches a clock. Start with [`plan()`] for a disc from point to point, with [`plan_path`] for
//! all else. Further questions: ever better paths while there is time ([`anytime`]), a path that is repaired as the map changes
//! ([`repair`]), one that covers all that is reached ([`coverage`]), paths in space ([`flight`]), and where to go to see more
//! ([`frontiers`]).

mod along;
mod answer;
pub mod anytime;
pub mod astar;
mod bits;
mod blocking;
mod by_cells;
pub mod costmap;
pub mod coverage;
mod ends;
mod fit;
pub mod flight;
mod flood;
mod footprint;
mod frontier;
mod hybrid;
mod jump;
mod params;
mod plan;
mod polygon;
mod pose2;
mod queue;
pub mod repair;
mod request;
pub mod smooth;
mod speed;
pub mod steering;
pub mod theta;
mod validate;
mod waypoint;
mod zones;

pub use along::{PathSample, samples_along};
pub use answer::{Blocking, CostParts, NoPathReason, Path, PlanOutcome};
pub use anytime::{AnytimeParams, plan_anytime};
pub use astar::{GridPath, SearchGrid};
pub use costmap::{CellState, Costmap};
pub use coverage::{CoverageOutcome, CoverageParams, CoveragePath, plan_coverage};
pub use footprint::Footprint;
pub use frontier::{Frontier, frontiers, rank_frontiers};
pub use hybrid::HybridParams;
pub use jump::{jump_point_search, shortest_path};
pub use params::PlanParams;
pub use plan::{plan, plan_dense, plan_over, plan_path};
pub use pose2::Pose2;
pub use repair::{RepairedRoute, RepairingPlanner};
pub use request::{Goal, PathRequest, Planner};
pub use speed::SpeedLimits;
pub use validate::{Misfit, MisfitReason, validate_path};
pub use waypoint::Waypoint;
pub use zones::{Mask, MaskKind, Zone, ZoneKind};

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
