//! Point-to-line refinement of a searched pose on the map's line elements.
//!
//! Source: Censi, "An ICP variant using a point-to-line metric", 2008; the lines are means over the scans
//! of the local map. Degenerate directions (a corridor's length) are left to what wheels say, else to the search.

use crate::matching::field::{Field, Hit};
use crate::odometry::{Found, Prediction, Registration};
use crate::tracking::LostReason;
use nalgebra::{Isometry2, Matrix3, Point2, Vector2, Vector3};
use percept_geometry::{Covariance6, Pose, se3};
use percept_perception::registration::factors::point_to_plane;
use percept_perception::registration::{Degeneracy, NormalEquations, RobustKernel};

/// Of refinement, at most. Halved 15.0 and 23.1, doubled 15.0 and 26.3 ([`super`]).
const ITERATIONS: usize = 12;
/// Largest refinement of a searched pose, metres and radians. Halved 15.1 and 34.6, doubled as it is ([`super`]).
const MAX_REFINEMENT: (f64, f64) = (0.3, 0.1);
/// Noise of a hit against a line element, metres: range noise and the element's own. Halved 15.2 and 25.4, doubled 15.3
/// and 46.8, as half of the loops are missed then ([`super`]).
const NOISE: f64 = 0.02;
/// Neighbouring beams err alike: so many count as one measurement. Halved 15.0 and 22.4, doubled 15.1 and 54.9
/// ([`super`]).
const HITS_PER_MEASUREMENT: f64 = 3.0;
/// Weight of a hit that met no line, along each axis: it meets the same spot only about. Where walls leave their length
/// open, legs and edges are all that tells it. On the second log of [`super`]: halved, a third of the log is lost,
/// doubled 22.8, while the first has 34.1 then.
const POINT_WEIGHT: f64 = 0.3;
/// The same of one that the next scan meets elsewhere. Halved 88 on the second log, doubled 24.6 ([`super`]).
const SPARSE_WEIGHT: f64 = 0.05;
/// A direction that the scan shows with so many times the information of a prior needs half of the prior. Halved 83 and
/// 33.1, doubled 94 and 23.6 on the log with wheels ([`crate::loops::planar`]).
const SHOWN: f64 = 4.0;
/// Least share of a direction in the hits' sensitivity. Halved 85 and 28.8, with 0.80 instead of 0.91 of the frames
/// placed at once, doubled 63 and 16.5, with 0.25 ([`crate::loops::planar`]).
const DEGENERATE: f64 = 0.01;

/// Places the scan, starting at `start`.
pub(crate) fn refine(
    field: &Field,
    hits: &[Hit],
    start: &Isometry2<f64>,
    prediction: &Prediction,
    min_inlier_ratio: f64,
) -> Result<Registration, LostReason> {
    let (centroid, spread) = extent(hits);
    // What is open here is where wheels say; without them the search has seen more than an assumed velocity knows.
    let held = if prediction.is_measured { super::planar(&prediction.t_odom_base) } else { *start };
    let prior = planar_covariance(&prediction.covariance).try_inverse().ok_or(LostReason::Degenerate)?;
    let mut t = *start;
    let mut last = None;
    let mut iterations = 0;
    for k in 0..ITERATIONS {
        // From the search's cell down to the noise.
        let scale = (0.1 * 0.7f64.powi(k as i32)).max(2.0 * NOISE);
        let e = equations(field, hits, &t, scale);
        if (e.num_residuals as f64) < 0.2 * hits.len() as f64 {
            return Err(LostReason::TooFewCorrespondences);
        }
        let degeneracy = Degeneracy::of(&e, &centroid, spread, DEGENERATE);
        let h = degeneracy.keep_good(&e.hessian()) / HITS_PER_MEASUREMENT;
        let g = degeneracy.keep_good_gradient(&e.gradient()) / HITS_PER_MEASUREMENT;
        let d = held.inverse() * t;
        let pull = Vector3::new(d.translation.x, d.translation.y, d.rotation.angle());
        let pick = [0, 1, 5];
        let seen = Matrix3::from_fn(|i, j| h[(pick[i], pick[j])]);
        let prior = if prediction.is_measured { needed(&prior, &seen) } else { prior };
        let information = seen + prior;
        let gradient = Vector3::from_fn(|i, _| g[pick[i]]) + prior * pull;
        let step = -information.cholesky().ok_or(LostReason::Degenerate)?.solve(&gradient);
        if !step.iter().all(|x| x.is_finite()) {
            return Err(LostReason::Degenerate);
        }
        t *= Isometry2::new(Vector2::new(step.x, step.y), step.z);
        iterations += 1;
        last = Some((e, degeneracy, information));
        if k >= 3 && step.xy().norm() < 2e-4 && step.z.abs() < 5e-5 {
            break;
        }
    }
    let Some((e, degeneracy, information)) = last else { return Err(LostReason::TooFewPoints) };
    // The search was exhaustive to a cell: a refinement that runs away slid along something.
    let away = start.inverse() * t;
    if away.translation.vector.norm() > MAX_REFINEMENT.0 || away.rotation.angle().abs() > MAX_REFINEMENT.1 {
        return Err(LostReason::Degenerate);
    }
    let inlier_ratio = fit(field, hits, &t);
    if inlier_ratio < min_inlier_ratio {
        return Err(LostReason::ResidualTooLarge);
    }
    let covariance = information.try_inverse().ok_or(LostReason::Degenerate)?;
    let axes = degeneracy.axes;
    Ok(Registration {
        t_odom_base: se3::from_xy_yaw(t.translation.x, t.translation.y, t.rotation.angle()),
        covariance: spatial_covariance(&covariance),
        inlier_ratio,
        rmse_m: e.rmse(),
        iterations,
        // z, roll and pitch are assumed, not measured, and not open either.
        degenerate_axes: [axes[0], axes[1], false, false, false, axes[5]],
        told: None,
        found: Found::PoseAlone,
    })
}

