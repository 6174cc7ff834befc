//! A cloud with what registration needs of it: normals, a search tree, voxels, brightness.

use super::{GaussianVoxels, IcpMethod, IcpParams, RegistrationError};
use crate::cloud::nearest_normals;
use crate::search::{KdTree, Neighbor};
use nalgebra::{Matrix3, Point3, Vector3};
use percept_geometry::{PointCloud, cloud::is_finite};
use rayon::prelude::*;

/// Points a task: fixed, so that the number of threads changes nothing.
const CHUNK: usize = 512;
/// Fewer points on a side cannot fix a pose.
const FEWEST: usize = 6;

/// A cloud made ready once, to be aligned many times.
#[derive(Debug, Clone, Default)]
pub struct PreparedCloud {
    /// N finite points, metres.
    pub(super) points: Vec<Point3<f32>>,
    /// N unit normals, zero where undefined; empty if the method needs none.
    pub(super) normals: Vec<Vector3<f32>>,
    /// N brightnesses, 0 to 1, or empty.
    pub(super) brightness: Vec<f32>,
    /// N gradients of the brightness along the surface, 1/m, or empty.
    pub(super) gradients: Vec<Vector3<f32>>,
    pub(super) tree: Option<KdTree>,
    pub(super) voxels: Option<GaussianVoxels>,
}

impl PreparedCloud {
    /// What `params.method` needs of the cloud that is moved. Normals of the cloud are used if it has them.
    ///
    /// # Errors
    /// `BadParam`, `TooFewPoints`, `Missing` colours.
    pub fn source(cloud: &PointCloud, params: &IcpParams) -> Result<Self, RegistrationError> {
        params.validate()?;
        let mut out = Self::finite("source", cloud, params.method)?;
        if matches!(params.method, IcpMethod::Gicp | IcpMethod::Vgicp) && out.normals.is_empty() {
            out.normals = nearest_normals(&out.points, &KdTree::build(&out.points), params.num_neighbours);
        }
        Ok(out)
    }

    /// What `params.method` needs of the cloud that stands. Normals of the cloud are used if it has them.
    ///
    /// # Errors
    /// `BadParam`, `TooFewPoints`, `Missing` colours.
    pub fn target(cloud: &PointCloud, params: &IcpParams) -> Result<Self, RegistrationError> {
        params.validate()?;
        let mut out = Self::finite("target", cloud, params.method)?;
        let tree = KdTree::build(&out.points);
        if params.method == IcpMethod::PointToPoint {
            out.normals.clear();
        } else if out.normals.is_empty() {
            out.normals = nearest_normals(&out.points, &tree, params.num_neighbours);
        }
        if params.method == IcpMethod::Colored {
            out.gradients = gradients(&out, &tree, params.num_neighbours);
        }
        if params.method == IcpMethod::Vgicp {
            out.voxels = Some(GaussianVoxels::new(&out.points, &out.normals, params.target_voxel_size_m));
        } else {
            out.tree = Some(tree);
        }
        Ok(out)
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    fn finite(field: &'static str, cloud: &PointCloud, method: IcpMethod) -> Result<Self, RegistrationError> {
        cloud.validate().map_err(crate::cloud::CloudError::from)?;
        let cloud = cloud.retain_finite();
        if cloud.len() < FEWEST {
            return Err(RegistrationError::TooFewPoints { field, num_points: cloud.len(), needed: FEWEST });
        }
        let brightness = match (method, cloud.colors) {
            (IcpMethod::Colored, None) => return Err(RegistrationError::Missing { cloud: field, channel: "colours" }),
            (IcpMethod::Colored, Some(colors)) => {
                colors.iter().map(|c| c.iter().map(|&v| f32::from(v)).sum::<f32>() / (3.0 * 255.0)).collect()
            }
            _ => vec![],
        };
        let mut normals = cloud.normals.unwrap_or_default();
        for n in &mut normals {
            *n = n.try_normalize(0.5).filter(|n| n.iter().all(|v| v.is_finite())).unwrap_or_default();
        }
        Ok(Self { points: cloud.positions, normals, brightness, ..Self::default() })
    }
}

/// How brightness changes along the tangent plane: least squares over the `k` nearest (eq. 10 of the paper, with the
/// gradient held across the normal).
fn gradients(cloud: &PreparedCloud, tree: &KdTree, k: usize) -> Vec<Vector3<f32>> {
    let one = |found: &mut Vec<Neighbor>, i: usize| {
        let (p, n) = (cloud.points[i].cast::<f64>(), cloud.normals[i].cast::<f64>());
        if !is_finite(&cloud.points[i]) || n == Vector3::zeros() {
            return Vector3::zeros();
        }
        tree.knn_into(&cloud.points[i], k, found);
        let mut a = Matrix3::zeros();
        let (mut b, mut reach2) = (Vector3::zeros(), 0.0);
        for f in found.iter() {
            let d = cloud.points[f.index].cast::<f64>() - p;
            let d = d - n * n.dot(&d);
            a += d * d.transpose();
            b += d * f64::from(cloud.brightness[f.index] - cloud.brightness[i]);
            reach2 += d.norm_squared();
        }
        // A pull to zero across the normal makes the equations regular.
        a += n * n.transpose() * reach2 + Matrix3::identity() * (1e-6 * reach2 + 1e-30);
        a.cholesky().map_or_else(Vector3::zeros, |c| c.solve(&b)).cast()
    };
    (0..cloud.points.len()).into_par_iter().with_min_len(CHUNK).map_init(Vec::new, one).collect()
}
