//! Whether a gyro's turns lead nearer to where frames are placed than a constant turn rate does.

use nalgebra::UnitQuaternion;

/// Weight of the newest frame in running means, and frames after which they say something.
const NEWEST: f64 = 0.1;
const ENOUGH: usize = 5;
/// A gyro is wrong if it is off by so many times what a constant rate is, and this angle, radians: what registrations err.
const WORSE: (f64, f64) = (1.5, 0.005);

/// How far both were off, radians.
#[derive(Debug, Clone, Default)]
pub(crate) struct GyroCheck {
    gyro: f64,
    assumed: f64,
    num: usize,
}

impl GyroCheck {
    /// A frame was placed with rotation `now`, to which the gyro had led to `felt` and a constant rate to `assumed`.
    pub(crate) fn compare(
        &mut self,
        felt: &UnitQuaternion<f64>,
        assumed: &UnitQuaternion<f64>,
        now: &UnitQuaternion<f64>,
    ) {
        self.num += 1;
        let weight = NEWEST.max(1.0 / self.num as f64);
        self.gyro += weight * (felt.angle_to(now) - self.gyro);
        self.assumed += weight * (assumed.angle_to(now) - self.assumed);
    }

    /// Whether its turns are worth being a prior. One that was wrong may come back: it is compared on.
    pub(crate) fn is_believed(&self) -> bool {
        self.num < ENOUGH || self.gyro <= WORSE.0 * self.assumed + WORSE.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_gyro_that_is_mounted_otherwise_is_found_out_and_a_noisy_one_is_not() {
        let turn = |axis: Vector3<f64>, angle: f64| UnitQuaternion::from_scaled_axis(axis * angle);
        let (mut wrong, mut noisy) = (GyroCheck::default(), GyroCheck::default());
        for i in 0..50 {
            // A head that is swung to and fro: a constant rate is off by the change of the rate.
            let (angle, change) = (0.2 * (0.3 * f64::from(i)).sin(), 0.06 * (0.3 * f64::from(i)).cos());
            let now = turn(Vector3::z(), angle);
            let assumed = turn(Vector3::z(), angle - change);
            wrong.compare(&turn(Vector3::x(), angle), &assumed, &now);
            noisy.compare(&turn(Vector3::new(0.02, 0.02, 1.02), angle), &assumed, &now);
        }
        assert!(!wrong.is_believed() && noisy.is_believed());
    }
}
