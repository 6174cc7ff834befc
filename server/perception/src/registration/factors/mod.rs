//! Residuals of one correspondence, each with its Jacobian, one a file.
//!
//! `t_target_source * exp(xi)` takes a source point to the target; Jacobians are with respect to xi at 0,
//! translation first. [`point_to_plane`] and [`point_to_point`] give rows; [`gicp`] gives the information that a
//! pair's difference is weighted by, which [`PairBlock`](super::PairBlock) sums.

pub mod colored;
pub mod gicp;
pub mod point_to_plane;
pub mod point_to_point;
