//! The map layers against closed forms and brute force.

mod cloud;
mod map;
mod occupancy;
mod scans;
