//! A map that was given, as views of it: what a sensor would see of it from places all over it.
//!
//! The map of a session is what its keyframes have seen. So a map that comes from elsewhere becomes keyframes: from there on it is
//! a map like any other, planned in, recognised, corrected, stored and exported by the same code. [`views_of_grid`] looks at an
//! occupancy grid as a planar lidar does, [`views_of_space`] at occupied space as a lidar in space does.

mod grid;
mod lattice;
mod look;
mod rest;
mod space;
#[cfg(test)]
mod tests;

pub use grid::views_of_grid;
pub use look::views_of_space;
pub use space::GivenSpace;

use nalgebra::Point3;
use percept_geometry::{KeyframeScan, PointCloud, Pose, SensorId, Timestamp};

/// The sensor that is said to have seen what was given. No sensor can be declared by this name: a colon stands in none.
pub const GIVEN_SENSOR: &str = "map:given";

/// The same, of what is added so that the map is all that was given: seen from where no robot is, by no pattern of a sensor. Nobody is
/// found by it.
pub const GIVEN_REST_SENSOR: &str = "map:given:rest";

/// Whether a keyframe of this sensor is a view of a map that was given.
pub fn is_given(sensor: &SensorId) -> bool {
    is_recognised(sensor) || sensor.0 == GIVEN_REST_SENSOR
}

/// Whether a robot may be found by a keyframe of this sensor, which is a view of a map that was given.
pub fn is_recognised(sensor: &SensorId) -> bool {
    sensor.0 == GIVEN_SENSOR
}

/// What can be seen of a given map from a place of it.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenView {
    /// Base to the map that was given: upright, on its ground.
    pub t_map_base: Pose,
    /// What is seen.
    pub scan: KeyframeScan,
}

/// How a given map is looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GivenOptions {
    /// How far is seen, metres.
    pub range_max_m: f64,
    /// How high above the ground the sensor is, metres: beams of a planar lidar clear away only what stands at their height.
    pub sensor_height_m: f64,
}

/// Views of a given map, and how much of it they show.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenViews {
    /// In an order in which those near each other follow on each other.
    pub views: Vec<GivenView>,
    /// Share of its occupied cells, or of its points, that are seen, 0 to 1: what lies inside of walls is not.
    pub occupied_share: f64,
    /// Share of its free cells that are seen, 0 to 1; 1 if nothing is said to be free.
    pub free_share: f64,
}

/// A view from a place at which base stands, by ends of beams in the given map.
fn view(
    at: Point3<f64>,
    options: &GivenOptions,
    sensor: &str,
    planar: bool,
    (hits, misses): (PointCloud, Vec<Point3<f64>>),
) -> GivenView {
    let t_map_base = Pose::from_parts(at.coords.into(), nalgebra::UnitQuaternion::identity());
    let in_base = |p: &Point3<f64>| Point3::from(p - at).cast::<f32>();
    let scan = KeyframeScan {
        stamp: Timestamp::default(),
        sensor: SensorId(sensor.to_owned()),
        t_base_sensor: Pose::translation(0.0, 0.0, options.sensor_height_m),
        base_height_m: 0.0,
        hits,
        misses: misses.iter().map(in_base).collect(),
        planar,
        features: None,
    };
    GivenView { t_map_base, scan }
}
