//! One second sensor: its odometry, and where its odom lies in that of the pose sensor.

use super::REACH_S;
use super::agreement::Agreement;
use super::track::{At, Placed, Track};
use nalgebra::Vector6;
use percept_geometry::{Covariance6, Pose, Timestamp, se3};
use percept_slam::motion_noise::{self, unknown_wheels};
use percept_slam::{
    MotionPrior, Odometry, OdometryEstimate, OdometryKind, OdometryNoise, OdometryParams, Scan, TrackingState, way_m,
};

/// Frames that are farther apart do not follow on each other, seconds.
const GAP_S: f64 = 1.0;
/// Where they differ by more, one odometry has jumped: metres, radians, and standard deviations.
const JUMP: (f64, f64, f64) = (0.02, 0.01, 5.0);
/// Variance of an axis that is open, m^2 and rad^2: the scale on which priors leave an axis to others.
pub(super) const OPEN: f64 = 1e6;

/// What a second sensor says of where base is.
#[derive(Debug, Clone)]
pub(super) struct Word {
    /// Base to odom of the pose sensor.
    pub(super) t_odom_base: Pose,
    /// Right perturbation in base; [`OPEN`] along axes that it has not measured.
    pub(super) covariance: Covariance6,
    pub(super) open: [bool; 6],
}

/// A second sensor that is registered.
pub(super) struct SecondSensor {
    kind: OdometryKind,
    /// How its odometry differs from itself; from the pose sensor's once that is known.
    noise: OdometryNoise,
    odometry: Odometry,
    newest: Option<OdometryEstimate>,
    track: Track,
    /// First frame since the last interruption.
    since: Timestamp,
    /// Its odom to that of the pose sensor, and variances of that, m^2 and rad^2; none before both have placed base at one time
    /// since the last interruption.
    t_odom_theirs: Option<(Pose, (f64, f64))>,
    /// When both last placed base, and base there, to its odom.
    compared: Option<(Timestamp, Pose)>,
    /// Axes that it left open at some time since it was last laid over the pose sensor's along them.
    open: [bool; 6],
    agreement: Agreement,
}

impl SecondSensor {
    pub(super) fn new(kind: OdometryKind, params: OdometryParams) -> Self {
        Self {
            kind,
            noise: OdometryNoise::of(kind),
            odometry: Odometry::new(kind, params),
            newest: None,
            track: Track::default(),
            since: Timestamp::default(),
            t_odom_theirs: None,
            compared: None,
            open: [false; 6],
            agreement: Agreement::default(),
        }
    }

    pub(super) fn odometry(&self) -> &Odometry {
        &self.odometry
    }

    pub(super) fn odometry_mut(&mut self) -> &mut Odometry {
        &mut self.odometry
    }

    /// Its newest frame, as it was placed in its own odom.
    pub(super) fn newest(&self) -> Option<&OdometryEstimate> {
        self.newest.as_ref()
    }

    /// Places a frame of it.
    pub(super) fn register(&mut self, stamp: Timestamp, scan: &Scan, prior: Option<&MotionPrior>) {
        let estimate = self.odometry.register(stamp, scan, prior);
        let is_far = self.track.newest().is_some_and(|p| stamp.seconds_since(p.stamp) > GAP_S);
        if !estimate.state.is_tracking() || is_far || self.track.newest().is_none() {
            self.interrupted();
        }
        if !estimate.state.is_lost() {
            if self.track.newest().is_none() {
                self.since = stamp;
            }
            let open =
                if estimate.state == TrackingState::Initialising { [false; 6] } else { estimate.degenerate_axes };
            self.track.push(Placed { stamp, t_odom_base: estimate.t_odom_base, open });
            self.open = super::track::either(&self.open, &open);
        }
        self.newest = Some(estimate);
    }

    fn interrupted(&mut self) {
        self.track.clear();
        self.open = [false; 6];
        self.pose_jumped();
    }

    /// The pose sensor's pose does not follow on the one before.
    pub(super) fn pose_jumped(&mut self) {
        (self.t_odom_theirs, self.compared) = (None, None);
        self.agreement.interrupted();
    }

    /// Lays its poses over those of the pose sensor, whose odometry has this noise, at the newest time at which both are known.
    pub(super) fn compare(&mut self, ours: &Track, noise: &OdometryNoise) {
        self.noise = OdometryNoise::of(self.kind).against(noise);
        let (Some(a), Some(b)) = (ours.newest(), self.track.newest()) else { return };
        let (stamp, newest) = (a.stamp.min(b.stamp), a.stamp.max(b.stamp));
        if self.compared.is_some_and(|(compared, _)| compared >= stamp) {
            return;
        }
        let (Some(a), Some(b)) = (ours.at(stamp), self.track.at(stamp)) else { return };
        let way_m = self.compared.map_or(0.0, |(_, t_theirs_before)| {
            let moved = t_theirs_before.inv_mul(&b.t_odom_base);
            way_m(moved.translation.vector.norm(), moved.rotation.angle())
        });
        self.lay_over(&a, &b, way_m, stamp);
        self.compared = Some((if self.t_odom_theirs.is_some() { stamp } else { newest }, b.t_odom_base));
    }

