//! Defaults for kinds of surroundings.

use crate::PipelineParams;
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
/// Outdoors. Cells and voxels as large as the gaps between beams some 20 m away (64 rings over 27 degrees: 0.15 m), and as far as
/// rings of ground lie within a few metres of each other.
const CELL_M: f64 = 0.2;
const RANGE_M: f64 = 50.0;
/// A keyframe each metre, as LIO-SAM has them (Shan et al., 2020): a lidar that sees so far shows the same at half of that. Streets
/// (`outdoors --outdoor`, half a metre and one): the same poses, 0.997 of the occupied cells right, 0.98 shown, in 0.7 of the time.
const KEYFRAME_M: f64 = 1.0;
/// Cars show their shape to a lidar of 64 rings so far, metres.
const OBJECTS_M: f64 = 30.0;
/// A van, metres.
const LONGEST_M: f64 = 8.0;
const HIGHEST_M: f64 = 4.0;

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

impl PipelineParams {
    /// The defaults for these surroundings: these, but for what the surroundings ask for.
    #[must_use]
    pub fn for_preset(mut self, preset: Preset) -> Self {
        self.preset = preset;
        if preset == Preset::Outdoor {
            self.slam.odometry.keyframe.distance_m = KEYFRAME_M;
            let map = &mut self.map;
            (map.occupancy.resolution_m, map.occupancy.range_max_m) = (CELL_M, Some(RANGE_M));
            (map.cloud.voxel_size_m, map.cloud.range_max_m) = (CELL_M, Some(RANGE_M));
            map.voxels.voxel_size_m = map.voxels.voxel_size_m.max(CELL_M);
            map.surface.voxel_size_m = map.surface.voxel_size_m.max(CELL_M);
            map.height.enabled = true;
            self.detection.range_m = OBJECTS_M;
            let detector = &mut self.detection.detector;
            (detector.max_size_m, detector.max_height_m) = (LONGEST_M, HIGHEST_M);
        }
        self
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
    fn presets_go_by_the_sensors_and_are_sound() {
        assert_eq!(Preset::Auto.chosen(&[]), Preset::Indoor);
        assert_eq!(Preset::Auto.chosen(&[lidar(None)]), Preset::Indoor);
        assert_eq!(Preset::Auto.chosen(&[lidar(Some(120.0))]), Preset::Outdoor);
        assert_eq!(Preset::Indoor.chosen(&[lidar(Some(120.0))]), Preset::Indoor);
        for preset in [Preset::Auto, Preset::Indoor, Preset::Outdoor] {
            let params = PipelineParams::default().for_preset(preset);
            assert_eq!(params.validate(), Ok(()), "{preset:?}");
            assert_eq!(params.preset, preset);
        }
        assert_eq!(PipelineParams::default().for_preset(Preset::Auto), PipelineParams::default());
    }
}
