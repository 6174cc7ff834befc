//! Points that stand too much alone.

use super::{at_least, positive};
use crate::search::{KdTree, Wanted, What};
use nalgebra::Point3;
use percept_geometry::{GeometryError, cloud::is_finite};
use serde::{Deserialize, Serialize};

/// How [`statistical_outliers`] judges.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StatisticalOutlierParams {
    /// Neighbours whose distance is averaged, the point itself not among them; at least 1.
    pub num_neighbours: usize,
    /// Standard deviations above the mean up to which a point stays.
    pub std_ratio: f64,
}

impl Default for StatisticalOutlierParams {
    fn default() -> Self {
        Self { num_neighbours: 20, std_ratio: 2.0 }
    }
}

impl StatisticalOutlierParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), GeometryError> {
        at_least("num_neighbours", self.num_neighbours, 1, "at least 1")?;
        positive("std_ratio", self.std_ratio)
    }
}

/// Indices of the points whose mean distance to their nearest neighbours is not unusually large, ascending.
///
/// With fewer other points than `num_neighbours` all of them are averaged; a single point stays.
///
/// Source: Rusu et al., "Towards 3D point cloud based object maps for household environments", 2008.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn statistical_outliers(
    points: &[Point3<f32>],
    params: &StatisticalOutlierParams,
) -> Result<Vec<usize>, GeometryError> {
    params.validate()?;
    let tree = KdTree::build(points);
    let k = params.num_neighbours.min(tree.len().saturating_sub(1));
    if k == 0 {
        return Ok((0..points.len()).filter(|&i| is_finite(&points[i])).collect());
    }
    // The point itself, or one equal to it, is the first at distance 0.
    let wanted = Wanted { k: k + 1, radius_m: f32::INFINITY, what: What::Distances };
    let by_task = tree.map_leaves(&wanted, |means: &mut Vec<f64>, leaf, group| {
        means.extend((0..tree.num_points_of(leaf)).map(|i| group.sum_of_distances(i) / k as f64));
    });
    let means = tree.in_cloud_order(&by_task, f64::NAN);
    let (mean, deviation) = mean_and_deviation(means.iter().copied().filter(|m| !m.is_nan()));
    // Rounding in the sums must not throw out points that are all alike.
    let limit = mean + params.std_ratio * deviation + 1e-9 * mean;
    Ok((0..points.len()).filter(|&i| means[i] <= limit).collect())
}

fn mean_and_deviation(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let n = (values.clone().count() as f64).max(1.0);
    let mean = values.clone().sum::<f64>() / n;
    (mean, (values.map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt())
}

/// How [`radius_outliers`] judges.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RadiusOutlierParams {
    /// Radius, metres.
    pub radius_m: f64,
    /// Other points that have to lie within it.
    pub min_neighbours: usize,
}

impl Default for RadiusOutlierParams {
    fn default() -> Self {
        Self { radius_m: 0.1, min_neighbours: 5 }
    }
}

/// Indices of the points with enough others within the radius, ascending.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn radius_outliers(points: &[Point3<f32>], params: &RadiusOutlierParams) -> Result<Vec<usize>, GeometryError> {
    positive("radius_m", params.radius_m)?;
    let wanted = params.min_neighbours.saturating_add(1);
    let keep = KdTree::build(points).at_least_within(params.radius_m as f32, wanted);
    Ok((0..points.len()).filter(|&i| keep[i]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet_and_strays() -> Vec<Point3<f32>> {
        let mut points: Vec<Point3<f32>> =
            (0..900).map(|i| Point3::new((i % 30) as f32 * 0.02, (i / 30) as f32 * 0.02, 0.0)).collect();
        points.insert(100, Point3::new(0.3, 0.3, 0.7));
        points.insert(500, Point3::new(f32::NAN, 0.0, 0.0));
        points.push(Point3::new(2.0, 0.0, 0.0));
        points
    }

    #[test]
    fn strays_go_and_the_sheet_stays() {
        let points = sheet_and_strays();
        let expected: Vec<usize> = (0..points.len()).filter(|i| ![100, 500, 902].contains(i)).collect();
        assert_eq!(statistical_outliers(&points, &StatisticalOutlierParams::default()).unwrap(), expected);
        assert_eq!(radius_outliers(&points, &RadiusOutlierParams::default()).unwrap(), expected);
    }

    #[test]
    fn degenerate_clouds_keep_what_is_finite() {
        let judge = |points: &[Point3<f32>]| statistical_outliers(points, &Default::default()).unwrap();
        assert!(judge(&[]).is_empty());
        assert_eq!(judge(&[Point3::origin()]), [0]);
        assert_eq!(judge(&[Point3::new(f32::NAN, 0.0, 0.0), Point3::origin()]), [1]);
        assert_eq!(judge(&[Point3::new(1e7, 1e7, 1e7); 50]).len(), 50);
        assert_eq!(judge(&[Point3::origin(), Point3::new(1.0, 0.0, 0.0)]), [0, 1]);
        assert!(
            radius_outliers(&[Point3::origin()], &RadiusOutlierParams { radius_m: 0.0, min_neighbours: 0 }).is_err()
        );
        let none_wanted = RadiusOutlierParams { radius_m: 0.1, min_neighbours: 0 };
        assert_eq!(radius_outliers(&[Point3::origin()], &none_wanted).unwrap(), [0]);
    }
}
