//! What can be tuned about detection.

use crate::cloud::CloudError;
use percept_geometry::GeometryError;
use serde::{Deserialize, Serialize};

/// Parameters of the detector. Lengths fit indoor scenes with furniture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DetectionParams {
    /// Edge of the voxels that the cloud is thinned to, metres, 0.005 to 0.5. All else scales with what is seen.
    pub voxel_size_m: f64,
    /// Points at most this far apart belong to one object, metres; at least twice the voxel size.
    pub cluster_eps_m: f64,
    /// Voxels within that distance, itself among them, that make a voxel part of a solid surface rather than of a
    /// spray of noise that might join two objects.
    pub min_density: usize,
    /// An object takes at least this share of the voxels that the sides of its box would take, 0 to 1: half a
    /// box is 0.5, four legs are 0.2, what is left of someone who walked by is less.
    pub min_coverage: f64,
    /// Objects have at least so many voxels.
    pub min_points: usize,
    /// The floor is looked for this far below and above z = 0, metres.
    pub floor_search_m: f64,
    /// What lies lower than this above the floor belongs to it, metres.
    pub floor_margin_m: f64,
    /// Points higher than this above the floor belong to no object, metres.
    pub max_height_m: f64,
    /// An object's top is at least this high above the floor, metres.
    pub min_height_m: f64,
    /// An object's footprint is at least this long, metres.
    pub min_size_m: f64,
    /// An object's footprint is at most this long, metres.
    pub max_size_m: f64,
    /// What lies this near to a wall's plane belongs to the wall, metres; two to three deviations of the noise.
    pub wall_distance_m: f64,
    /// A vertical surface this long is a wall however high it is seen, metres: longer than a wide shelf.
    pub wall_min_length_m: f64,
    /// A vertical surface seen higher than this above the floor is a wall, metres: higher than a shelf.
    pub wall_top_m: f64,
    /// Part of an object's points left out on each side of each axis when its box is fitted, 0 to 0.2.
    pub box_trim: f64,
    /// Seed of the search for the floor.
    pub seed: u64,
}

impl Default for DetectionParams {
    fn default() -> Self {
        Self {
            voxel_size_m: 0.05,
            cluster_eps_m: 0.11,
            min_density: 10,
            min_coverage: 0.25,
            min_points: 30,
            floor_search_m: 0.3,
            floor_margin_m: 0.06,
            max_height_m: 2.15,
            min_height_m: 0.2,
            min_size_m: 0.15,
            max_size_m: 3.0,
            wall_distance_m: 0.05,
            wall_min_length_m: 1.5,
            wall_top_m: 2.1,
            box_trim: 0.03,
            seed: 0,
        }
    }
}

impl DetectionParams {
    /// These for clouds whose points lie `spacing_m` apart: no finer than that, distances between points in proportion, and
    /// numbers of points as there are on a surface. Of finer clouds, the same.
    #[must_use]
    pub fn for_spacing(self, spacing_m: f64) -> Self {
        let factor = spacing_m / self.voxel_size_m;
        if !(factor > 1.0 && spacing_m <= 0.5) {
            return self;
        }
        let fewer = |n: usize, least: usize| ((n as f64 / (factor * factor)).round() as usize).max(least.min(n));
        let apart = |m: f64| m.max(m * factor).min(2.0);
        Self {
            voxel_size_m: spacing_m,
            cluster_eps_m: apart(self.cluster_eps_m).max(2.0 * spacing_m),
            // A voxel, and the four beside it on a surface.
            min_density: fewer(self.min_density, 5),
            min_points: fewer(self.min_points, 8),
            // Means of voxels of a rough floor are off by half a voxel at most.
            floor_margin_m: self.floor_margin_m.max(0.6 * spacing_m),
            wall_distance_m: self.wall_distance_m.max(0.6 * spacing_m),
            ..self
        }
    }

    /// Checks the bounds.
    ///
    /// # Errors
    /// `Input` naming the field.
    pub fn validate(&self) -> Result<(), CloudError> {
        let v = self.voxel_size_m;
        let bounds = [
            ("voxel_size_m", v, 0.005, 0.5, "between 0.005 and 0.5"),
            ("cluster_eps_m", self.cluster_eps_m, 2.0 * v, 2.0, "between twice voxel_size_m and 2"),
            ("floor_search_m", self.floor_search_m, 0.01, 2.0, "between 0.01 and 2"),
            ("floor_margin_m", self.floor_margin_m, 0.005, 0.5, "between 0.005 and 0.5"),
            ("max_height_m", self.max_height_m, self.min_height_m, 20.0, "between min_height_m and 20"),
            ("min_height_m", self.min_height_m, 0.0, 20.0, "between 0 and 20"),
            ("min_size_m", self.min_size_m, 0.0, self.max_size_m, "between 0 and max_size_m"),
            ("max_size_m", self.max_size_m, 0.1, 50.0, "between 0.1 and 50"),
            ("wall_distance_m", self.wall_distance_m, 0.005, 0.5, "between 0.005 and 0.5"),
            ("wall_min_length_m", self.wall_min_length_m, 0.3, 50.0, "between 0.3 and 50"),
            ("wall_top_m", self.wall_top_m, 0.5, 20.0, "between 0.5 and 20"),
            ("box_trim", self.box_trim, 0.0, 0.2, "between 0 and 0.2"),
            ("min_coverage", self.min_coverage, 0.0, 1.0, "between 0 and 1"),
            ("min_density", self.min_density as f64, 1.0, 1e9, "between 1 and 1e9"),
            ("min_points", self.min_points as f64, 3.0, 1e9, "between 3 and 1e9"),
        ];
        for (field, value, low, high, requirement) in bounds {
            if !(value >= low && value <= high) {
                return Err(GeometryError::OutOfRange { field, value, requirement }.into());
            }
        }
        Ok(())
    }
}