    fn lay_over(&mut self, ours: &At, theirs: &At, way_m: f64, stamp: Timestamp) {
        let noise = self.apart2(motion_noise::interpolated(ours.gap_s.max(theirs.gap_s)));
        let Some((t_odom_theirs, before)) = self.t_odom_theirs else {
            self.t_odom_theirs = Some((ours.t_odom_base * theirs.t_odom_base.inverse(), noise));
            self.agreement.interrupted();
            return;
        };
        let mut off = se3::log(&(t_odom_theirs * theirs.t_odom_base).inv_mul(&ours.t_odom_base));
        for k in 0..6 {
            // Where it leads the pose sensor follows it.
            if ours.open[k] && !theirs.open[k] && !self.agreement.is_doubted() {
                off[k] = 0.0;
            } else {
                self.open[k] = false;
            }
        }
        self.open = super::track::either(&self.open, &self.track.open_from(stamp));
        let added = self.noise.added(way_m);
        let now = (before.0 + added.0, before.1 + added.1);
        if is_jump(&off, (now.0 + noise.0, now.1 + noise.1)) {
            // Poses between frames are none across a jump: what comes after these is compared.
            self.agreement.jumped();
            self.track.keep_newest();
            self.t_odom_theirs = None;
            return;
        }
        let gain = (now.0 / (now.0 + noise.0), now.1 / (now.1 + noise.1));
        (0..3).for_each(|k| off[k] *= gain.0);
        (3..6).for_each(|k| off[k] *= gain.1);
        let t_odom_theirs = t_odom_theirs * theirs.t_odom_base * se3::exp(&off) * theirs.t_odom_base.inverse();
        let t_odom_theirs = super::track::normalized(&t_odom_theirs);
        self.t_odom_theirs = Some((t_odom_theirs, ((1.0 - gain.0) * now.0, (1.0 - gain.1) * now.1)));
        self.agreement.compare(ours, theirs);
    }

    /// Variances of what two poses of both differ by, m^2 and rad^2: what either registration errs by, and these standard deviations.
    fn apart2(&self, sigma: (f64, f64)) -> (f64, f64) {
        let at_once = self.noise.at_once();
        (at_once.0.powi(2) + sigma.0.powi(2), at_once.1.powi(2) + sigma.1.powi(2))
    }

    /// Whether its motion is that of the pose sensor.
    pub(super) fn is_believed(&self) -> bool {
        self.agreement.is_believed()
    }

    /// Base to odom of the pose sensor at its newest frame, unless that is not where the pose sensor says that base is, as far as it
    /// knows: it may have jumped.
    pub(super) fn place(&self, stamp: Timestamp, ours: Option<&At>) -> Option<Pose> {
        let (t_odom_theirs, laid) = self.t_odom_theirs?;
        let t_odom_base = t_odom_theirs * self.track.newest().filter(|p| p.stamp == stamp)?.t_odom_base;
        let fits = |at: &At| {
            let ahead = if at.ahead_s > 0.0 {
                motion_noise::extrapolated(at.ahead_s, at.gap_s)
            } else {
                motion_noise::interpolated(at.gap_s)
            };
            let ahead = self.apart2(ahead);
            !is_jump(&se3::log(&at.t_odom_base.inv_mul(&t_odom_base)), (laid.0 + ahead.0, laid.1 + ahead.1))
        };
        ours.is_none_or(fits).then_some(t_odom_base)
    }

    /// Whether its motion is known not to be that of the pose sensor.
    pub(super) fn is_doubted(&self) -> bool {
        self.agreement.is_doubted()
    }

    /// How far off its motions were, for choosing among several.
    pub(super) fn difference2(&self) -> f64 {
        self.agreement.difference2()
    }

    /// Whether it has placed base without an interruption from a time on.
    pub(super) fn covers(&self, from: Timestamp) -> bool {
        self.t_odom_theirs.is_some() && self.since <= from
    }

    /// Where base is at a time, `moved` from where it was when both last were known (metres and radians together).
    pub(super) fn word(&self, stamp: Timestamp, moved: impl Fn(&Pose) -> f64) -> Option<Word> {
        let (t_odom_theirs, laid) = self.t_odom_theirs?;
        let at = self.track.at_or_ahead(stamp, REACH_S)?;
        let t_odom_base = t_odom_theirs * at.t_odom_base;
        let drift = self.agreement.drift2(moved(&t_odom_base));
        // Both registrations err anew in every frame, as where the one is laid over the other knows.
        let ahead = self.apart2(motion_noise::extrapolated(at.ahead_s, at.gap_s));
        let (t, r) = (laid.0 + drift.0 + ahead.0, laid.1 + drift.1 + ahead.1);
        let mut covariance = Covariance6::from_diagonal(&[t, t, t, r, r, r].into());
        if self.kind == OdometryKind::Lidar2d {
            // That the robot moves in a plane is supposed.
            assumed_planar(&mut covariance, moved(&t_odom_base));
        }
        (0..6).filter(|&k| self.open[k]).for_each(|k| covariance[(k, k)] = OPEN);
        Some(Word { t_odom_base, covariance, open: self.open })
    }
}

/// Whether a difference is too large for these variances, m^2 and rad^2.
fn is_jump(off: &Vector6<f64>, variances: (f64, f64)) -> bool {
    off.fixed_rows::<3>(0).norm() > JUMP.0 + JUMP.2 * variances.0.sqrt()
        || off.fixed_rows::<3>(3).norm() > JUMP.1 + JUMP.2 * variances.1.sqrt()
}

/// Height and tilt as wheels know them.
fn assumed_planar(covariance: &mut Covariance6, length: f64) {
    let wheels = unknown_wheels(length, length);
    (2..5).for_each(|k| covariance[(k, k)] = wheels[(k, k)]);
}
