//! Residuals of one correspondence, each with its Jacobian, one a file.
//!
//! `t_target_source * exp(xi)` takes a source point to the target; Jacobians are with respect to xi at 0,
//! translation first.

pub mod point_to_plane;
pub mod point_to_point;
