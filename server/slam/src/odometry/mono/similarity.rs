//! Similarities: poses with a scale, what a camera's map can be wrong by. The pose graph optimises them as any pose.

use crate::pose_graph::{Linearised, Manifold};
use nalgebra::{Matrix3, Point3, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};
use percept_geometry::Pose;

/// `p -> scale * rotation * p + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Similarity {
    pub(super) rotation: UnitQuaternion<f64>,
    pub(super) translation: Vector3<f64>,
    pub(super) scale: f64,
}

impl Similarity {
    pub(super) fn of(t: &Pose) -> Self {
        Self { rotation: t.rotation, translation: t.translation.vector, scale: 1.0 }
    }

    pub(super) fn apply(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * p.coords * self.scale + self.translation)
    }

    /// As a camera's pose (map to camera): what it sees stays where it is in the image, depths divided by the scale.
    pub(super) fn to_camera(self) -> Pose {
        Pose::from_parts(Translation3::from(self.translation / self.scale), self.rotation)
    }

    /// The similarity that takes points `a` to points `b` with least squares; none if they leave it open.
    ///
    /// Source: Umeyama, "Least-squares estimation of transformation parameters between two point patterns", 1991.
    pub(super) fn between(a: &[Point3<f64>], b: &[Point3<f64>]) -> Option<Self> {
        let n = a.len() as f64;
        let mean = |p: &[Point3<f64>]| p.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n;
        let (ma, mb) = (mean(a), mean(b));
        let (mut covariance, mut variance) = (Matrix3::zeros(), 0.0);
        for (p, q) in a.iter().zip(b) {
            covariance += (q.coords - mb) * (p.coords - ma).transpose() / n;
            variance += (p.coords - ma).norm_squared() / n;
        }
        let svd = covariance.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        let sign = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
        let rotation = turn_of(&(u * Matrix3::from_diagonal(&sign) * v_t));
        let scale = svd.singular_values.dot(&sign) / variance;
        // Points in a line, or in one place, leave it open.
        let open = svd.singular_values[1] < 1e-6 * svd.singular_values[0];
        let out = Self { rotation, translation: mb - rotation * ma * scale, scale };
        (!open && scale.is_finite() && scale > 1e-3).then_some(out)
    }
}

fn turn_of(rotation: &Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation))
}

/// Derivative of the logarithm of a rotation by a turn in its own frame, at rotation vector `w`.
fn right_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let (k, angle2) = (w.cross_matrix(), w.norm_squared());
    let b = if angle2 < 1e-6 {
        1.0 / 12.0
    } else {
        let angle = angle2.sqrt();
        1.0 / angle2 - (1.0 + angle.cos()) / (2.0 * angle * angle.sin())
    };
    Matrix3::identity() + k * 0.5 + k * k * b
}

/// Shift, rotation vector, logarithm of the scale.
fn parts(s: &Similarity) -> SVector<f64, 7> {
    let (t, w) = (s.translation, s.rotation.scaled_axis());
    SVector::from([t.x, t.y, t.z, w.x, w.y, w.z, s.scale.ln()])
}

impl Manifold<7> for Similarity {
    const SHIFTS: usize = 3;
    const IS_PLANAR: bool = false;

    fn identity() -> Self {
        Self { rotation: UnitQuaternion::identity(), translation: Vector3::zeros(), scale: 1.0 }
    }

    fn compose(&self, other: &Self) -> Self {
        Self {
            rotation: self.rotation * other.rotation,
            translation: self.rotation * other.translation * self.scale + self.translation,
            scale: self.scale * other.scale,
        }
    }

    fn inverse(&self) -> Self {
        let (rotation, scale) = (self.rotation.inverse(), 1.0 / self.scale);
        Self { rotation, translation: -(rotation * self.translation * scale), scale }
    }

