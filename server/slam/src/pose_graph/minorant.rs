//! What an edge counts at least, as a form of which the best poses are known.

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

/// A quadratic form in the rotation's columns and the position (4 x 4, in this order) of an edge's two poses that is at
/// no poses greater than the edge's chi2 less a constant, and equal at some.
#[derive(Debug, Clone, Copy)]
pub struct Minorant {
    /// Of the pose that the edge starts from.
    pub from: Matrix4<f64>,
    /// Of the pose that the edge ends at.
    pub to: Matrix4<f64>,
    /// Half of the mixed terms: rows of the first, columns of the second.
    pub between: Matrix4<f64>,
}

impl Minorant {
    /// Of a measured turn and shift, by what the trace of `turns` with the error's rotation counts, the information of a shift's
    /// length, and the gradient by the shift (in the frame that was measured) of what its information has beyond that.
    ///
    /// A squared length in the map is such a form. The rest of the information makes squares of terms that are such forms
    /// themselves: these lie above their tangents.
    pub(super) fn of(
        (turn, shift): (Matrix3<f64>, Vector3<f64>),
        turns: &Matrix3<f64>,
        shifts: f64,
        rest: &Vector3<f64>,
    ) -> Self {
        let arm = shift.push(1.0);
        let origin = Vector4::w();
        let tangent = (turn * rest).push(0.0);
        let mut between = (tangent - arm * shifts) * origin.transpose();
        let mut both = between.fixed_view_mut::<3, 3>(0, 0);
        both -= turn * turns;
        let from = arm * arm.transpose() * shifts - tangent * origin.transpose() - origin * tangent.transpose();
        Self { from, to: origin * origin.transpose() * shifts, between }
    }
}
