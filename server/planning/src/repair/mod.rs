//! Paths to one goal over a map that changes, by a search that is kept.
//!
//! Comes in: a grid once, then the cells that changed, and where the robot is by now. Goes out: each time a path as cheap as one
//! found from scratch. [`RepairingPlanner`] works on cells; [`RepairedRoute`] on maps, with the robot's footprint, and is where
//! to start. Changes near the robot are repaired with little work; those near the goal may touch all that was searched.

mod planner;
mod queue;
mod route;

pub use planner::RepairingPlanner;
pub use route::RepairedRoute;
