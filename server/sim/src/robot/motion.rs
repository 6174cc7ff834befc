//! Velocities and accelerations of a frame that moves in another one.

use nalgebra::{UnitQuaternion, Vector3};

/// How a child frame moves in its parent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Motion {
    /// In the child's axes, rad/s.
    pub(crate) turn_rate: Vector3<f64>,
    /// Its change, in the child's axes, rad/s^2.
    pub(crate) turn_acceleration: Vector3<f64>,
    /// Of the child's origin, in the parent's axes, m/s.
    pub(crate) velocity: Vector3<f64>,
    /// Of the child's origin, in the parent's axes, m/s^2.
    pub(crate) acceleration: Vector3<f64>,
}

impl Motion {
    /// The motion of c in a, if this is that of b in a, `inner` that of c in b, and c lies at `p_b_c` turned by `r_b_c`.
    /// Velocity and acceleration are in the axes of b, which are those of the outer motion's child.
    pub(crate) fn carrying(
        &self,
        r_a_b: &UnitQuaternion<f64>,
        r_b_c: &UnitQuaternion<f64>,
        p_b_c: &Vector3<f64>,
        inner: &Self,
    ) -> Self {
        let (w, dw) = (self.turn_rate, self.turn_acceleration);
        let (w_in_c, dw_in_c) = (r_b_c.inverse() * w, r_b_c.inverse() * dw);
        Self {
            turn_rate: inner.turn_rate + w_in_c,
            // The outer turning, seen from c, turns the other way as c turns.
            turn_acceleration: inner.turn_acceleration + dw_in_c - inner.turn_rate.cross(&w_in_c),
            velocity: self.velocity + r_a_b * (inner.velocity + w.cross(p_b_c)),
            acceleration: self.acceleration
                + r_a_b
                    * (inner.acceleration
                        + w.cross(&inner.velocity) * 2.0
                        + dw.cross(p_b_c)
                        + w.cross(&w.cross(p_b_c))),
        }
    }

    /// A frame that is fixed to its parent.
    pub(crate) fn fixed() -> Self {
        let zero = Vector3::zeros();
        Self { turn_rate: zero, turn_acceleration: zero, velocity: zero, acceleration: zero }
    }
}
