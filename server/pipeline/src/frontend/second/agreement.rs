//! Whether a second sensor's motion is that of the pose sensor: what its word is worth.

use super::track::{At, either};
use percept_geometry::{Pose, se3};

/// Motions are compared over so much: metres, or radians.
const OVER: (f64, f64) = (0.5, 0.5);
/// What they may differ by: metres, metres a metre and metres a radian; radians, and radians a radian. Two good registrations
/// differ by millimetres at either end; a mount that is off by 0.1 rad or 0.1 m by more. `second_sensor lidars`, `planar-rgbd`
/// and `depths` are the same with either halved and doubled. What it costs shows in the keyframes of `second_sensor lidars
/// yaw_off=0.1` (2.5 mm; metres doubled 18.1), `lidar-depth x_off=0.1` (5.6; 16.2) and `lidar-depth` (2.8; radians halved
/// 4.0); the mount is told in all of them.
const MAY_DIFFER: ([f64; 3], [f64; 2]) = ([0.015, 0.04, 0.03], [0.01, 0.03]);
/// Comparisons before it is believed, and the weight of the newest in running means.
const ENOUGH: u32 = 3;
const NEWEST: f64 = 0.2;

/// A jump counts as a motion that differs by so many times what it may: a local model that is seen again after a turn puts its
/// odometry right by centimetres, and one that does so twice within a metre is no guide.
const JUMPED: f64 = 2.2;

/// A motion that is being compared: base at its begin, as both see it.
#[derive(Debug, Clone, Copy)]
struct Begun {
    t_odom_base: Pose,
    t_theirs_base: Pose,
    /// Axes of base that either has left open since.
    open: [bool; 6],
}

/// How far motions of one kind differ.
#[derive(Debug, Clone, Copy, Default)]
struct Difference {
    num: u32,
    /// Mean square as a share of what it may be.
    share2: f64,
}

impl Difference {
    fn note(&mut self, share: f64) {
        self.num = self.num.saturating_add(1);
        self.share2 += NEWEST.max(1.0 / f64::from(self.num)) * (share * share - self.share2);
    }

    fn is_too_large(&self) -> bool {
        self.num > 0 && self.share2 >= 1.0
    }
}

/// How far the motions differ.
#[derive(Debug, Clone, Default)]
pub(super) struct Agreement {
    begun: Option<Begun>,
    /// Of motions that led somewhere, and of those that turned: a mount that is turned shows in the one, one that is moved in the other,
    /// and what one has shown the other does not refute.
    ways: Difference,
    turns: Difference,
    /// Mean squares of the differences by the length compared (metres and radians together): metres and radians.
    rate2: (f64, f64),
}

impl Agreement {
    /// Both have placed base at one time, without an interruption since the last. What either leaves open is not compared.
    pub(super) fn compare(&mut self, ours: &At, theirs: &At) {
        let open = either(&ours.open, &theirs.open);
        let now = Begun { t_odom_base: ours.t_odom_base, t_theirs_base: theirs.t_odom_base, open };
        let Some(begun) = &mut self.begun else {
            self.begun = Some(now);
            return;
        };
        begun.open = either(&begun.open, &open);
        let moved = begun.t_theirs_base.inv_mul(&now.t_theirs_base);
        let (way, turn) = (moved.translation.vector.norm(), moved.rotation.angle());
        if way < OVER.0 && turn < OVER.1 {
            return;
        }
        let mut off = se3::log(&moved.inv_mul(&begun.t_odom_base.inv_mul(&now.t_odom_base)));
        (0..6).filter(|&k| begun.open[k]).for_each(|k| off[k] = 0.0);
        self.begun = Some(now);
        self.note((way, turn), off.fixed_rows::<3>(0).norm(), off.fixed_rows::<3>(3).norm());
    }

