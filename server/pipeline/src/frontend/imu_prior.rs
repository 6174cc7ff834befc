//! What wheels and gyro say together of the motion between two frames.

use percept_geometry::{Covariance6, Pose};
use percept_slam::MotionPrior;

/// What wheels and gyro say together: the turn from the gyro, the way from the wheels.
pub(crate) fn joined(wheels: Option<MotionPrior>, turn: Option<MotionPrior>) -> Option<MotionPrior> {
    let (Some(wheels), Some(turn)) = (&wheels, &turn) else { return wheels.or(turn) };
    let t_prev_now = Pose::from_parts(wheels.t_prev_now.translation, turn.t_prev_now.rotation);
    let mut covariance = Covariance6::zeros();
    covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&wheels.covariance.fixed_view::<3, 3>(0, 0));
    covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn.covariance.fixed_view::<3, 3>(3, 3));
    Some(MotionPrior { t_prev_now, covariance })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use percept_geometry::Timestamp;
    use percept_geometry::sensor::ImuSample;
    use percept_slam::ImuBuffer;

    #[test]
    fn the_way_is_the_wheels_and_the_turn_the_gyros() {
        let at = Timestamp::from_secs_f64;
        let sample = ImuSample { angular_velocity: Vector3::z(), linear_acceleration: Vector3::z() * 9.81 };
        let mut imu = ImuBuffer::default();
        (0..20).for_each(|i| imu.push(at(0.01 * f64::from(i)), &sample, &Pose::identity()));
        let turn = imu.between(at(0.0), at(0.1));
        let wheels = MotionPrior {
            t_prev_now: percept_geometry::se3::from_xy_yaw(0.2, 0.0, 0.5),
            covariance: Covariance6::identity() * 0.04,
        };
        let both = joined(Some(wheels.clone()), turn.clone()).unwrap();
        assert!((both.t_prev_now.translation.x - 0.2).abs() < 1e-12 && both.covariance[(0, 0)] == 0.04);
        assert!((both.t_prev_now.rotation.angle() - 0.1).abs() < 1e-9 && both.covariance[(5, 5)] < 0.01);
        assert_eq!(joined(Some(wheels.clone()), None), Some(wheels));
        assert_eq!(joined(None, turn.clone()), turn);
    }
}
