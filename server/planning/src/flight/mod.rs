//! Paths in space, for what flies.
//!
//! Comes in: a box of voxels ([`DenseVoxels`], cut from a [`VoxelMap`](percept_mapping::VoxelMap) or filled by the caller)
//! and a [`FlightRequest`]: two positions, a robot that is a ball, and zones that it keeps out of, columns from the floor up. Goes
//! out: [`FlightOutcome`]: corners joined by straight legs along which the ball touches nothing, or why there are none. Headings,
//! speeds and a body that is no ball are not
//! looked at. Start with [`plan_flight`].

mod clearance;
mod ends;
mod field;
mod keep_out;
mod lattice;
mod params;
mod plan;
mod request;
mod sight;
mod soon;
mod theta;
mod voxels;

pub use ends::FlightBlocking;
pub use params::{FlightParams, FlightPlanner};
pub use plan::{FlightOutcome, FlightPath, plan_flight};
pub use request::FlightRequest;
pub use voxels::DenseVoxels;
