//! A part of the map as one surface, and whether scans fit into it.

use super::kept::Kept;
use super::submap::{range, voxel_for};
use crate::covariance::diagonal;
use crate::downsample::Thinner;
use crate::loops::lost::Strictness;
use crate::odometry::lidar3d::align::{Problem, align};
use crate::odometry::lidar3d::levels::Levels;
use crate::odometry::lidar3d::sight::{Contradiction, Sight};
use crate::odometry::lidar3d::sweep::{Instants, Sweep};
use crate::odometry::{Prediction, Registration, way_m};
use nalgebra::{Point3, Vector6};
use percept_geometry::{KeyframeId, KeyframeScan, Pose};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Keyframes taken from around each place that a scan is expected at, and those that it is compared with. The first
/// halved 17 and 142, doubled 44 and 145; the second halved and doubled as it is ([`super`]).
const AROUND: usize = 6;
const COMPARED: usize = 4;
/// Finest voxels of the surface, in those of the pictures from above; every so many points make them. The first halved
/// 23 and 109, doubled 26 and 90; the second halved 28, one of them false, and 170, the robot found after 9.0 s and
/// once in a wrong place, doubled 18, one of them false, and 128, the robot found after 8.5 s ([`super`]).
const VOXELS: f64 = 3.0;
const EVERY: usize = 2;
/// A scan is registered with about so many points. Halved 29 and 102, doubled 15, one of them false, and 128, the
/// robot found after 8.5 s ([`super`]).
const POINTS: usize = 1500;
/// Standard deviations of where a scan is expected: voxels of the pictures, and radians; and what a measurement may move
/// it by, in these.
const EXPECTED: (f64, f64) = (2.0, 0.07);
/// Three standard deviations.
const MOST_MOVED: f64 = 3.0;
/// A place leaves nothing open if it fixes the pose within this: voxels of the pictures, and radians.
const FIXED: (f64, f64) = (0.5, 0.05);
/// What a measurement may be off beyond its noise: the map's own errors, voxels of the pictures and radians. Halved 43
/// and 105, doubled 29 and 100 ([`super`]).
const FLOOR: (f64, f64) = (0.1, 0.003);

/// Why a scan was not placed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Refused {
    /// It does not fit.
    Misfit,
    /// One looked through what the other saw.
    Contradicted,
    /// It fits, and in more than one way, or nothing is known here.
    Open,
}

/// Keyframes of the map around some poses.
pub(super) struct Target {
    surface: Levels,
    voxel_m: f64,
    /// How far its views saw, metres: a scan that sees farther is compared as far as that.
    farthest_m: f64,
    /// With where they are believed to be, base to map.
    views: BTreeMap<KeyframeId, (Pose, Sight)>,
}

/// How far a scan may be from where it is expected, metres and radians, where the lidar sees so far.
pub(super) fn reach(range: f64) -> (f64, f64) {
    (MOST_MOVED * EXPECTED.0 * voxel_for(range), MOST_MOVED * EXPECTED.1)
}

/// Metres, with a radian for half a metre.
fn length(t: &Pose) -> f64 {
    way_m(t.translation.vector.norm(), t.rotation.angle())
}

