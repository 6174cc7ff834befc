//! 3D lidars: each sweep is placed in a local map of voxels with a Gaussian each.
//!
//! The same defaults serve a room and a street: the voxel's size is learned from the first sweep. Sweep to
//! thinned points (here), map ([`voxels`]), points to map ([`mod@align`]).

mod align;
mod voxels;

use crate::odometry::{LocalModel, Match, Prediction, deskew};
use crate::scan::Scan;
use crate::tracking::LostReason;
use crate::{ParamError, check_range};
use align::{Problem, align};
use nalgebra::{Point3, Vector6};
use percept_geometry::{KeyframeScan, Pose, cloud};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use voxels::{GaussianMap, Thinner};

/// Parameters of 3D lidar odometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Lidar3dParams {
    /// Nearer points are the robot itself, metres from the sensor, 0 to 10.
    pub min_range_m: f64,
    /// Farther points are not used, metres, 1 to 1000.
    pub max_range_m: f64,
    /// Edge of the local map's voxels, metres, 0.05 to 5; none learns it from the first sweep.
    pub voxel_size_m: Option<f64>,
    /// Most iterations on the fine map, 1 to 200.
    pub max_iterations: usize,
    /// Least share of the points that must meet the map, 0.01 to 1.
    pub min_overlap_ratio: f64,
    /// Of those, least share near its surfaces, 0.01 to 1.
    pub min_inlier_ratio: f64,
    /// Whether to undo the motion during a sweep where points carry times.
    pub deskew: bool,
}

impl Default for Lidar3dParams {
    fn default() -> Self {
        Self {
            min_range_m: 0.3,
            max_range_m: 100.0,
            voxel_size_m: None,
            max_iterations: 15,
            min_overlap_ratio: 0.2,
            min_inlier_ratio: 0.5,
            deskew: true,
        }
    }
}

impl Lidar3dParams {
    /// Checks every field.
    ///
    /// # Errors
    /// [`ParamError`] with field, value and remedy.
    pub fn validate(&self) -> Result<(), ParamError> {
        let (max, size) = (self.max_range_m, self.voxel_size_m.unwrap_or(1.0));
        check_range("lidar3d.min_range_m", self.min_range_m, (0.0, 10.0), "within 0 to 10", "use 0.3")?;
        check_range("lidar3d.max_range_m", max, (1.0, 1000.0), "within 1 to 1000", "use 100")?;
        check_range("lidar3d.max_range_m", max, (self.min_range_m, 1000.0), "above min_range_m", "use 100")?;
        check_range("lidar3d.voxel_size_m", size, (0.05, 5.0), "within 0.05 to 5", "leave it out")?;
        let iterations = self.max_iterations as f64;
        check_range("lidar3d.max_iterations", iterations, (1.0, 200.0), "within 1 to 200", "use 15")?;
        let (overlap, inliers) = (self.min_overlap_ratio, self.min_inlier_ratio);
        check_range("lidar3d.min_overlap_ratio", overlap, (0.01, 1.0), "within 0.01 to 1", "use 0.2")?;
        check_range("lidar3d.min_inlier_ratio", inliers, (0.01, 1.0), "within 0.01 to 1", "use 0.5")
    }
}

/// Sizes to learn from, as shares of the 90th percentile of the ranges; the first that makes planes wins.
const SIZE_LADDER: [f64; 5] = [1.0 / 40.0, 1.0 / 28.0, 1.0 / 20.0, 1.0 / 14.0, 1.0 / 10.0];
/// Share of the first sweep's points that must lie in planes.
const PLANAR_SHARE: f64 = 0.6;
/// Coarse voxels are so much larger.
const COARSE: f64 = 3.0;

/// The local map of a lidar and its current sweep.
pub(crate) struct Lidar3d {
    params: Lidar3dParams,
    thinner: Thinner,
    fine: Option<GaussianMap>,
    coarse: GaussianMap,
    /// Current sweep in base: what goes into the map, and what is registered.
    dense: Vec<Point3<f32>>,
    sparse: Vec<Point3<f32>>,
    reach: f64,
    /// Squares of how far predictions were off at the points, as a running mean; see KISS-ICP, eq. 7.
    deviation2: Option<f64>,
    last_trim: Option<Point3<f64>>,
}

impl Lidar3d {
    pub(crate) fn new(params: Lidar3dParams) -> Self {
        Self {
            params,
            thinner: Thinner::default(),
            fine: None,
            coarse: GaussianMap::default(),
            dense: vec![],
            sparse: vec![],
            reach: 0.0,
            deviation2: None,
            last_trim: None,
        }
    }

    /// The size at which the sweep is made of planes: rooms have small ones, sparse rings need large ones.
    fn learn_size(&mut self, points: &[Point3<f32>], usable: &[u32], range90: f64) -> f64 {
        if let Some(size) = self.params.voxel_size_m {
            return size;
        }
        let mut best = (0.0, 1.0);
        for share in SIZE_LADDER {
            let size = (share * range90).clamp(0.15, 1.5);
            let kept = self.thinner.first_per_voxel(points, usable, 0.2 * size);
            let mut map = GaussianMap::new(size);
            map.insert(kept.iter().map(|&i| points[i as usize].cast()));
            let planar = map.planar_share();
            if planar > best.0 {
                best = (planar, size);
            }
            if planar >= PLANAR_SHARE {
                break;
            }
        }
        best.1
    }

    fn start_maps(&mut self, size: f64) {
        self.fine = Some(GaussianMap::new(size));
        self.coarse = GaussianMap::new(COARSE * size);
    }

