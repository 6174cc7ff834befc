//! Depth images cleaned up.

use crate::{Error, Result};
use percept_geometry::DepthImage;
use percept_perception::depth::{self, BilateralParams, DepthOutlierParams, FillParams, MedianParams};

/// Filters of one request, at most.
const MAX_FILTERS: usize = 16;

/// What is done to a depth image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DepthFilter {
    /// Square median.
    Median(MedianParams),
    /// Along surfaces, not across edges.
    Bilateral(BilateralParams),
    /// What is off the local median goes.
    RemoveOutliers(DepthOutlierParams),
    /// Pixels without a return, from neighbours on one surface.
    FillHoles(FillParams),
}

/// Filters in turn.
///
/// # Errors
/// `FILTERS_INVALID`; `OUT_OF_RANGE` naming `filters[i]`.
pub fn filter_depth(image: DepthImage, filters: &[DepthFilter]) -> Result<DepthImage> {
    if !(1..=MAX_FILTERS).contains(&filters.len()) {
        let words = format!("filters has {} entries; send 1 to {MAX_FILTERS}", filters.len());
        return Err(Error::invalid("FILTERS_INVALID", "filters", words));
    }
    filters.iter().enumerate().try_fold(image, |image, (i, filter)| {
        let (name, out) = match filter {
            DepthFilter::Median(params) => ("median", depth::median(&image, params)),
            DepthFilter::Bilateral(params) => ("bilateral", depth::bilateral(&image, params)),
            DepthFilter::RemoveOutliers(params) => ("remove_outliers", depth::remove_outliers(&image, params)),
            DepthFilter::FillHoles(params) => ("fill_holes", depth::fill_holes(&image, params)),
        };
        out.map_err(|e| Error::from(e).within(&format!("filters[{i}].{name}")))
    })
}