/// What of a prior's information is needed beside that of the scan: along directions that the scan shows well, nearly
/// nothing. Wheels that are off are so in every step, by scale, mount and slip, while the errors of scans average out: a
/// hundredth of the wheels' word would count fully after a hundred steps.
fn needed(prior: &Matrix3<f64>, seen: &Matrix3<f64>) -> Matrix3<f64> {
    let Some(root) = prior.cholesky().map(|c| c.l()) else { return *prior };
    let Some(inverse) = root.try_inverse() else { return *prior };
    let eigen = (inverse * seen * inverse.transpose()).symmetric_eigen();
    let share = eigen.eigenvalues.map(|ratio| 1.0 / (1.0 + (ratio / SHOWN).powi(2)));
    let weighted = eigen.eigenvectors * Matrix3::from_diagonal(&share) * eigen.eigenvectors.transpose();
    root * weighted * root.transpose()
}

fn equations(field: &Field, hits: &[Hit], t: &Isometry2<f64>, scale: f64) -> NormalEquations {
    let r = *Pose::from_parts(
        nalgebra::Translation3::identity(),
        nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), t.rotation.angle()),
    )
    .rotation
    .to_rotation_matrix()
    .matrix();
    let kernel = RobustKernel::Cauchy(scale);
    let weight = 1.0 / (NOISE * NOISE);
    let flat = |v: &Vector2<f64>| Vector3::new(v.x, v.y, 0.0);
    let mut e = NormalEquations::default();
    for hit in hits {
        let moved = t * hit.p;
        let n = t.rotation * hit.n;
        let Some((target, normal)) = field.element(&moved, &n) else { continue };
        let mut add = |normal: &Vector2<f64>, share: f64| {
            let (residual, j) = point_to_plane::residual(
                &r,
                &flat(&hit.p.coords),
                &flat(&moved.coords),
                &flat(&target.coords),
                &flat(normal),
            );
            e.add(&j, residual, share * weight * kernel.weight(residual));
        };
        if normal == Vector2::zeros() {
            // No line: the offset itself.
            let weight = if hit.is_sparse { SPARSE_WEIGHT } else { POINT_WEIGHT };
            add(&Vector2::x(), weight);
            add(&Vector2::y(), weight);
        } else {
            add(&normal, 1.0);
        }
    }
    e
}

/// Share of the hits on the map: within 0.1 m of a line or 0.15 m of a point.
fn fit(field: &Field, hits: &[Hit], t: &Isometry2<f64>) -> f64 {
    let near = |hit: &&Hit| {
        let moved = t * hit.p;
        field.element(&moved, &(t.rotation * hit.n)).is_some_and(|(target, normal): (Point2<f64>, _)| {
            let d = moved - target;
            if normal == Vector2::zeros() { d.norm() < 0.15 } else { normal.dot(&d).abs() < 0.1 }
        })
    };
    hits.iter().filter(near).count() as f64 / hits.len().max(1) as f64
}

fn extent(hits: &[Hit]) -> (Vector3<f64>, f64) {
    let n = hits.len().max(1) as f64;
    let sum = hits.iter().map(|h| h.p.coords).sum::<Vector2<f64>>() / n;
    let squares = hits.iter().map(|h| h.p.coords.norm_squared()).sum::<f64>() / n;
    (Vector3::new(sum.x, sum.y, 0.0), (squares - sum.norm_squared()).max(0.0).sqrt())
}

fn planar_covariance(c: &Covariance6) -> Matrix3<f64> {
    let pick = [0, 1, 5];
    Matrix3::from_fn(|i, j| c[(pick[i], pick[j])]) + Matrix3::identity() * 1e-9
}

/// z, roll and pitch with a millimetre and a milliradian: the plane is assumed.
fn spatial_covariance(c: &Matrix3<f64>) -> Covariance6 {
    let mut out = Covariance6::identity() * 1e-6;
    let pick = [0, 1, 5];
    for i in 0..3 {
        for j in 0..3 {
            out[(pick[i], pick[j])] = c[(i, j)];
        }
    }
    out
}
