//! What is wrong with an IMU, for an operator: each of its measurements against what it should be.
//!
//! Forces against gravity, which is what they average to on any robot; turns against those of placed frames. If both turn alike
//! about other axes, the mount is wrong, and by how much is Wahba's problem (Markley, "Attitude determination using vector
//! observations and the singular value decomposition", 1988).

use super::check::TURNS;
use super::gravity::GRAVITY;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Forces that differ from gravity by more than this share of it tell no direction: the body is shaken, or they are in another
/// unit than m/s^2.
pub(super) const SHAKEN: f64 = 0.3;

/// Forces are averaged over so many seconds, and say something after so many. Where the force swings by 5 m/s^2 at 1.4
/// Hz, the mean is off by 0.1 m/s^2, and by 0.6 at most when it first says something; [`SHAKEN`] allows 2.9.
const FORCE_S: (f64, f64) = (5.0, 2.0);
/// What is left of a frame's weight with each that comes after, and frames after which turns say something. A mean over
/// the last fifty: five seconds at 10 Hz.
const FADES: f64 = 0.98;
const ENOUGH: usize = 30;
/// Turns that are off by more than this share of what was turned (root mean square) are wrong: a gyro is good to 2 %, placed
/// frames to some 5 %, and a clock that is off by a frame to 30 %.
const WRONG: f64 = 0.5;
/// Turning frames, and the share by which they may be off, after which turns are proven. A second of turning at 10 Hz;
/// the share is below what a clock that is off by a frame makes ([`WRONG`]).
const PROVEN: (usize, f64) = (10, 0.25);
/// Turns that agree so well once they are turned and scaled are the same ones (a correlation), and what is then worth
/// telling: a share of their size, and an angle, radians. Turns that are still off by [`WRONG`] have a correlation of
/// 1 / sqrt(1 + 0.5^2), which is 0.89. By scale alone, what is off by that is so by 0.5 or more, by turning alone by
/// 0.5 rad or more: what is worth telling is well below either.
const ALIKE: f64 = 0.9;
const TELLING: (f64, f64) = (0.2, 0.1);
/// Turns that agree so well once they are turned by so much, radians, are those of an IMU that hangs otherwise than declared, even
/// if they are not off by [`WRONG`]: a clock that is off by a frame leaves a correlation of 0.95. Mounts are declared to a few
/// degrees.
const SKEWED: (f64, f64) = (0.98, 0.2);
/// The second axis has to have so much of the turning of the first one, or only that one is known. These are squares:
/// the turns are 0.22 of those about the first, and errors of frames, 5 %, make 0.0025.
const SECOND_AXIS: f64 = 0.05;
/// Share of frames that samples have to cover. Most are not, below it.
const COVERED: f64 = 0.5;
/// Frames in a row in which an IMU did worse than none before that is worth telling. Ten seconds at 10 Hz.
const REFUTED: u32 = 100;

/// What is wrong with an IMU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ImuFault {
    /// Its samples do not cover the time between most frames.
    Uncovered {
        /// By how much the newest sample is older than the frame that needs it, in the mean, seconds.
        behind_s: f64,
    },
    /// What it feels is not as large as gravity.
    ForceUnlikeGravity {
        /// Its mean, m/s^2 if it were in that unit.
        mean: f64,
    },
    /// It turns as the robot does, by another amount: its unit is not rad/s.
    TurnsScaled {
        /// Turns felt, as a share of those of the robot.
        factor: f64,
    },
    /// It turns as the robot does, about other axes: its mount is not the declared one.
    TurnsAboutOtherAxes {
        /// By how much the declared mount has to be turned, radians; at least so much if the robot turns about one axis only.
        angle_rad: f64,
        /// About which axis of base, unit length.
        axis: Vector3<f64>,
    },
    /// It turns otherwise than the robot does.
    TurnsUnlike {
        /// How well both agree, -1 to 1.
        agreement: f64,
    },
    /// Frames are predicted better without it.
    Misleading,
}

impl ImuFault {
    /// Whether turns that it felt are of no use.
    fn spoils_turns(&self) -> bool {
        !matches!(self, Self::ForceUnlikeGravity { .. } | Self::Misleading)
    }
}

/// Measurements of an IMU against what they should be.
#[derive(Debug, Clone, Default)]
pub(super) struct ImuCheck {
    /// Mean size of forces, m/s^2, and how long they were felt, seconds.
    force: f64,
    felt_s: f64,
    /// Mean of whether samples covered a frame, and of how old the newest was, seconds.
    covered: f64,
    behind_s: f64,
    num_frames: usize,
    turns: Turns,
    /// Frames in a row in which it was not believed.
    pub(super) num_unbelieved: u32,
}

/// Sums over turns of frames, the newest counting most.
#[derive(Debug, Clone, Default)]
struct Turns {
    num: usize,
    /// Placed times felt, and the squares of both.
    product: Matrix3<f64>,
    placed: f64,
    felt: f64,
    /// Square of the difference, about the axes that frames tell.
    off: f64,
}

