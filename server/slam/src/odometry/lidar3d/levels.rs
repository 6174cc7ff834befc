//! Voxels of several sizes over the same points.

use super::voxels::{Clock, FLAT, Gaussian, GaussianMap, Ranges, Shape, floor};
use crate::odometry::OdometryNoise;
use nalgebra::Point3;

/// The same points in voxels of several sizes: a point meets the finest that is a plane.
///
/// Near the sensor, and where much was seen, that is a small voxel; far away, between sparse rings and with coarse
/// ranges it is a large one. So no size has to be right for all of a scene.
#[derive(Debug, Default)]
pub(crate) struct Levels {
    maps: Vec<GaussianMap>,
    /// How thick the finest planes are: median variance, m^2.
    thickness: f64,
}

/// Standard deviation of ranges where nothing is known of them, metres. It counts in the first sweep alone: halved 11.4
/// and 10.0, doubled 11.2 and 9.3 ([`super`]).
const COARSE_RANGES: f64 = 0.04;
/// How thick a large voxel's plane may be, times the thickness (a variance) of the finest ones. `evaluate handheld` and
/// `kitti-tracking` (the end) on the recordings: 5 times 0.0118 m and 9.9 mm, 8 times 0.0120 and 9.7.
const THIN: f64 = 5.0;
/// Sizes of the levels, in voxels of the finest. Each twice the one before, as sizes are halved and doubled; three of
/// them reach from the spacing of near rings to that of far ones.
const LEVELS: [f64; 3] = [1.0, 2.0, 4.0];

impl Levels {
    /// Bytes, about.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.maps.iter().map(GaussianMap::memory_bytes).sum()
    }

    pub(crate) fn new(size: f64) -> Self {
        Self {
            maps: LEVELS.iter().map(|scale| GaussianMap::new(scale * size)).collect(),
            thickness: COARSE_RANGES.powi(2),
        }
    }

    /// Of the finest voxels, metres.
    pub(crate) fn size(&self) -> f64 {
        self.maps.first().map_or(1.0, GaussianMap::size)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.maps.iter().all(GaussianMap::is_empty)
    }

    /// Adds points of odom, and from where in odom they were seen if that was one sensor at one time; answers with the share
    /// that lies in finest voxels where nothing was.
    pub(crate) fn insert(&mut self, points: &[Point3<f64>], seen_from: Option<Point3<f64>>) -> f64 {
        // The finest level comes last.
        let ranges = seen_from.map(|origin| Ranges { origin, variance: self.thickness });
        let new = self.maps.iter_mut().rev().fold(1.0, |_, map| map.insert(points.iter().copied(), ranges.as_ref()));
        self.thickness = self.maps.first().and_then(GaussianMap::thickness).unwrap_or(self.thickness);
        new
    }

    pub(crate) fn clock(&self) -> Clock {
        self.maps.first().map_or_else(Clock::default, |m| m.clock)
    }

    /// This share of the view was new, and it was placed with such a standard deviation, metres.
    pub(crate) fn renewed(&mut self, share: f64, sigma: f64) {
        let sigma = OdometryNoise::per_view(sigma);
        let clock = Clock { way: self.clock().way + share, sigma, size: self.size() };
        self.maps.iter_mut().for_each(|m| m.clock = clock);
    }

    /// Share of some points that meet planes.
    pub(crate) fn planar_share(&self, points: &[Point3<f64>]) -> f64 {
        let planar = |p: &&Point3<f64>| self.at(p).is_some_and(|v| matches!(v.shape, Shape::Plane(..)));
        points.iter().filter(planar).count() as f64 / points.len().max(1) as f64
    }

    pub(crate) fn remove_far_from(&mut self, center: &Point3<f64>, radius: f64) {
        for map in &mut self.maps {
            map.remove_far_from(center, radius);
        }
    }

    /// The finest plane at `p`, else what else is there. A large voxel's plane holds within that voxel alone, and has to be
    /// about as thin as the finest ones are: what is thicker bends, or is two surfaces.
    #[inline]
    pub(crate) fn at(&self, p: &Point3<f64>) -> Option<&Gaussian> {
        let mut other = None;
        let thin = (FLAT * self.size().powi(2) / 12.0).max(THIN * self.thickness);
        for (level, map) in self.maps.iter().enumerate() {
            let found = if level > 0 { map.own(p) } else { map.at(p) };
            if found
                .is_some_and(|v| matches!(v.shape, Shape::Plane(_, variance) if variance < thin + floor(map.size())))
            {
                return found;
            }
            other = other.or(found);
        }
        other
    }

    /// Voxels of twice the size: the finest level goes, and the coarsest is gathered into a coarser one.
    pub(crate) fn double(&mut self) {
        if let Some(coarser) = self.maps.last().map(GaussianMap::doubled) {
            self.maps.push(coarser);
            self.maps.remove(0);
        }
    }

    /// Voxels of half the size: the coarsest level goes, and a finer one begins, empty: it is filled by what is seen next.
    pub(crate) fn halve(&mut self) {
        let finer = GaussianMap::beginning(0.5 * self.size(), self.clock());
        self.maps.insert(0, finer);
        self.maps.pop();
    }

    /// What the coarsest level has at `p`.
    #[inline]
    pub(crate) fn coarse(&self, p: &Point3<f64>) -> Option<&Gaussian> {
        self.maps.last()?.at(p)
    }
}
