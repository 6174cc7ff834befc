//! The rigid motion that fits pairs of points best.

use super::matching::Pair;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use percept_geometry::Pose;

/// Least squares; none for fewer than three pairs or pairs in a line.
///
/// Source: Kabsch 1976; Umeyama, "Least-squares estimation of transformation parameters", 1991.
pub(super) fn fit<'a>(pairs: impl Iterator<Item = &'a Pair> + Clone) -> Option<Pose> {
    let n = pairs.clone().count() as f64;
    if n < 3.0 {
        return None;
    }
    let (mut mean_s, mut mean_t) = (Vector3::zeros(), Vector3::zeros());
    for p in pairs.clone() {
        mean_s += p.source.coords / n;
        mean_t += p.target.coords / n;
    }
    let mut h = Matrix3::zeros();
    for p in pairs {
        h += (p.target.coords - mean_t) * (p.source.coords - mean_s).transpose();
    }
    let svd = h.svd(true, true);
    let (u, vt) = (svd.u?, svd.v_t?);
    if svd.singular_values[1] <= 1e-9 * svd.singular_values[0] {
        return None;
    }
    let mut flip = Matrix3::identity();
    flip[(2, 2)] = (u.determinant() * vt.determinant()).signum();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * flip * vt));
    Some(Pose::from_parts((mean_t - rotation * mean_s).into(), rotation))
}

/// Fits again on the pairs that the motion puts within `distance_m`, until they stay the same; the motion and their
/// number.
pub(super) fn settle(start: Pose, pairs: &[Pair], distance_m: f64) -> Option<(Pose, usize)> {
    let (mut t, mut before) = (start, 0);
    for _ in 0..6 {
        let near = |p: &&Pair| (t * p.source - p.target).norm_squared() < distance_m * distance_m;
        let count = pairs.iter().filter(near).count();
        if count == before {
            break;
        }
        before = count;
        let near: Vec<Pair> = pairs.iter().filter(near).copied().collect();
        t = fit(near.iter())?;
    }
    Some((t, before))
}