impl ImuCheck {
    /// A sample so long after the one before, seconds; 0 for the first.
    pub(super) fn felt(&mut self, force: f64, dt: f64) {
        let dt = dt.clamp(1e-4, 0.1);
        self.felt_s += dt;
        self.force += (force - self.force) * (dt / self.felt_s.min(FORCE_S.0));
    }

    /// A frame whose time since the one before samples did not cover: the newest is so old, seconds.
    pub(super) fn uncovered(&mut self, behind_s: f64) {
        let weight = self.count_frame(0.0);
        self.behind_s += weight * (behind_s - self.behind_s);
    }

    /// A frame that turned since the one before: by rates felt, summed up, radians, of which another unit makes many rounds,
    /// and as placed; `is_planar` if that is about base's z alone.
    pub(super) fn turned(&mut self, felt: &Vector3<f64>, placed: &UnitQuaternion<f64>, is_planar: bool) {
        self.count_frame(1.0);
        let placed = placed.scaled_axis();
        if felt.norm().max(placed.norm()) < TURNS {
            return;
        }
        let off = if is_planar { Vector3::z() * (placed - felt).z } else { placed - felt };
        let t = &mut self.turns;
        t.num += 1;
        t.product = t.product * FADES + placed * felt.transpose();
        t.placed = t.placed * FADES + placed.norm_squared();
        t.felt = t.felt * FADES + felt.norm_squared();
        t.off = t.off * FADES + off.norm_squared();
    }

    fn count_frame(&mut self, covered: f64) -> f64 {
        self.num_frames += 1;
        let weight = (1.0 - FADES).max(1.0 / self.num_frames as f64);
        self.covered += weight * (covered - self.covered);
        weight
    }

    /// What is wrong, as far as that is known.
    pub(super) fn faults(&self) -> Vec<ImuFault> {
        let uncovered = (self.num_frames >= ENOUGH && self.covered < COVERED)
            .then_some(ImuFault::Uncovered { behind_s: self.behind_s });
        let is_like_gravity = (self.force / GRAVITY - 1.0).abs() <= SHAKEN;
        let force =
            (self.felt_s >= FORCE_S.1 && !is_like_gravity).then_some(ImuFault::ForceUnlikeGravity { mean: self.force });
        let faults: Vec<ImuFault> = [uncovered, self.turns.fault(), force].into_iter().flatten().collect();
        if faults.is_empty() && self.num_unbelieved >= REFUTED { vec![ImuFault::Misleading] } else { faults }
    }

    /// Whether turns that it felt have shown to be those of the robot.
    pub(super) fn has_proven_turns(&self) -> bool {
        let t = &self.turns;
        t.num >= PROVEN.0 && t.off <= PROVEN.1 * PROVEN.1 * t.placed
    }

    /// Whether turns that it felt are as good as known to be wrong or missing.
    pub(super) fn spoils_turns(&self) -> bool {
        self.faults().iter().any(ImuFault::spoils_turns)
    }
}

impl Turns {
    fn fault(&self) -> Option<ImuFault> {
        if self.num < ENOUGH {
            return None;
        }
        let is_off = self.off > WRONG * WRONG * self.placed.max(0.1 * self.felt);
        let factor = (self.felt / self.placed.max(1e-12)).sqrt();
        if is_off && factor < TELLING.0 {
            return Some(ImuFault::TurnsScaled { factor });
        }
        let svd = self.product.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        let hand = (u * v_t).determinant().signum();
        let s = svd.singular_values;
        let agreement = (s[0] + s[1] + hand * s[2]) / (self.placed * self.felt).sqrt().max(1e-12);
        if !is_off && (agreement < SKEWED.0 || (factor - 1.0).abs() > TELLING.0) {
            return None;
        }
        if agreement < ALIKE {
            return Some(ImuFault::TurnsUnlike { agreement: self.product.trace() / (self.placed * self.felt).sqrt() });
        }
        if (factor - 1.0).abs() > TELLING.0 {
            return Some(ImuFault::TurnsScaled { factor });
        }
        let turn = if s[1] > SECOND_AXIS * s[0] {
            let r = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, hand)) * v_t;
            UnitQuaternion::from_matrix(&r).scaled_axis()
        } else {
            about_one_axis(&v_t.row(0).transpose(), &u.column(0).into_owned())
        };
        let angle_rad = turn.norm();
        (angle_rad > if is_off { TELLING.1 } else { SKEWED.1 })
            .then(|| ImuFault::TurnsAboutOtherAxes { angle_rad, axis: turn / angle_rad })
    }
}

