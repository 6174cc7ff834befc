//! Whether wheels tell the motion that the pose sensor measures.
//!
//! Both are compared over stretches, since single steps are as small as what they are wrong by: least squares of the one by the
//! other through zero, over the newest stretches.

use nalgebra::Vector3;
use percept_geometry::Pose;
use std::collections::VecDeque;

/// A stretch ends when the robot has moved or turned so far, metres and radians: errors of a frame's pose, some millimetres and
/// milliradians, are a hundredth of that.
const STRETCH: (f64, f64) = (0.5, 0.5);
/// Stretches that are kept: what was wrong and is right again is forgotten after some tens of metres.
const KEPT: usize = 40;
/// Way and turn before which nothing is told: 3 m, and most of a circle.
const LEAST: (f64, f64) = (3.0, 4.0);
/// Shares that wheels may be off by. Good ones lie within a few hundredths; skid steering and worn tyres within a tenth.
const TOLERATED: f64 = 0.15;
/// Below this agreement they tell another motion, not the same one by another scale: the cosine between both.
const ALIKE: f64 = 0.8;

/// How wheels contradict the pose sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WheelsFault {
    /// They tell the same way by another scale.
    Way {
        /// What they tell, as a share of what was measured; negative if they drive the other way.
        factor: f64,
    },
    /// They tell the same turns by another scale.
    Turns {
        /// As that of the way.
        factor: f64,
    },
    /// They tell another motion.
    Unlike {
        /// How well both agree, -1 to 1.
        agreement: f64,
    },
}

/// What was told and what was measured over one stretch.
#[derive(Debug, Clone, Copy, Default)]
struct Stretch {
    told: Pose,
    measured: Pose,
}

/// Compares the wheels of one sensor with the pose.
#[derive(Debug, Clone, Default)]
pub(super) struct WheelsCheck {
    open: Stretch,
    kept: VecDeque<Stretch>,
}

/// Products of what was told and measured, summed up.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    length: f64,
    told: f64,
    both: f64,
    measured: f64,
}

impl Sums {
    fn add(&mut self, told: &Vector3<f64>, measured: &Vector3<f64>) {
        self.length += measured.norm();
        self.told += told.norm_squared();
        self.both += told.dot(measured);
        self.measured += measured.norm_squared();
    }

    fn factor(&self) -> f64 {
        self.both / self.measured.max(f64::MIN_POSITIVE)
    }

    /// Cosine between both.
    fn agreement(&self) -> f64 {
        self.both / (self.told * self.measured).sqrt().max(f64::MIN_POSITIVE)
    }
}

/// Whether that is a stretch.
pub(super) fn moved_far(t: &Pose) -> bool {
    t.translation.vector.norm() >= STRETCH.0 || t.rotation.angle() >= STRETCH.1
}

impl WheelsCheck {
    /// Adds the motion between two frames that were both placed, in metres.
    pub(super) fn add(&mut self, told: &Pose, measured: &Pose) {
        self.open.told *= told;
        self.open.measured *= measured;
        if moved_far(&self.open.measured) || moved_far(&self.open.told) {
            self.kept.push_back(std::mem::take(&mut self.open));
            if self.kept.len() > KEPT {
                self.kept.pop_front();
            }
        }
    }

    /// The robot was not placed for a while, or not in metres: the stretch is no stretch.
    pub(super) fn interrupt(&mut self) {
        self.open = Stretch::default();
    }

    /// Whether enough was driven to tell, and nothing is wrong.
    pub(super) fn is_proven(&self) -> bool {
        let way: f64 = self.kept.iter().map(|s| s.measured.translation.vector.norm()).sum();
        way > LEAST.0 && self.faults().is_empty()
    }

    /// What is wrong, once enough was driven to tell.
    pub(super) fn faults(&self) -> Vec<WheelsFault> {
        let (mut way, mut turns) = (Sums::default(), Sums::default());
        for s in &self.kept {
            way.add(&s.told.translation.vector, &s.measured.translation.vector);
            turns.add(&s.told.rotation.scaled_axis(), &s.measured.rotation.scaled_axis());
        }
        let mut faults = vec![];
        let mut look = |sums: &Sums, fault: fn(f64) -> WheelsFault| {
            let (factor, agreement) = (sums.factor(), sums.agreement());
            if agreement.abs() < ALIKE {
                faults.push(WheelsFault::Unlike { agreement });
            } else if (factor - 1.0).abs() > TOLERATED {
                faults.push(fault(factor));
            }
        };
        if way.length > LEAST.0 {
            look(&way, |factor| WheelsFault::Way { factor });
        }
        if turns.length > LEAST.1 {
            look(&turns, |factor| WheelsFault::Turns { factor });
        }
        faults
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::se3;

    /// Drives curves of 5 cm and 3 degrees a frame; `told` makes what wheels tell of a step.
    fn driven(frames: usize, told: impl Fn(usize, &Pose) -> Pose) -> Vec<WheelsFault> {
        let mut check = WheelsCheck::default();
        for i in 0..frames {
            let step = se3::from_xy_yaw(0.05, 0.0, 0.05 * if i / 40 % 2 == 0 { 1.0 } else { -1.0 });
            check.add(&told(i, &step), &step);
        }
        check.faults()
    }

    fn scaled(step: &Pose, way: f64, turn: f64) -> Pose {
        let v = se3::log(step);
        se3::exp(&nalgebra::Vector6::from_fn(|k, _| v[k] * if k < 3 { way } else { turn }))
    }

    #[test]
    fn honest_wheels_are_not_blamed_and_others_by_how_much() {
        assert_eq!(driven(200, |_, step| scaled(step, 1.05, 0.95)), vec![]);
        let [WheelsFault::Way { factor }] = driven(200, |_, step| scaled(step, 1.4, 1.0))[..] else { panic!() };
        assert!((factor - 1.4).abs() < 0.03, "{factor}");
        let [WheelsFault::Turns { factor }] = driven(200, |_, step| scaled(step, 1.0, 0.5))[..] else { panic!() };
        assert!((factor - 0.5).abs() < 0.03, "{factor}");
        // Mounted backwards.
        let [WheelsFault::Way { factor }] = driven(200, |_, step| scaled(step, -1.0, 1.0))[..] else { panic!() };
        assert!((factor + 1.0).abs() < 0.1, "{factor}");
        // Sideways for ahead.
        let across = se3::from_xy_yaw(0.0, 0.0, 1.4);
        let told = driven(200, |_, step| across * step * across.inverse());
        assert!(matches!(told[..], [WheelsFault::Unlike { .. }]), "{told:?}");
    }

    #[test]
    fn nothing_is_told_early_and_what_is_right_again_is_forgotten() {
        assert_eq!(driven(40, |_, step| scaled(step, 2.0, 2.0)), vec![]);
        let told = driven(800, |i, step| scaled(step, if i < 200 { 2.0 } else { 1.0 }, 1.0));
        assert_eq!(told, vec![]);
    }
}
