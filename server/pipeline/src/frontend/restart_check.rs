//! Whether a local model that was begun after a loss stands still where the wheels say.
//!
//! People who walk along with a robot hide its surroundings, and are surroundings that stand still as it drives: after some seconds
//! odometry begins anew with them. Wheels that have told the robot's motion before then tell it better. Where both differ, odometry
//! begins anew once more where the wheels have led.

use super::wheels_check::moved_far;
use percept_geometry::Pose;
use percept_slam::{OdometryEstimate, TrackingState};

/// What both may differ by over a stretch: metres and radians, and shares of the way and of the turn. Wheels lie within a tenth of what
/// was driven (`unknown_wheels` in `slam`); a model that moves with the robot differs by all of it.
const TOLERATED: (f64, f64) = (0.1, 0.1);
const TOLERATED_SHARE: f64 = 0.4;
/// Stretches after which it is believed, and the way that one has to have, metres.
const LEAST_WAY_M: f64 = 0.3;
const AGREE: usize = 3;

/// Local models that were begun after losses, as wheels see them.
#[derive(Debug, Default)]
pub(super) struct Restarts {
    /// Of the newest, until it is believed.
    check: Option<RestartCheck>,
    /// Whether the last that was compared moved with the robot.
    move_along: bool,
    /// Whether one stood since the robot is unanchored.
    has_stood: bool,
}

impl Restarts {
    /// Compares the newest frame, given what wheels tell of the motion since the one before; where they have led to, base to odom, and by
    /// what, if the local model moves with the robot.
    pub(super) fn compare(&mut self, told: Option<&Pose>, estimate: &OdometryEstimate) -> Option<(Pose, Pose)> {
        let placed = Some(&estimate.t_odom_base).filter(|_| estimate.state.is_tracking());
        match self.check.as_mut()?.add(told?, placed) {
            Word::Open => None,
            Word::Stands => {
                (self.check, self.move_along, self.has_stood) = (None, false, true);
                None
            }
            Word::Moves { t_odom_base, told } => {
                self.move_along = true;
                Some((t_odom_base, told))
            }
        }
    }

    /// Takes up the comparison where odometry has begun anew. `wheels`: whether those that measured the motion have proven themselves;
    /// others, and none, say nothing.
    pub(super) fn follow(&mut self, wheels: Option<bool>, estimate: &OdometryEstimate) {
        self.check = match (self.check.take(), wheels, estimate.state) {
            (_, Some(true), TrackingState::Initialising) => Some(RestartCheck::new(estimate.t_odom_base)),
            (_, _, TrackingState::Initialising) | (_, None, _) => None,
            (check, Some(_), _) => check,
        };
    }

    /// Whether a local model is being compared.
    pub(super) fn is_comparing(&self) -> bool {
        self.check.is_some()
    }

    /// Whether odometry has begun anew, and may have begun with what moves with the robot.
    pub(super) fn may_move_along(&self) -> bool {
        self.check.as_ref().is_some_and(|check| check.agreed == 0)
    }

    /// Whether that is likely: it did before.
    pub(super) fn are_along(&self) -> bool {
        self.move_along && self.may_move_along()
    }

    /// Whether what speaks against the place that wheels have led to may have come along with the robot: no local model stood.
    pub(super) fn speak_against_nothing(&self) -> bool {
        !self.has_stood
    }

    /// The robot is anchored, or lost: a place that it saw says nothing any more.
    pub(super) fn forget(&mut self) {
        self.has_stood = false;
    }
}

/// A local model that was begun after a loss.
#[derive(Debug, Clone)]
struct RestartCheck {
    /// Base to odom where the stretch began, and by how much wheels say that it has moved since.
    t_odom_begun: Pose,
    told: Pose,
    agreed: usize,
}

/// What has come of it.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Word {
    Open,
    Stands,
    /// It moves with the robot: where wheels have led, base to odom, and by what since the stretch began.
    Moves {
        t_odom_base: Pose,
        told: Pose,
    },
}

impl RestartCheck {
    /// Begins where the local model was.
    fn new(t_odom_base: Pose) -> Self {
        Self { t_odom_begun: t_odom_base, told: Pose::identity(), agreed: 0 }
    }

    /// Wheels tell this motion since the frame before, and this one was placed there, if it was.
    fn add(&mut self, told: &Pose, t_odom_base: Option<&Pose>) -> Word {
        self.told *= told;
        let Some(t_odom_base) = t_odom_base else { return Word::Open };
        let measured = self.t_odom_begun.inv_mul(t_odom_base);
        if !moved_far(&measured) && !moved_far(&self.told) {
            return Word::Open;
        }
        let off = self.told.inv_mul(&measured);
        let size = |t: &Pose| (t.translation.vector.norm(), t.rotation.angle());
        let ((off_m, off_rad), (way, turn)) = (size(&off), size(&self.told));
        let (way, turn) = (way.max(size(&measured).0), turn.max(size(&measured).1));
        if off_m > TOLERATED.0 + TOLERATED_SHARE * way || off_rad > TOLERATED.1 + TOLERATED_SHARE * turn {
            return Word::Moves { t_odom_base: self.t_odom_begun * self.told, told: self.told };
        }
        (self.t_odom_begun, self.told) = (*t_odom_base, Pose::identity());
        // Who walks along need not turn with the robot.
        self.agreed += usize::from(way >= LEAST_WAY_M);
        if self.agreed >= AGREE { Word::Stands } else { Word::Open }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::se3;

    /// Drives 5 cm a frame with wheels that are 5 % off; `measured` is how much of that odometry sees.
    fn word_of(measured: f64) -> (usize, Word) {
        let mut check = RestartCheck::new(Pose::identity());
        for i in 1..200 {
            let seen = se3::from_xy_yaw(0.05 * measured * i as f64, 0.0, 0.0);
            match check.add(&se3::from_xy_yaw(0.0525, 0.0, 0.0), Some(&seen)) {
                Word::Open => {}
                word => return (i, word),
            }
        }
        panic!()
    }

    #[test]
    fn surroundings_that_come_along_are_told_within_half_a_metre_and_others_believed() {
        let (frames, word) = word_of(0.0);
        let Word::Moves { t_odom_base, .. } = word else { panic!("{word:?}") };
        assert!(frames <= 10 && (t_odom_base.translation.x - 0.0525 * frames as f64).abs() < 1e-9, "{frames}");
        assert!(matches!(word_of(0.3).1, Word::Moves { .. }));
        assert_eq!(word_of(1.0), (30, Word::Stands));
    }
}
