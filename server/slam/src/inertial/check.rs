//! Whether a gyro's turns lead nearer to where frames are placed than a constant turn rate does.

use nalgebra::UnitQuaternion;

/// Weight of the newest frame in running means, and frames after which they say something. A mean over the last ten: a
/// second at 10 Hz. The latter halved and doubled, the error of `inertial spinning seconds=15` of percept-pipeline is
/// the same, 5.0 mm.
const NEWEST: f64 = 0.1;
const ENOUGH: usize = 5;
/// Turns by less than this tell nothing, radians: all predict those. Halved and doubled, the error of `inertial
/// spinning seconds=15` of percept-pipeline is the same, 5.0 mm.
pub(super) const TURNS: f64 = 0.02;
/// A gyro is believed if it is off by no more than this share of what a constant rate is, and this angle, radians, to
/// which registrations are good: one whose clock is late by a frame does about as well as a constant rate. Halved and
/// doubled, the error of `inertial spinning seconds=15` of percept-pipeline is the same, 5.0 mm.
const BETTER: (f64, f64) = (0.8, 0.003);

/// How far both were off, radians.
#[derive(Debug, Clone, Default)]
pub(crate) struct GyroCheck {
    gyro: f64,
    assumed: f64,
    num: usize,
}

impl GyroCheck {
    /// Turns since the frame before: as the gyro felt it, at a constant rate, and as the frame was placed.
    pub(crate) fn compare(
        &mut self,
        felt: &UnitQuaternion<f64>,
        assumed: &UnitQuaternion<f64>,
        now: &UnitQuaternion<f64>,
    ) {
        if felt.angle().max(now.angle()) < TURNS {
            return;
        }
        self.num += 1;
        let weight = NEWEST.max(1.0 / self.num as f64);
        self.gyro += weight * (felt.angle_to(now) - self.gyro);
        self.assumed += weight * (assumed.angle_to(now) - self.assumed);
    }

    /// Whether it has not yet shown what it is worth.
    pub(crate) fn is_on_trial(&self) -> bool {
        self.num < ENOUGH
    }

    /// Whether its turns are worth being a prior: once they have shown that they are. One that was wrong may come back: it is
    /// compared on. Believed at once, one that is mounted otherwise spoils the first frames of the map for good.
    pub(crate) fn is_believed(&self) -> bool {
        !self.is_on_trial() && self.gyro <= BETTER.0 * self.assumed + BETTER.1
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
        assert!(!GyroCheck::default().is_believed() && GyroCheck::default().is_on_trial());
    }
}
