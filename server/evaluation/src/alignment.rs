//! The rigid or similarity transform that brings an estimate onto the reference, by least squares.

use crate::{EvaluationError, PosePair};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use percept_geometry::Pose;
use serde::{Deserialize, Serialize};

/// Which freedom the alignment has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// None: both trajectories are in the same frame.
    None,
    /// The first poses are laid onto each other (evo's `--align_origin`).
    Origin,
    /// Rotation and translation (evo's `-a`).
    #[default]
    Se3,
    /// Rotation, translation and scale (evo's `-as`), for estimates of unknown scale.
    Sim3,
}

/// `p_reference = t_reference_estimate * (scale * p_estimate)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Estimate's frame, once scaled, to the reference's.
    pub t_reference_estimate: Pose,
    /// Scale of the estimate; 1 unless asked for.
    pub scale: f64,
    /// How many directions the positions span together: below 2 they do not determine the rotation (a straight
    /// line, a point), and the smallest rotation that fits is taken.
    pub rank: usize,
}

impl Similarity {
    /// No change.
    pub fn identity() -> Self {
        Self { t_reference_estimate: Pose::identity(), scale: 1.0, rank: 3 }
    }

    /// The estimated pose in the reference's frame and scale.
    pub fn apply(&self, estimate: &Pose) -> Pose {
        let mut scaled = *estimate;
        scaled.translation.vector *= self.scale;
        self.t_reference_estimate * scaled
    }
}

/// The transform that lays the estimate over the reference: for `Se3` and `Sim3` that of the positions which has the least sum of squared distances to the true ones.
///
/// Source: Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
/// 1991, eq. 38 to 43.
///
/// # Errors
/// `ScaleUndetermined` for `Sim3` if all positions of one side coincide; `NoCommonStamps` for no pair.
pub fn align(pairs: &[PosePair], alignment: Alignment) -> Result<Similarity, EvaluationError> {
    if pairs.is_empty() {
        return Err(EvaluationError::NoCommonStamps { num_reference: 0, num_estimate: 0, max_difference_s: 0.0 });
    }
    match alignment {
        Alignment::None => return Ok(Similarity::identity()),
        Alignment::Origin => {
            let t_reference_estimate = pairs[0].reference * pairs[0].estimate.inverse();
            return Ok(Similarity { t_reference_estimate, ..Similarity::identity() });
        }
        Alignment::Se3 | Alignment::Sim3 => {}
    }
    let count = pairs.len() as f64;
    let mean = |f: &dyn Fn(&PosePair) -> Vector3<f64>| pairs.iter().map(f).sum::<Vector3<f64>>() / count;
    let mean_reference = mean(&|p| p.reference.translation.vector);
    let mean_estimate = mean(&|p| p.estimate.translation.vector);
    let mut covariance = Matrix3::zeros();
    let mut variance = 0.0;
    for pair in pairs {
        let y = pair.reference.translation.vector - mean_reference;
        let x = pair.estimate.translation.vector - mean_estimate;
        covariance += y * x.transpose() / count;
        variance += x.norm_squared() / count;
    }
    let (rotation, trace, rank) = rotation_of(&covariance);
    let scale = match alignment {
        Alignment::Sim3 if rank == 0 => return Err(EvaluationError::ScaleUndetermined),
        Alignment::Sim3 => trace / variance,
        _ => 1.0,
    };
    let translation = mean_reference - rotation * mean_estimate * scale;
    Ok(Similarity { t_reference_estimate: Pose::from_parts(translation.into(), rotation), scale, rank })
}

/// The rotation that maximises the trace of `rotation^T * covariance`, the maximum, and the covariance's rank.
fn rotation_of(covariance: &Matrix3<f64>) -> (UnitQuaternion<f64>, f64, usize) {
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return (UnitQuaternion::identity(), 0.0, 0) };
    let d = svd.singular_values;
    // Relative, so that millimetres and kilometres are judged alike; absolute against rounding of equal positions.
    let rank = d.iter().filter(|&&s| s > 1e-12 * d[0] && s > 1e-24).count();
    let mut sign = Vector3::repeat(1.0);
    if u.determinant() * v_t.determinant() < 0.0 {
        sign.z = -1.0;
    }
    let rotation = match rank {
        0 => UnitQuaternion::identity(),
        1 => shortest_arc(&v_t.row(0).transpose(), &u.column(0).into_owned()),
        _ => {
            let matrix = u * Matrix3::from_diagonal(&sign) * v_t;
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
        }
    };
    (rotation, d.dot(&sign), rank)
}

