//! Surroundings that defaults are made for, and how sensors tell which.

use percept_geometry::{SensorKind, SensorSpec};
use serde::{Deserialize, Serialize};

/// Surroundings that defaults are made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// By the sensors that are declared.
    #[default]
    Auto,
    /// Rooms and halls.
    Indoor,
    /// Streets, yards, fields.
    Outdoor,
}

/// Who sees so far is made for outdoors, metres: lidars for halls end at 20 to 40, those for streets begin at 80.
const FAR_M: f64 = 50.0;

impl Preset {
    /// What is chosen for a session with these sensors.
    #[must_use]
    pub fn chosen(self, sensors: &[SensorSpec]) -> Self {
        let sees_far =
            |s: &SensorSpec| s.kind == SensorKind::Lidar3d && s.range_max_m.is_some_and(|range| range >= FAR_M);
        match self {
            Self::Auto if sensors.iter().any(sees_far) => Self::Outdoor,
            Self::Auto => Self::Indoor,
            preset => preset,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::Pose;

    fn lidar(range_max_m: Option<f64>) -> SensorSpec {
        SensorSpec {
            id: "lidar".into(),
            kind: SensorKind::Lidar3d,
            t_base_sensor: Pose::identity(),
            intrinsics: None,
            time_offset_s: 0.0,
            range_max_m,
        }
    }

    #[test]
    fn presets_go_by_the_sensors() {
        assert_eq!(Preset::Auto.chosen(&[]), Preset::Indoor);
        assert_eq!(Preset::Auto.chosen(&[lidar(None)]), Preset::Indoor);
        assert_eq!(Preset::Auto.chosen(&[lidar(Some(120.0))]), Preset::Outdoor);
        assert_eq!(Preset::Indoor.chosen(&[lidar(Some(120.0))]), Preset::Indoor);
    }
}
