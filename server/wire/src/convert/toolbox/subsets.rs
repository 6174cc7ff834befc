//! Samples and crops: parameters of requests.

use crate::convert::{geometry, required};
use crate::v1;
use percept_service::Result;
use percept_service::toolbox::{Region, Sample};

/// Which points are taken.
///
/// # Errors
/// `FIELD_MISSING`.
pub fn sample(r: &v1::SamplePointsRequest) -> Result<Sample> {
    use v1::sample_points_request::Sample as S;
    Ok(match required("sample", r.sample)? {
        S::Every(step) => Sample::Every(step as usize),
        S::Random(count) => Sample::Random(count as usize, r.seed),
        S::Farthest(count) => Sample::Farthest(count as usize, r.seed),
    })
}

/// The part of space that is asked for.
///
/// # Errors
/// `FIELD_MISSING`, and those of the shapes.
pub fn region(r: &v1::CropCloudRequest) -> Result<Region> {
    use v1::crop_cloud_request::Region as R;
    Ok(match required("region", r.region.as_ref())? {
        R::Box(b) => Region::Box(geometry::oriented_box("box", b)?),
        R::Range(band) => {
            let center = geometry::vector("centre", &band.centre.unwrap_or_default()).map_err(|e| e.within("range"))?;
            Region::Range(center.into(), band.min_range_m.unwrap_or(0.0), band.max_range_m)
        }
        R::Polygon(prism) => {
            let corners: Result<_> = prism.corners.iter().map(|c| geometry::point2("polygon.corners", c)).collect();
            Region::Polygon(corners?, prism.z_min_m.unwrap_or(f64::MIN), prism.z_max_m.unwrap_or(f64::MAX))
        }
    })
}
