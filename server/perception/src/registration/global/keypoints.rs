//! A cloud thinned, with normals and features.

use super::super::RegistrationError;
use super::super::fpfh::{Fpfh, fpfh_of_some};
use super::{FEWEST_PAIRS, GlobalParams};
use crate::cloud::{Scatter, symmetric_eigen3, voxel_downsample};
use crate::search::{KdTree, Neighbors};
use nalgebra::{Point3, Vector3};
use percept_geometry::PointCloud;
use rayon::prelude::*;

/// Radius of the neighbourhood that gives a normal, voxels.
const NORMAL_RADIUS: f64 = 3.0;
/// Nearest neighbours used for each, at most.
const NORMAL_NEIGHBORS: usize = 30;
const FEATURE_NEIGHBORS: usize = 150;
/// A point is inside a surface if its neighbours' mean is off it by less than this share of their reach, along the surface:
/// at the edge of a plane it is 0.42, two thirds of the reach from it 0.1.
const INSIDE: f64 = 0.1;
/// Features of more points than this cost more than they bring.
const MAX_FEATURES: usize = 5000;

/// A thinned cloud and what its points look like.
pub(super) struct Described {
    /// One point a voxel, metres, with normals.
    pub(super) cloud: PointCloud,
    /// How far each point's surroundings are from flat, 0 to 1/3.
    pub(super) curvature: Vec<f32>,
    /// Whether each point's surroundings go on to all sides: what was seen does not end there.
    pub(super) inside: Vec<bool>,
    /// Of the points, by distance: the neighbourhoods of the first features.
    wide: Neighbors,
    tree: KdTree,
    size: f64,
}

/// Points that have a feature, and their features.
pub(super) struct Keys {
    pub(super) positions: Vec<Point3<f64>>,
    pub(super) features: Vec<Fpfh>,
}

impl Described {
    pub(super) fn new(
        field: &'static str,
        cloud: &PointCloud,
        params: &GlobalParams,
    ) -> Result<Self, RegistrationError> {
        let size = params.voxel_size_m;
        let bare = PointCloud::from_positions(cloud.positions.clone());
        let mut thin = voxel_downsample(&bare, size)?;
        if thin.len() < FEWEST_PAIRS {
            return Err(RegistrationError::TooFewPoints { field, num_points: thin.len(), needed: FEWEST_PAIRS });
        }
        let tree = KdTree::build(&thin.positions);
        let wide = tree.hybrid_all((super::FEATURE_RADII[0] * size) as f32, FEATURE_NEIGHBORS);
        let limit2 = ((NORMAL_RADIUS * size) as f32).powi(2);
        let one = |i| Around::of(&thin.positions, i, &wide, limit2);
        let around: Vec<Around> = (0..thin.len()).into_par_iter().with_min_len(64).map(one).collect();
        thin.normals = Some(around.iter().map(|a| a.normal).collect());
        let curvature = around.iter().map(|a| a.curvature).collect();
        let inside = around.iter().map(|a| a.inside).collect();
        Ok(Self { cloud: thin, curvature, inside, wide, tree, size })
    }

    /// Features of the points whose surroundings are least flat, from neighbourhoods of so many voxels.
    pub(super) fn keys(&self, radius_voxels: f64) -> Keys {
        let other;
        let neighbors = if radius_voxels == super::FEATURE_RADII[0] {
            &self.wide
        } else {
            other = self.tree.hybrid_all((radius_voxels * self.size) as f32, FEATURE_NEIGHBORS);
            &other
        };
        let normals = self.cloud.normals.as_deref().unwrap_or_default();
        let keys = choose(neighbors, normals, &self.curvature);
        Keys {
            positions: keys.iter().map(|&k| self.cloud.positions[k as usize].cast()).collect(),
            features: fpfh_of_some(&keys, &self.cloud.positions, normals, neighbors),
        }
    }
}

/// What is around a point.
#[derive(Clone, Copy, Default)]
struct Around {
    normal: Vector3<f32>,
    curvature: f32,
    inside: bool,
}

impl Around {
    /// Normal of a point, how far its wide neighbourhood is from flat, and whether it goes on to all sides.
    ///
    /// The normal's side is the one to which the wide neighbourhood bends: a rule that moves with the cloud, since from
    /// where the cloud was seen is not known.
    fn of(positions: &[Point3<f32>], i: usize, wide: &Neighbors, limit2: f32) -> Self {
        let (indices, distances2) = wide.of(i);
        let near = distances2.partition_point(|d| *d <= limit2).clamp(1, NORMAL_NEIGHBORS).min(indices.len());
        if near < 3 {
            return Self::default();
        }
        let p: Point3<f64> = positions[i].cast();
        let scatter = |among: &[u32]| {
            let mut s = Scatter::new(p);
            among.iter().for_each(|&j| s.add(&positions[j as usize].cast()));
            s
        };
        let n = symmetric_eigen3(&scatter(&indices[..near]).covariance()).vectors[0];
        let around = scatter(indices);
        let [flat, middle, long] = symmetric_eigen3(&around.covariance()).values;
        let curvature = flat / (flat + middle + long).max(1e-30);
        let off = around.mean() - p;
        let bend = off.dot(&n);
        let reach = f64::from(distances2.last().copied().unwrap_or_default()).sqrt();
        Self {
            normal: (if bend < 0.0 { -n } else { n }).cast(),
            curvature: curvature as f32,
            inside: (off - n * bend).norm() < INSIDE * reach,
        }
    }
}

/// The points whose surroundings are least flat, and that have a normal and neighbours; in the order of the cloud.
fn choose(neighbors: &Neighbors, normals: &[Vector3<f32>], curvature: &[f32]) -> Vec<u32> {
    let usable = |i: &u32| normals[*i as usize] != Vector3::zeros() && neighbors.of(*i as usize).0.len() > 1;
    let mut keys: Vec<u32> = (0..normals.len() as u32).filter(usable).collect();
    if keys.len() > MAX_FEATURES {
        let order = |a: &u32, b: &u32| curvature[*b as usize].total_cmp(&curvature[*a as usize]).then(a.cmp(b));
        keys.select_nth_unstable_by(MAX_FEATURES, order);
        keys.truncate(MAX_FEATURES);
        keys.sort_unstable();
    }
    keys
}