    /// Over a way and a turn they differed by so many metres and radians.
    fn note(&mut self, (way, turn): (f64, f64), off_t: f64, off_r: f64) {
        let ([t, t_way, t_turn], [r, r_turn]) = MAY_DIFFER;
        let share = (off_t / (t + t_way * way + t_turn * turn)).max(off_r / (r + r_turn * turn));
        let led_somewhere = way / OVER.0 >= turn / OVER.1;
        if led_somewhere { &mut self.ways } else { &mut self.turns }.note(share);
        let weight = NEWEST.max(1.0 / f64::from(self.num()));
        for (rate2, off) in [(&mut self.rate2.0, off_t), (&mut self.rate2.1, off_r)] {
            *rate2 += weight * ((off / (way + turn)).powi(2) - *rate2);
        }
    }

    fn num(&self) -> u32 {
        self.ways.num.saturating_add(self.turns.num)
    }

    /// One of both has jumped.
    pub(super) fn jumped(&mut self) {
        self.interrupted();
        self.ways.num = self.ways.num.max(1);
        self.ways.share2 += NEWEST * (JUMPED * JUMPED - self.ways.share2);
    }

    /// What comes does not follow on what was.
    pub(super) fn interrupted(&mut self) {
        self.begun = None;
    }

    /// Whether its motion was that of the pose sensor lately.
    pub(super) fn is_believed(&self) -> bool {
        self.num() >= ENOUGH && self.ways.num > 0 && !self.is_doubted()
    }

    /// Whether its motion was another one lately.
    pub(super) fn is_doubted(&self) -> bool {
        self.ways.is_too_large() || self.turns.is_too_large()
    }

    /// How far off motions were: mean square as a share of what is allowed.
    pub(super) fn difference2(&self) -> f64 {
        self.ways.share2.max(self.turns.share2)
    }

    /// Variances of what its motion over a length (metres and radians together) is off by: m^2 and rad^2.
    pub(super) fn drift2(&self, length: f64) -> (f64, f64) {
        (self.rate2.0 * length * length, self.rate2.1 * length * length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(t_odom_base: Pose) -> At {
        At { t_odom_base, open: [false; 6], gap_s: 0.0, ahead_s: 0.0 }
    }

    /// Drives along an arc; the second sensor's mount is declared wrongly by `t_declared_true`.
    fn driven(t_declared_true: Pose) -> Agreement {
        let mut agreement = Agreement::default();
        for i in 0..100 {
            let ours = se3::exp(&nalgebra::Vector6::new(0.1, 0.0, 0.0, 0.0, 0.0, 0.05).scale(f64::from(i)));
            let theirs = t_declared_true * ours * t_declared_true.inverse();
            agreement.compare(&at(ours), &at(theirs));
        }
        agreement
    }

    #[test]
    fn a_mount_that_is_off_is_found_out() {
        assert!(!Agreement::default().is_believed());
        assert!(driven(Pose::identity()).is_believed());
        assert!(driven(se3::from_xy_yaw(0.01, 0.01, 0.01)).is_believed());
        assert!(!driven(se3::from_xy_yaw(0.0, 0.0, 0.15)).is_believed());
        assert!(!driven(se3::from_xy_yaw(0.3, 0.0, 0.0)).is_believed());
    }

    #[test]
    fn jumps_are_held_against_it_until_it_has_agreed_for_some_time() {
        let mut agreement = driven(Pose::identity());
        agreement.jumped();
        assert!(agreement.is_believed());
        agreement.jumped();
        assert!(!agreement.is_believed());
        (0..5).for_each(|_| agreement.note((0.5, 0.1), 0.005, 0.002));
        assert!(agreement.is_believed());
    }

    #[test]
    fn what_shows_in_turns_is_not_refuted_by_driving_straight() {
        let mut agreement = driven(Pose::identity());
        (0..3).for_each(|_| agreement.note((0.0, 0.5), 0.15, 0.0));
        (0..50).for_each(|_| agreement.note((0.5, 0.0), 0.001, 0.0));
        assert!(agreement.is_doubted());
        (0..20).for_each(|_| agreement.note((0.0, 0.5), 0.001, 0.0));
        assert!(agreement.is_believed());
    }
}