    fn step(&self, d: &SVector<f64, 7>) -> Self {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(d[3], d[4], d[5]));
        self.compose(&Self { rotation, translation: Vector3::new(d[0], d[1], d[2]), scale: d[6].exp() })
    }

    fn error(measured: &Self, from: &Self, to: &Self) -> SVector<f64, 7> {
        parts(&measured.inverse().compose(&from.inverse()).compose(to))
    }

    fn linearise(measured: &Self, from: &Self, to: &Self) -> Linearised<7> {
        let between = from.inverse().compose(to);
        let error = measured.inverse().compose(&between);
        let turn = right_jacobian_inverse(&error.rotation.scaled_axis());
        let matrix = |q: &UnitQuaternion<f64>| q.to_rotation_matrix().into_inner();
        let mut by_to = SMatrix::<f64, 7, 7>::zeros();
        by_to.fixed_view_mut::<3, 3>(0, 0).copy_from(&(matrix(&error.rotation) * error.scale));
        by_to.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        by_to[(6, 6)] = 1.0;
        // A step of `from` acts inverted on `between`, seen from `measured`.
        let seen = matrix(&measured.rotation).transpose() / measured.scale;
        let mut by_from = SMatrix::<f64, 7, 7>::zeros();
        by_from.fixed_view_mut::<3, 3>(0, 0).copy_from(&-seen);
        by_from.fixed_view_mut::<3, 3>(0, 3).copy_from(&(seen * between.translation.cross_matrix()));
        by_from.fixed_view_mut::<3, 1>(0, 6).copy_from(&-(seen * between.translation));
        by_from.fixed_view_mut::<3, 3>(3, 3).copy_from(&-(turn * matrix(&between.rotation).transpose()));
        by_from[(6, 6)] = -1.0;
        Linearised { error: parts(&error), from: by_from, to: by_to }
    }

    fn rotation(&self) -> Matrix3<f64> {
        self.rotation.to_rotation_matrix().into_inner()
    }

    fn position(&self) -> Vector3<f64> {
        self.translation
    }

    fn from_parts(rotation: &Matrix3<f64>, position: &Vector3<f64>) -> Self {
        Self { rotation: turn_of(rotation), translation: *position, scale: 1.0 }
    }

    fn turn_information(information: &SMatrix<f64, 7, 7>) -> f64 {
        (3..6).map(|i| information[(i, i)]).sum::<f64>() / 3.0
    }

    fn shift_information(information: &SMatrix<f64, 7, 7>) -> f64 {
        (0..3).map(|i| information[(i, i)]).sum::<f64>() / 3.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some(k: f64) -> Similarity {
        Similarity {
            rotation: UnitQuaternion::from_scaled_axis(Vector3::new(0.3 * k, -0.2, 0.5 - 0.1 * k)),
            translation: Vector3::new(k, 1.0 - k, 0.4),
            scale: 1.0 + 0.3 * k,
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let (measured, from, to) = (some(0.2), some(0.7), some(-0.4));
        let exact = Similarity::linearise(&measured, &from, &to);
        let h = 1e-6;
        for k in 0..7 {
            let mut d = SVector::<f64, 7>::zeros();
            d[k] = h;
            let by_to = (Similarity::error(&measured, &from, &to.step(&d))
                - Similarity::error(&measured, &from, &to.step(&-d)))
                / (2.0 * h);
            assert!((by_to - exact.to.column(k)).norm() < 1e-6, "to {k}");
            let by_from = (Similarity::error(&measured, &from.step(&d), &to)
                - Similarity::error(&measured, &from.step(&-d), &to))
                / (2.0 * h);
            assert!((by_from - exact.from.column(k)).norm() < 1e-6, "from {k}");
        }
    }

    #[test]
    fn a_similarity_is_found_from_points_and_undone_by_its_inverse() {
        let truth = some(0.6);
        let a: Vec<Point3<f64>> = (0..9)
            .map(|i| Point3::new((f64::from(i) * 1.3).sin(), f64::from(i) * 0.2, (f64::from(i) * 0.7).cos()))
            .collect();
        let b: Vec<Point3<f64>> = a.iter().map(|p| truth.apply(p)).collect();
        let found = Similarity::between(&a, &b).unwrap();
        assert!(parts(&found.inverse().compose(&truth)).norm() < 1e-9);
        assert!(Similarity::between(&a[..1].repeat(3), &b[..1].repeat(3)).is_none());
    }
}
