//! Names that ROS allows for sensors of any name.
//!
//! Source: ROS 2 design, "Topic and Service name mapping to DDS": letters, digits and single underscores, no digit first.

use percept_geometry::SensorId;
use std::collections::{BTreeMap, BTreeSet};

/// Frames that are not a sensor's: those that the recording has itself, and those that readers take for the robot's.
const TAKEN: [&str; 6] = ["map", "odom", "world", "base", "base_link", "base_footprint"];
/// A reader makes 64 characters of a topic the sensor's name again: so none of two is cut to the other.
const MAX_CHARS: usize = 36;

/// The name in ROS of each sensor that has come: its frame, and the beginning of its topics.
#[derive(Debug, Default)]
pub(crate) struct Names {
    of: BTreeMap<SensorId, String>,
    taken: BTreeSet<String>,
}

impl Names {
    /// The name of a sensor, the same whenever it comes; of no other sensor, though theirs may differ in signs alone.
    pub(crate) fn of(&mut self, id: &SensorId) -> &str {
        let Self { of, taken } = self;
        of.entry(id.clone()).or_insert_with(|| {
            let plain = allowed(&id.0);
            let is_free = |name: &str| !TAKEN.contains(&name) && !taken.contains(name);
            let numbered = (2u64..).map(|number| format!("{plain}_{number}"));
            let name =
                std::iter::once(plain.clone()).chain(numbered).find(|name| is_free(name)).unwrap_or(plain.clone());
            taken.insert(name.clone());
            name
        })
    }
}

/// What is not allowed as `_`, of several in a row one.
fn allowed(id: &str) -> String {
    let mut name = String::new();
    for c in id.chars() {
        let c = if c.is_ascii_alphanumeric() { c } else { '_' };
        if !(c == '_' && name.ends_with('_')) && name.len() < MAX_CHARS {
            name.push(c);
        }
    }
    let name = name.trim_matches('_');
    match name.chars().next() {
        Some(c) if c.is_ascii_alphabetic() => name.to_owned(),
        Some(_) => format!("sensor_{name}"),
        None => "sensor".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ids_become_names_of_ros_and_stay_apart() {
        let mut names = Names::default();
        let ids = ["front", "front/lidar", "front-lidar", "front__lidar", "_front_lidar_2", "2d", "", "ü", "map"];
        let expected = [
            "front",
            "front_lidar",
            "front_lidar_2",
            "front_lidar_3",
            "front_lidar_2_2",
            "sensor_2d",
            "sensor",
            "sensor_2",
            "map_2",
        ];
        for _ in 0..2 {
            assert_eq!(ids.map(|id| names.of(&id.into()).to_owned()), expected);
        }
    }

    proptest! {
        #[test]
        fn any_ids_have_names_of_their_own(ids in prop::collection::btree_set("\\PC{0,80}|[a_./-]{0,6}", 1..30)) {
            let mut names = Names::default();
            let found: BTreeSet<String> = ids.iter().map(|id| names.of(&id.as_str().into()).to_owned()).collect();
            prop_assert_eq!(found.len(), ids.len());
            for name in found {
                prop_assert!(name.starts_with(|c: char| c.is_ascii_alphabetic()) && !name.contains("__"));
                prop_assert!(name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') && name.len() < 48);
            }
        }
    }
}
