//! A path that passes a tool over all that a robot can reach: cleaning, mowing, searching.
//!
//! Comes in: a map, where the robot stands, its footprint, and how wide its tool is. Goes out: a [`CoveragePath`]: lanes to and
//! fro through one region after the other, the ways between, and touches of what is left along walls. Start with
//! [`plan_coverage`].
//!
//! Source: Choset and Pignon, "Coverage path planning: the boustrophedon cellular decomposition", 1997, on the grid of places
//! where the robot fits: a region begins and ends where a row's stretch of free cells splits, joins, begins or ends
//! (`lanes.rs`). We depart from it: the next region is the nearest one, not the next of a depth-first walk, and what the lanes
//! have left is looked for and touched (`sweep.rs`), as regions on a grid have ragged borders.

mod lanes;
mod nearest;
mod params;
mod request;
mod sweep;
mod tool;

pub use params::{CoverageDirection, CoverageParams};
pub use request::{CoverageLeg, CoverageOutcome, CoveragePath, plan_coverage};
pub use sweep::CoverageLegKind;
