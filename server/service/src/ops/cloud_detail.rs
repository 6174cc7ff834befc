//! How finely a cloud is read: by voxels, or by how many points there may be.

use super::errors::cloud_error;
use crate::{Error, Result, reason};
use percept_geometry::PointCloud;
use percept_perception::cloud::voxel_downsample;

/// How finely a cloud is wanted. As it is kept, if nothing is said.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CloudDetail {
    /// A point for each voxel of this edge, metres; finer than the map keeps it, it is as the map keeps it.
    pub voxel_size_m: Option<f64>,
    /// At most so many points: by the finest voxels that leave no more.
    pub max_points: Option<u64>,
}

/// From one size of voxels to the next, as a root of two: a view that is asked for again, of a map that has grown a little, is mostly
/// thinned by the same ones.
const STEPS_TO_DOUBLE: i32 = 4;
/// Coarsest voxels, metres: whoever wants fewer points than that leaves wants none.
const COARSEST_M: f64 = 1000.0;

impl CloudDetail {
    /// # Errors
    /// `OUT_OF_RANGE`.
    pub(crate) fn check(&self) -> Result<()> {
        if let Some(size) = self.voxel_size_m.filter(|s| !(*s > 0.0 && *s <= COARSEST_M)) {
            let words = format!("voxel_size_m is {size}; it must be above 0 and at most {COARSEST_M}");
            return Err(Error::invalid(reason::OUT_OF_RANGE, "voxel_size_m", words));
        }
        if self.max_points == Some(0) {
            let words = "max_points is 0; it must be 1 or more, or left out for all there are";
            return Err(Error::invalid(reason::OUT_OF_RANGE, "max_points", words));
        }
        Ok(())
    }

    /// A cloud that is kept by voxels of `kept_m`, so finely, and the edge of the voxels that its points are means of, metres.
    ///
    /// # Errors
    /// `OUT_OF_RANGE` if the cloud reaches too far for voxels of that size.
    pub(super) fn of(&self, cloud: PointCloud, kept_m: f64) -> Result<(PointCloud, f64)> {
        let asked_m = self.voxel_size_m.unwrap_or(0.0);
        let (cloud, size_m) = match asked_m > kept_m {
            true => (voxel_downsample(&cloud, asked_m).map_err(cloud_error)?, asked_m),
            false => (cloud, kept_m),
        };
        let most = self.max_points.map_or(usize::MAX, |most| usize::try_from(most).unwrap_or(usize::MAX));
        if cloud.len() <= most {
            return Ok((cloud, size_m));
        }
        // A surface's points go with the square of the edge, a volume's with the cube: no finer ones can do.
        let least = (cloud.len() as f64 / most as f64).cbrt().log2();
        let mut step = (f64::from(STEPS_TO_DOUBLE) * least).floor().max(1.0) as i32;
        loop {
            let size_m = size_m * (f64::from(step) / f64::from(STEPS_TO_DOUBLE)).exp2();
            let thinned = voxel_downsample(&cloud, size_m).map_err(cloud_error)?;
            if thinned.len() <= most {
                return Ok((thinned, size_m));
            }
            if size_m > COARSEST_M {
                // Each lies in a voxel of its own: what is left is evenly picked.
                let picked: Vec<usize> = (0..most).map(|i| i * thinned.len() / most).collect();
                return Ok((thinned.select(&picked), size_m));
            }
            step += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    /// A floor of 20 x 20 m, a point every 0.1 m, and one far off.
    fn floor() -> PointCloud {
        let mut points: Vec<Point3<f32>> = (0..40_000)
            .map(|i| Point3::new((i % 200) as f32 * 0.1 + 0.05, (i / 200) as f32 * 0.1 + 0.05, 0.0))
            .collect();
        points.push(Point3::new(90_000.0, 0.0, 0.0));
        PointCloud::from_positions(points)
    }

    #[test]
    fn a_cloud_is_thinned_by_the_finest_voxels_that_leave_no_more_than_wanted() {
        let wanted = |max_points| CloudDetail { max_points: Some(max_points), voxel_size_m: None };
        for most in [39_999, 5_000, 1_000, 100, 7] {
            let (cloud, size_m) = wanted(most).of(floor(), 0.1).unwrap();
            assert!(cloud.len() as u64 <= most, "{} of {most}", cloud.len());
            let finer = CloudDetail { voxel_size_m: Some(size_m / 2f64.powf(0.25)), max_points: None };
            assert!(finer.of(floor(), 0.1).unwrap().0.len() as u64 > most, "{most}: {size_m}");
            assert_eq!(wanted(most).of(floor(), 0.1).unwrap().0, cloud, "the same each time");
        }
        assert_eq!(wanted(50_000).of(floor(), 0.1).unwrap(), (floor(), 0.1));
        // Two points that no voxel holds together.
        assert_eq!(wanted(1).of(floor(), 0.1).unwrap().0.len(), 1);
    }

    #[test]
    fn no_cloud_is_finer_than_it_is_kept_and_what_has_no_meaning_is_refused() {
        let by = |size| CloudDetail { voxel_size_m: Some(size), max_points: None };
        assert_eq!(by(0.05).of(floor(), 0.1).unwrap(), (floor(), 0.1));
        let (cloud, size_m) = by(0.4).of(floor(), 0.1).unwrap();
        assert!((size_m - 0.4).abs() < 1e-12 && (2_300..2_700).contains(&cloud.len()), "{}", cloud.len());
        assert!([0.0, -1.0, f64::NAN, f64::INFINITY, 1001.0].iter().all(|s| by(*s).check().is_err()));
        assert!(CloudDetail { max_points: Some(0), voxel_size_m: None }.check().is_err());
        assert!(CloudDetail::default().check().is_ok());
    }
}
