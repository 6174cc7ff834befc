//! Three doors to one house: gRPC, REST, zenoh. They decode, call an operation, encode, and nothing more.

pub(crate) mod grpc;
pub(crate) mod rest;
pub(crate) mod status;
pub(crate) mod zenoh;