/// The smallest rotation that turns `from` to `to`.
fn shortest_arc(from: &Vector3<f64>, to: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(from, to).unwrap_or_else(|| {
        // Opposite directions: half a turn about any axis across.
        let across = from.cross(&Matrix3::identity().column(from.iamin()).into_owned());
        UnitQuaternion::from_axis_angle(&nalgebra::Unit::new_normalize(across), std::f64::consts::PI)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use percept_geometry::{Timestamp, se3};
    use proptest::prelude::*;

    fn pairs(truth: &Similarity, positions: &[[f64; 3]]) -> Vec<PosePair> {
        positions
            .iter()
            .map(|p| {
                let estimate = Pose::translation(p[0], p[1], p[2]);
                PosePair { stamp: Timestamp(0), reference: truth.apply(&estimate), estimate }
            })
            .collect()
    }

    fn cost(s: &Similarity, pairs: &[PosePair]) -> f64 {
        let error = |p: &PosePair| s.apply(&p.estimate).translation.vector - p.reference.translation.vector;
        pairs.iter().map(|p| error(p).norm_squared()).sum()
    }

    proptest! {
        #[test]
        fn a_similarity_is_found_again(
            xi in prop::array::uniform6(-2.0..2.0f64),
            scale in 0.1..10.0f64,
            positions in prop::collection::vec(prop::array::uniform3(-5.0..5.0f64), 5..20),
        ) {
            let truth = Similarity { t_reference_estimate: se3::exp(&Vector6::from_row_slice(&xi)), scale, rank: 3 };
            let found = align(&pairs(&truth, &positions), Alignment::Sim3).unwrap();
            prop_assert!((found.scale / scale - 1.0).abs() < 1e-9);
            let off = se3::log(&(found.t_reference_estimate.inverse() * truth.t_reference_estimate));
            prop_assert!(off.norm() < 1e-6, "{off}");
        }

        /// Mirrored positions are where the sign of eq. 39 matters: a reflection would fit, a rotation must not be one.
        #[test]
        fn no_nearby_rigid_transform_is_better(
            positions in prop::collection::vec(prop::array::uniform6(-5.0..5.0f64), 3..12),
            mirrored in any::<bool>(),
            step in prop::array::uniform6(-0.1..0.1f64),
        ) {
            let flip = if mirrored { -1.0 } else { 0.3 };
            let pairs: Vec<PosePair> = positions.iter().map(|p| PosePair {
                stamp: Timestamp(0),
                reference: Pose::translation(p[0], p[1], p[2]),
                estimate: Pose::translation(flip * p[0] + 0.1 * p[3], p[1] + 0.1 * p[4], p[2] + 0.1 * p[5]),
            }).collect();
            let best = align(&pairs, Alignment::Se3).unwrap();
            prop_assert_eq!(best.scale, 1.0);
            let t_reference_estimate = best.t_reference_estimate * se3::exp(&Vector6::from_row_slice(&step));
            let other = Similarity { t_reference_estimate, ..best };
            prop_assert!(cost(&best, &pairs) <= cost(&other, &pairs) + 1e-9);
        }
    }

    #[test]
    fn a_straight_line_is_aligned_without_turning_about_itself() {
        let quarter = Similarity { t_reference_estimate: se3::from_xy_yaw(1.0, 2.0, 1.5), scale: 1.0, rank: 1 };
        let line: Vec<[f64; 3]> = (0..10).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        let found = align(&pairs(&quarter, &line), Alignment::Se3).unwrap();
        assert_eq!(found.rank, 1);
        assert!(se3::log(&(found.t_reference_estimate.inverse() * quarter.t_reference_estimate)).norm() < 1e-9);
        let back = Similarity { t_reference_estimate: se3::from_xy_yaw(0.0, 0.0, std::f64::consts::PI), ..quarter };
        let pairs_back = pairs(&back, &line);
        assert!(cost(&align(&pairs_back, Alignment::Se3).unwrap(), &pairs_back) < 1e-18);
    }

    #[test]
    fn a_body_at_rest_is_shifted_only_and_has_no_scale() {
        let shift = Similarity { t_reference_estimate: Pose::translation(1.0, 0.0, 0.0), scale: 1.0, rank: 0 };
        let rest = pairs(&shift, &[[2.0, 3.0, 4.0]; 5]);
        assert_eq!(align(&rest, Alignment::Se3).unwrap(), shift);
        assert_eq!(align(&rest, Alignment::Sim3), Err(EvaluationError::ScaleUndetermined));
    }
}
