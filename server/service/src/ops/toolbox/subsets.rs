//! Some of a cloud's points: samples and crops.

use crate::{Error, Result};
use nalgebra::{Point2, Point3};
use percept_geometry::{OrientedBox3, PointCloud, cloud::is_finite};
use percept_perception::cloud;

/// Points times samples of the farthest-point strategy, at most: some ten seconds.
const MAX_FARTHEST: usize = 20_000_000_000;

/// Which points are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sample {
    /// Every so-many-th.
    Every(usize),
    /// So many, by a seed.
    Random(usize, u64),
    /// So many far from each other, by a seed.
    Farthest(usize, u64),
}

/// A part of space.
#[derive(Debug, Clone, PartialEq)]
pub enum Region {
    /// With its border.
    Box(OrientedBox3),
    /// Distances from a point, metres.
    Range(Point3<f64>, f64, f64),
    /// Corners in the xy plane, lowest and highest z, metres.
    Polygon(Vec<Point2<f64>>, f64, f64),
}

/// A sample of the finite points, and their indices.
///
/// # Errors
/// `OUT_OF_RANGE`; `SAMPLE_TOO_LARGE` if farthest points would take too long.
pub fn sample_points(points: &PointCloud, sample: &Sample) -> Result<(PointCloud, Vec<usize>)> {
    let taken = match *sample {
        Sample::Every(step) => cloud::sample_uniform(&points.positions, step)?,
        Sample::Random(count, seed) => cloud::sample_random(&points.positions, count, seed),
        Sample::Farthest(count, seed) => {
            let count = count.min(points.len());
            if count.saturating_mul(points.len()) > MAX_FARTHEST {
                let n = points.len();
                let words = format!(
                    "farthest is {count} of {n} points, which takes too long; take at most {}, or downsample first",
                    MAX_FARTHEST / n.max(1)
                );
                return Err(Error::exhausted("SAMPLE_TOO_LARGE", "farthest", words));
            }
            cloud::sample_farthest(&points.positions, count, seed)
        }
    };
    Ok((points.select(&taken), taken))
}

/// The finite points within a region, or outside of it, and their indices.
///
/// # Errors
/// `OUT_OF_RANGE` naming the field.
pub fn crop_cloud(points: &PointCloud, region: &Region, outside: bool) -> Result<(PointCloud, Vec<usize>)> {
    let p = &points.positions;
    let mut kept = match region {
        Region::Box(bbox) => cloud::crop_box(p, bbox).map_err(|e| Error::from(e).within("box"))?,
        Region::Range(center, low, high) => {
            cloud::crop_range(p, center, *low, *high).map_err(|e| Error::from(e).within("range"))?
        }
        Region::Polygon(corners, low, high) => cloud::crop_polygon(p, corners, *low, *high)?,
    };
    if outside {
        let mut inside = vec![false; p.len()];
        kept.iter().for_each(|&i| inside[i] = true);
        kept = (0..p.len()).filter(|&i| !inside[i] && is_finite(&p[i])).collect();
    }
    Ok((points.select(&kept), kept))
}
