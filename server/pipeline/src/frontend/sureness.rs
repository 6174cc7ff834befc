//! How sure the pose in the map is: odometry's covariance since its start, until the robot is found in the map. From then on it is
//! that of the place where it was found, and what odometry has added since.

use percept_geometry::{Covariance6, Pose, se3};

/// Where a robot was found in the map, at a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FoundAt {
    /// Base to odom.
    pub(crate) t_odom_base: Pose,
    /// Of base in odom, since the start of odometry.
    pub(crate) of_odometry: Covariance6,
    /// Of base in the map.
    pub(crate) in_map: Covariance6,
}

impl FoundAt {
    /// Covariance in the map of base at a later frame, of which odometry knows its own since the start.
    pub(crate) fn since(&self, t_odom_base: &Pose, of_odometry: &Covariance6) -> Covariance6 {
        let t_found_now = self.t_odom_base.inv_mul(t_odom_base);
        let carried = se3::compose_covariance(&self.of_odometry, &t_found_now, &Covariance6::zeros());
        // Where odometry has become surer than it was, by itself or as another one, nothing was added.
        let added = (of_odometry - carried).symmetric_eigen();
        let axes = added.eigenvectors;
        let added = axes * Covariance6::from_diagonal(&added.eigenvalues.map(|v| v.max(0.0))) * axes.transpose();
        let told = se3::compose_covariance(&self.in_map, &t_found_now, &added);
        (told + told.transpose()) * 0.5
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_unsure_before_the_robot_was_found_is_forgotten_and_what_comes_after_counts() {
        let start = se3::from_xy_yaw(3.0, 1.0, 0.4);
        // 30 s without a frame; found within a centimetre.
        let found = FoundAt {
            t_odom_base: start,
            of_odometry: Covariance6::identity() * 900.0,
            in_map: Covariance6::identity() * 1e-4,
        };
        assert!((found.since(&start, &found.of_odometry) - found.in_map).norm() < 1e-9);
        let step = se3::from_xy_yaw(0.5, 0.0, 0.1);
        let drift = Covariance6::identity() * 4e-4;
        let later = se3::compose_covariance(&found.of_odometry, &step, &drift);
        let told = found.since(&(start * step), &later);
        let expected = se3::compose_covariance(&found.in_map, &step, &drift);
        assert!((told - expected).norm() < 1e-9, "{told} {expected}");
        // Another odometry, which counts from nothing.
        let told = found.since(&start, &Covariance6::zeros());
        assert!((told - found.in_map).norm() < 1e-9 && told.symmetric_eigenvalues().min() > 0.0);
    }
}