impl Target {
    /// Of the keyframes nearest to these poses (base to map).
    pub(super) fn new(kept: &BTreeMap<KeyframeId, Kept>, poses: &BTreeMap<KeyframeId, Pose>, places: &[Pose]) -> Self {
        let ids: BTreeSet<KeyframeId> =
            places.iter().flat_map(|t| nearest(poses, t, AROUND)).filter(|id| kept.contains_key(id)).collect();
        let scans: Vec<(KeyframeId, Pose, Arc<KeyframeScan>)> =
            ids.iter().filter_map(|id| Some((*id, poses[id], kept[id].scan.get()?))).collect();
        let voxel_m = voxel_for(scans.iter().map(|s| range(&s.2)).fold(0.0, f64::max));
        let of_hits = scans.iter().flat_map(|s| &s.2.hits.positions).map(|p| f64::from(p.coords.norm()));
        let farthest_m = of_hits.fold(0.0, f64::max);
        let mut surface = Levels::new(VOXELS * voxel_m);
        fn points((_, t, scan): &(KeyframeId, Pose, Arc<KeyframeScan>)) -> impl Iterator<Item = Point3<f64>> + '_ {
            scan.hits.positions.iter().step_by(EVERY).map(move |p| t * p.cast::<f64>())
        }
        surface.insert(&scans.iter().flat_map(points).collect::<Vec<Point3<f64>>>(), None);
        let view = |(id, t, scan): (KeyframeId, Pose, Arc<KeyframeScan>)| {
            (id, (t, Sight::new(&scan.hits.positions, &scan.t_base_sensor)))
        };
        Self { surface, voxel_m, farthest_m, views: scans.into_iter().map(view).collect() }
    }

    /// Where a scan is that is expected at `t_map_base`, in the map.
    pub(super) fn measure(
        &self,
        scan: &KeyframeScan,
        t_map_base: &Pose,
        strictness: &Strictness,
    ) -> Result<Registration, Refused> {
        let found = self.place(scan, t_map_base).ok_or(Refused::Misfit)?;
        let off = t_map_base.inv_mul(&found.t_odom_base);
        let (metres, radians) = (MOST_MOVED * EXPECTED.0 * self.voxel_m, MOST_MOVED * EXPECTED.1);
        let near = off.translation.vector.norm() < metres && off.rotation.angle() < radians;
        let against = self.contradicted(scan, &found.t_odom_base);
        if against.share() > strictness.max_contradicted {
            return Err(Refused::Contradicted);
        }
        if !near || found.inlier_ratio < strictness.min_inlier_ratio {
            return Err(Refused::Misfit);
        }
        let sigma = |from: usize| (from..from + 3).map(|k| found.covariance[(k, k)]).fold(0.0, f64::max).sqrt();
        let is_open = found.degenerate_axes.contains(&true)
            || sigma(0) > FIXED.0 * self.voxel_m
            || sigma(3) > FIXED.1
            || against.compared() == 0.0;
        match is_open {
            true => Err(Refused::Open),
            false => {
                let covariance = found.covariance + diagonal(FLOOR.0 * self.voxel_m, FLOOR.1);
                Ok(Registration { covariance, ..found })
            }
        }
    }

    /// Whether a scan that does not fit contradicts what is known here, rather than that most of it lies where nobody has been.
    pub(super) fn contradicts(&self, scan: &KeyframeScan, t_map_base: &Pose, strictness: &Strictness) -> bool {
        self.contradicted(scan, t_map_base).share() > strictness.max_contradicted
    }

    /// The keyframe nearest to a pose, and base seen from it.
    pub(super) fn seen_from(&self, t_map_base: &Pose) -> Option<(KeyframeId, Pose)> {
        let from = |(id, (t, _)): (&KeyframeId, &(Pose, Sight))| (*id, t.inv_mul(t_map_base));
        self.views.iter().map(from).min_by(|a, b| length(&a.1).total_cmp(&length(&b.1)))
    }

    fn place(&self, scan: &KeyframeScan, t_map_base: &Pose) -> Option<Registration> {
        let points = &scan.hits.positions;
        let mut thinner = Thinner::default();
        let is_comparable = |i: &u32| f64::from(points[*i as usize].coords.norm()) <= self.farthest_m;
        let all: Vec<u32> = (0..points.len() as u32).filter(is_comparable).collect();
        let mut spacing = 0.5 * self.voxel_m;
        let mut indices = thinner.even(points, &all, spacing);
        while indices.len() > POINTS {
            spacing *= 1.3;
            indices = thinner.even(points, &indices, spacing);
        }
        if indices.len() < 50 {
            return None;
        }
        let instants = Instants::new(None);
        let covariance = diagonal(EXPECTED.0 * self.voxel_m, EXPECTED.1);
        let problem = Problem {
            sweep: &Sweep::new(points, None, &Pose::identity(), &instants, &indices),
            map: &self.surface,
            prediction: &Prediction::within(*t_map_base, covariance),
            velocity: Vector6::zeros(),
            agility: 1.0,
            expected_error: 2.0 * EXPECTED.0 * self.voxel_m,
            max_iterations: 20,
            min_overlap: 0.3,
            min_inlier_ratio: 0.5,
        };
        align(&problem).ok().map(|(found, _)| found)
    }

    /// What a scan at a pose and the keyframes around contradict each other in: the larger of both directions.
    fn contradicted(&self, scan: &KeyframeScan, t_map_base: &Pose) -> Contradiction {
        let own = Sight::new(&scan.hits.positions, &scan.t_base_sensor);
        let poses = self.views.iter().map(|(id, v)| (*id, v.0)).collect();
        own.contradicted(nearest(&poses, t_map_base, COMPARED).into_iter().map(|id| {
            let (t_map_view, sight) = &self.views[&id];
            (sight, t_map_base.inv_mul(t_map_view))
        }))
    }
}

/// The keyframes nearest to a pose, at most so many.
fn nearest(poses: &BTreeMap<KeyframeId, Pose>, t_map_base: &Pose, most: usize) -> Vec<KeyframeId> {
    let mut all: Vec<(f64, KeyframeId)> = poses.iter().map(|(id, t)| (length(&t.inv_mul(t_map_base)), *id)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    all.into_iter().take(most).map(|a| a.1).collect()
}