/// The least turn that takes one direction to another.
fn about_one_axis(from: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
    match UnitQuaternion::rotation_between(from, to) {
        Some(turn) => turn.scaled_axis(),
        // Opposite: about any axis across.
        None => from.cross(&Vector3::x_axis()).try_normalize(0.1).unwrap_or_else(Vector3::y) * std::f64::consts::PI,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    /// What is found where the robot turns by `placed(i)` in frame i and its IMU feels `felt` of that.
    fn fault(placed: impl Fn(f64) -> Vector3<f64>, felt: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Option<ImuFault> {
        let mut check = ImuCheck::default();
        for i in 0..60 {
            let turn = placed(f64::from(i));
            check.turned(&felt(turn), &UnitQuaternion::from_scaled_axis(turn), turn.xy().norm() == 0.0);
        }
        let faults = check.faults();
        assert!(faults.len() <= 1);
        faults.first().copied()
    }

    /// Too little for a frame to be predicted badly, and enough for a map that is levelled by it.
    #[test]
    fn a_mount_that_is_off_by_twenty_degrees_is_told() {
        let skewed = UnitQuaternion::from_scaled_axis(Vector3::y() * 0.35);
        for placed in [hand as fn(f64) -> Vector3<f64>, cart] {
            let found = fault(placed, |turn| skewed * turn);
            let Some(ImuFault::TurnsAboutOtherAxes { angle_rad, .. }) = found else { panic!("{found:?}") };
            assert!((angle_rad - 0.35).abs() < 0.01, "{angle_rad}");
            let slightly = UnitQuaternion::from_scaled_axis(Vector3::x() * 0.1);
            assert_eq!(fault(placed, |turn| slightly * turn), None);
        }
    }

    fn hand(i: f64) -> Vector3<f64> {
        Vector3::new(0.05 * (0.7 * i).sin(), 0.08 * (0.5 * i).cos(), 0.15 * (0.3 * i).sin())
    }

    fn cart(i: f64) -> Vector3<f64> {
        Vector3::z() * (0.15 * (0.3 * i).sin())
    }

    #[test]
    fn a_sound_gyro_has_no_fault() {
        assert_eq!(fault(hand, |w| w * 1.03 + Vector3::new(0.004, -0.003, 0.002)), None);
        // A cart that rocks as it drives, which a planar scan does not see.
        assert_eq!(fault(cart, |w| w + Vector3::new(0.05, -0.03, 0.0)), None);
    }

    #[test]
    fn a_wrong_mount_is_told_by_angle_and_axis() {
        let mount = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 1.2, -0.4));
        let Some(ImuFault::TurnsAboutOtherAxes { angle_rad, axis }) = fault(hand, |w| mount.inverse() * w) else {
            panic!("no fault");
        };
        assert!((axis * angle_rad - mount.scaled_axis()).norm() < 1e-6, "{angle_rad} {axis}");
        // Of a cart, which axes are left is open.
        let mount = UnitQuaternion::from_scaled_axis(Vector3::y() * FRAC_PI_2);
        let Some(ImuFault::TurnsAboutOtherAxes { angle_rad, axis }) = fault(cart, |w| mount.inverse() * w) else {
            panic!("no fault");
        };
        assert!((angle_rad - FRAC_PI_2).abs() < 1e-6 && (axis - Vector3::y()).norm() < 1e-6, "{angle_rad} {axis}");
        let upside_down = fault(cart, |w| -w);
        assert!(matches!(upside_down, Some(ImuFault::TurnsAboutOtherAxes { angle_rad, .. }) if angle_rad > 3.1));
    }

    #[test]
    fn another_unit_is_told_by_its_factor() {
        let degrees = |w: Vector3<f64>| w * 57.3;
        assert!(matches!(fault(hand, degrees), Some(ImuFault::TurnsScaled { factor }) if (factor - 57.3).abs() < 1e-6));
        assert_eq!(fault(hand, |w| w * 0.0), Some(ImuFault::TurnsScaled { factor: 0.0 }));
    }

    #[test]
    fn turns_of_another_time_are_unlike() {
        let mut i = 0.0;
        let mut check = ImuCheck::default();
        while i < 60.0 {
            let of = |i: f64| hand(i) + Vector3::y() * (0.1 * (1.7 * i).sin());
            check.turned(&of(i - 7.0), &UnitQuaternion::from_scaled_axis(of(i)), false);
            i += 1.0;
        }
        assert!(matches!(check.faults()[..], [ImuFault::TurnsUnlike { .. }]), "{:?}", check.faults());
    }

    #[test]
    fn forces_tell_their_unit_and_one_who_is_shaken_does_not_mind() {
        let faults = |force: fn(f64) -> f64| {
            let mut check = ImuCheck::default();
            check.felt(force(0.0), 0.0);
            (1..800).for_each(|i| check.felt(force(0.005 * f64::from(i)), 0.005));
            check.faults()
        };
        assert_eq!(faults(|_| 9.81), []);
        assert_eq!(faults(|t| 10.5 + 5.0 * (9.0 * t).sin()), []);
        assert!(matches!(faults(|_| 1.0)[..], [ImuFault::ForceUnlikeGravity { mean }] if (mean - 1.0).abs() < 1e-9));
        assert!(matches!(faults(|_| 981.0)[..], [ImuFault::ForceUnlikeGravity { .. }]));
    }

    #[test]
    fn samples_that_come_too_late_cover_nothing() {
        let mut check = ImuCheck::default();
        (0..40).for_each(|_| check.uncovered(0.35));
        assert!(matches!(check.faults()[..], [ImuFault::Uncovered { behind_s }] if (behind_s - 0.35).abs() < 1e-9));
        (0..60).for_each(|_| check.turned(&Vector3::zeros(), &UnitQuaternion::identity(), false));
        assert_eq!(check.faults(), []);
    }
}
