//! The relative pose of two calibrated cameras.

use super::five_point::essential_matrices;
use super::ransac::{Problem, search};
use super::{MultiviewError, RansacParams, finite, normalised, same_length};
use nalgebra::{Matrix3, Matrix5, Point2, Point3, Rotation3, Unit, UnitQuaternion, Vector2, Vector3, Vector5};
use percept_geometry::{CameraIntrinsics, Pose};

/// What two images tell about how their cameras stood.
#[derive(Debug, Clone, PartialEq)]
pub struct EssentialEstimate {
    /// `x_b' E x_a = 0` for normalised points; Frobenius norm 1.
    pub essential: Matrix3<f64>,
    /// Camera a in camera b; the translation has length 1, its true length is unknown.
    pub t_b_a: Pose,
    /// Correspondences that fit and whose point lies in front of both cameras, ascending.
    pub inliers: Vec<usize>,
    /// Of those, how many show a parallax of more than a quarter of a degree: few mean that the translation is a guess.
    pub num_with_parallax: usize,
    /// Root mean square of the inliers' Sampson distances, pixels.
    pub rmse_px: f64,
    /// Samples that were drawn.
    pub iterations: usize,
}

/// Parallax below this tells nothing about the translation, radians.
const LITTLE_PARALLAX: f64 = 0.0044;

/// Estimates the relative pose from pixels `a[i]` and `b[i]` that show the same points: five-point samples, scored by
/// Sampson's distance, refined on their inliers by Gauss-Newton over rotation and direction.
///
/// Sources: Nister 2004; Hartley and Zisserman, "Multiple view geometry", 2004, sections 9.6 (which of the four poses has
/// the points in front) and 11.4.3 (Sampson distance).
///
/// # Errors
/// `Input` for parameters, intrinsics or lengths; `TooFew` below six finite pairs; `NoModel` if nothing fits six.
pub fn estimate_essential(
    a: &[Point2<f64>],
    b: &[Point2<f64>],
    camera_a: &CameraIntrinsics,
    camera_b: &CameraIntrinsics,
    params: &RansacParams,
) -> Result<EssentialEstimate, MultiviewError> {
    params.validate()?;
    camera_a.validate()?;
    camera_b.validate()?;
    same_length("points_b", a.len(), b.len())?;
    let usable: Vec<usize> = (0..a.len()).filter(|&i| finite(&a[i]) && finite(&b[i])).collect();
    let pairs: Vec<Pair> = usable.iter().map(|&i| (normalised(camera_a, &a[i]), normalised(camera_b, &b[i]))).collect();
    if pairs.len() < MIN_INLIERS {
        return Err(MultiviewError::TooFew { got: pairs.len(), needed: MIN_INLIERS });
    }
    let focal = 0.25 * (camera_a.fx + camera_a.fy + camera_b.fx + camera_b.fy);
    let threshold = params.threshold_px / focal;
    let problem = Relative { pairs: &pairs, inverse2: 1.0 / (threshold * threshold) };
    let nothing = MultiviewError::NoModel { got: pairs.len(), needed: MIN_INLIERS };
    let found = search(&problem, params).ok_or_else(|| nothing.clone())?;
    let Some((t_b_a, in_front)) = choose_pose(&found.model, &pairs, &found.inliers) else { return Err(nothing) };
    if in_front.len() < MIN_INLIERS {
        return Err(nothing);
    }
    let squares: f64 = in_front.iter().map(|&i| sampson2(&found.model, &pairs[i])).sum();
    let with_parallax = in_front.iter().filter(|&&i| parallax(&t_b_a, &pairs[i]) > LITTLE_PARALLAX).count();
    Ok(EssentialEstimate {
        essential: found.model,
        t_b_a,
        num_with_parallax: with_parallax,
        rmse_px: (squares / in_front.len() as f64).sqrt() * focal,
        inliers: in_front.into_iter().map(|i| usable[i]).collect(),
        iterations: found.iterations,
    })
}

/// Normalised points of a correspondence.
pub(super) type Pair = (Vector2<f64>, Vector2<f64>);

/// Five give the model; a sixth has to agree.
const MIN_INLIERS: usize = 6;

struct Relative<'a> {
    pairs: &'a [Pair],
    /// One over the squared threshold.
    inverse2: f64,
}

impl Problem for Relative<'_> {
    type Model = Matrix3<f64>;
    const SAMPLE: usize = 5;

    fn len(&self) -> usize {
        self.pairs.len()
    }

    fn solve(&self, sample: &[usize], out: &mut Vec<Matrix3<f64>>) {
        let pairs: [Pair; 5] = std::array::from_fn(|i| self.pairs[sample[i]]);
        essential_matrices(&pairs, out);
    }

    #[inline]
    fn error2(&self, e: &Matrix3<f64>, i: usize) -> f64 {
        sampson2(e, &self.pairs[i]) * self.inverse2
    }

    fn refine(&self, e: &Matrix3<f64>, inliers: &[usize]) -> Option<Matrix3<f64>> {
        let (t_b_a, _) = choose_pose(e, self.pairs, inliers)?;
        Some(refine_pose(t_b_a, self.pairs, inliers))
    }
}