    fn insert(&mut self, points: &[Point3<f32>], t_odom_base: &Pose) {
        let r = *t_odom_base.rotation.to_rotation_matrix().matrix();
        let moved = |p: &Point3<f32>| Point3::from(r * p.coords.cast::<f64>() + t_odom_base.translation.vector);
        if let Some(fine) = &mut self.fine {
            fine.insert(points.iter().map(moved));
            self.coarse.insert(points.iter().map(moved));
        }
    }

    /// Forgets what is out of reach, now and then.
    fn trim(&mut self, t_odom_base: &Pose) {
        let here = Point3::from(t_odom_base.translation.vector);
        if self.last_trim.is_some_and(|p| (p - here).norm() < 0.1 * self.reach) {
            return;
        }
        self.last_trim = Some(here);
        if let Some(fine) = &mut self.fine {
            fine.remove_far_from(&here, 1.2 * self.reach);
            self.coarse.remove_far_from(&here, 1.2 * self.reach);
        }
    }
}

impl LocalModel for Lidar3d {
    fn prepare(&mut self, scan: &Scan, velocity: &Vector6<f64>) -> Result<(), LostReason> {
        let Scan::Cloud(scan) = scan else { return Err(LostReason::UnsuitableScan) };
        let (min2, max2) = (self.params.min_range_m.powi(2) as f32, self.params.max_range_m.powi(2) as f32);
        let positions = &scan.cloud.positions;
        let usable: Vec<u32> = (0..positions.len())
            .filter(|&i| {
                let d2 = positions[i].coords.norm_squared();
                cloud::is_finite(&positions[i]) && d2 >= min2 && d2 <= max2
            })
            .map(|i| i as u32)
            .collect();
        if usable.len() < 100 {
            return Err(LostReason::TooFewPoints);
        }
        let still = Vector6::zeros();
        let in_base =
            deskew::to_base(&scan.cloud, &scan.t_base_sensor, if self.params.deskew { velocity } else { &still });
        if self.is_empty() && self.fine.is_none() {
            let mut ranges: Vec<f32> = usable.iter().map(|&i| positions[i as usize].coords.norm()).collect();
            let k = ranges.len() * 9 / 10;
            let range90 = f64::from(*ranges.select_nth_unstable_by(k, f32::total_cmp).1);
            let size = self.learn_size(&in_base, &usable, range90);
            self.start_maps(size);
            self.reach = (4.0 * range90).clamp(20.0, self.params.max_range_m.max(20.0));
        }
        let size = self.fine.as_ref().map_or(1.0, GaussianMap::size);
        let dense = self.thinner.first_per_voxel(&in_base, &usable, 0.2 * size);
        let sparse = self.thinner.first_per_voxel(&in_base, &dense, 0.7 * size);
        let take = |indices: &[u32]| indices.iter().map(|&i| in_base[i as usize]).collect();
        (self.dense, self.sparse) = (take(&dense), take(&sparse));
        if self.sparse.len() < 50 { Err(LostReason::TooFewPoints) } else { Ok(()) }
    }

    fn is_empty(&self) -> bool {
        self.fine.as_ref().is_none_or(GaussianMap::is_empty)
    }

    fn register(&mut self, prediction: &Prediction) -> Result<Match, LostReason> {
        let Some(fine) = &self.fine else { return Err(LostReason::TooFewCorrespondences) };
        let size = fine.size();
        let expected_error = self.deviation2.map_or(2.0 * size, |d| 3.0 * d.sqrt()).max(0.1 * size);
        let found = align(&Problem {
            points: &self.sparse,
            fine,
            coarse: &self.coarse,
            prediction,
            expected_error,
            max_iterations: self.params.max_iterations,
            min_overlap: self.params.min_overlap_ratio,
            min_inlier_ratio: self.params.min_inlier_ratio,
        })?;
        let off = prediction.t_odom_base.inverse() * found.t_odom_base;
        let at_points = off.translation.vector.norm() + 0.25 * self.reach * off.rotation.angle();
        let last = self.deviation2.unwrap_or(size * size);
        self.deviation2 = Some(last + 0.2 * (at_points * at_points - last));
        Ok(found)
    }

    fn integrate(&mut self, t_odom_base: &Pose) {
        let points = std::mem::take(&mut self.dense);
        self.insert(&points, t_odom_base);
        self.dense = points;
        self.trim(t_odom_base);
    }

    fn clear(&mut self) {
        if let Some(size) = self.fine.as_ref().map(GaussianMap::size) {
            self.start_maps(size);
        }
        self.deviation2 = None;
        self.last_trim = None;
    }

    fn seed(&mut self, _t_odom_base_last: &Pose, recent: &[(Pose, Arc<KeyframeScan>)]) {
        let scans: Vec<_> = recent.iter().filter(|(_, k)| !k.planar && !k.hits.is_empty()).collect();
        let Some((_, newest)) = scans.last() else { return };
        if self.fine.is_none() {
            let mut ranges: Vec<f32> = newest.hits.positions.iter().map(|p| p.coords.norm()).collect();
            let k = ranges.len() * 9 / 10;
            let range90 = f64::from(*ranges.select_nth_unstable_by(k, f32::total_cmp).1);
            let all: Vec<u32> = (0..newest.hits.len() as u32).collect();
            let size = self.learn_size(&newest.hits.positions, &all, range90);
            self.start_maps(size);
            self.reach = (4.0 * range90).clamp(20.0, self.params.max_range_m.max(20.0));
        }
        for (t_odom_base, scan) in scans {
            self.insert(&scan.hits.positions, t_odom_base);
        }
    }
}
