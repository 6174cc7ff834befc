//! One robot: its sensors, and what they say of its motion.

pub(crate) mod clock_offset;
pub(crate) mod extrinsics;
pub(crate) mod imu_prior;
pub(crate) mod odometry_prior;
pub(crate) mod scale_hints;
pub(crate) mod sensors;