/// Squared Sampson distance of a pair from its epipolar constraint, in normalised units.
#[inline]
pub(super) fn sampson2(e: &Matrix3<f64>, (a, b): &Pair) -> f64 {
    let (l, lt) = (e * a.push(1.0), e.tr_mul(&b.push(1.0)));
    let residual = b.x * l.x + b.y * l.y + l.z;
    residual * residual / (l.x * l.x + l.y * l.y + lt.x * lt.x + lt.y * lt.y)
}

pub(super) fn essential_of(rotation: &UnitQuaternion<f64>, direction: &Unit<Vector3<f64>>) -> Matrix3<f64> {
    let e = direction.cross_matrix() * rotation.to_rotation_matrix().matrix();
    e / std::f64::consts::SQRT_2
}

/// Gauss-Newton on Sampson's distances over the rotation and the direction of the translation.
fn refine_pose(t_b_a: Pose, pairs: &[Pair], inliers: &[usize]) -> Matrix3<f64> {
    let mut rotation = t_b_a.rotation;
    let mut direction = Unit::new_normalize(t_b_a.translation.vector);
    for _ in 0..5 {
        let e = essential_of(&rotation, &direction);
        let r = rotation.to_rotation_matrix();
        // Two directions across the translation's.
        let across = direction.cross(&if direction.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() }).normalize();
        let along = direction.cross(&across);
        // dE for each parameter: turning camera a's rays, and moving the direction.
        let half = 1.0 / std::f64::consts::SQRT_2;
        let turned = |axis: Vector3<f64>| e * axis.cross_matrix();
        let d = [
            turned(Vector3::x()),
            turned(Vector3::y()),
            turned(Vector3::z()),
            across.cross_matrix() * r.matrix() * half,
            along.cross_matrix() * r.matrix() * half,
        ];
        let (mut h, mut g) = (Matrix5::zeros(), Vector5::zeros());
        for &i in inliers {
            let (a, b) = (pairs[i].0.push(1.0), pairs[i].1.push(1.0));
            let (l, lt) = (e * a, e.tr_mul(&b));
            let weight = 1.0 / (l.x * l.x + l.y * l.y + lt.x * lt.x + lt.y * lt.y);
            if !weight.is_finite() {
                continue;
            }
            // The denominator changes slowly: it is held.
            let j = Vector5::from_fn(|k, _| b.dot(&(d[k] * a)));
            let residual = b.dot(&l);
            h.syger(weight, &j, &j, 1.0);
            g.axpy(weight * residual, &j, 1.0);
        }
        h.fill_upper_triangle_with_lower_triangle();
        let Some(step) = (h + Matrix5::identity() * 1e-12).cholesky().map(|c| c.solve(&g)) else { break };
        rotation *= UnitQuaternion::from_scaled_axis(-Vector3::new(step[0], step[1], step[2]));
        direction = Unit::new_normalize(direction.into_inner() - across * step[3] - along * step[4]);
        if step.norm() < 1e-9 {
            break;
        }
    }
    essential_of(&rotation, &direction)
}

/// The pose, of the four that give this matrix, with most of the points in front of both cameras; and these points.
fn choose_pose(e: &Matrix3<f64>, pairs: &[Pair], among: &[usize]) -> Option<(Pose, Vec<usize>)> {
    let svd = e.svd(true, true);
    let (mut u, mut vt) = (svd.u?, svd.v_t?);
    // The null direction last; nalgebra sorts singular values.
    if u.determinant() < 0.0 {
        u = -u;
    }
    if vt.determinant() < 0.0 {
        vt = -vt;
    }
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let t: Vector3<f64> = u.column(2).into();
    let poses = [(w, t), (w, -t), (w.transpose(), t), (w.transpose(), -t)].map(|(w, t)| {
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * w * vt));
        Pose::from_parts(t.into(), rotation)
    });
    let front = |pose: &Pose| among.iter().copied().filter(|&i| in_front(pose, &pairs[i])).collect::<Vec<_>>();
    let judged = poses.map(|pose| (front(&pose), pose));
    judged.into_iter().max_by_key(|(front, _)| front.len()).map(|(front, pose)| (pose, front))
}

/// Whether the rays meet at positive depths; parallel rays are taken to meet far away.
pub(super) fn in_front(t_b_a: &Pose, (a, b): &Pair) -> bool {
    let ray_a = t_b_a.rotation * a.push(1.0);
    let (ray_b, t) = (b.push(1.0), t_b_a.translation.vector);
    // Depths d_a, d_b with d_a ray_a + t = d_b ray_b in the least-squares sense.
    let (aa, ab, bb) = (ray_a.norm_squared(), ray_a.dot(&ray_b), ray_b.norm_squared());
    let det = aa * bb - ab * ab;
    if det < 1e-9 * aa * bb {
        return ab > 0.0;
    }
    let (at, bt) = (ray_a.dot(&t), ray_b.dot(&t));
    (ab * bt - bb * at) > 0.0 && (aa * bt - ab * at) > 0.0
}

/// Angle between the rays of a pair, radians.
fn parallax(t_b_a: &Pose, (a, b): &Pair) -> f64 {
    (t_b_a.rotation * a.push(1.0)).angle(&Point3::from(b.push(1.0)).coords)
}
