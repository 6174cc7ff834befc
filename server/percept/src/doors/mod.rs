//! Three doors to one house: gRPC, REST, zenoh, and a way in for robots on ROS 2. They decode, call an operation, encode, and
//! nothing more.
//!
//! gRPC and REST share a [`listener`]; what clients may take of the server is counted in [`bounds`].

pub(crate) mod bounds;
pub(crate) mod grpc;
pub(crate) mod identify;
pub(crate) mod listener;
pub(crate) mod rest;
mod results;
pub(crate) mod ros2;
pub(crate) mod status;
pub(crate) mod zenoh;
