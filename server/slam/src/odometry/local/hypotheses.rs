//! A frame finds its place in the local model: where it is expected, the tries, and which of them is believed.

use super::LocalOdometry;
use crate::covariance::diagonal;
use crate::motion_prior::{MotionPrior, UNKNOWN_VARIANCE};
use crate::odometry::{After, Prediction, Registration};
use crate::scan::Scan;
use crate::tracking::LostReason;
use nalgebra::Vector6;
use percept_geometry::{Covariance6, Pose, se3};

/// A frame whose inlier ratio falls below this share of the usual one is tried from the last pose too. Times 0.7 93 and
/// 23.9, with 0.99 as it is on the log with wheels ([`crate::loops::planar`]).
const DOUBTFUL: f64 = 0.9;

/// A planar scan that fits worse than this share of how scans usually do is looked for farther away. Times 0.7 as it
/// is, times 1.4 105 and 17.3 on the log with wheels ([`crate::loops::planar`]).
const POOR: f64 = 0.7;

/// Scans that come so rarely, seconds, are looked for wherever a robot can have driven since, up to so many metres. From 0.5 s on
/// three standard deviations of constant velocity are more than the narrow search covers, 0.6 m.
const SPARSE_S: f64 = 0.5;
const SPARSE_M: f64 = 4.0;
/// After so many of them that found no place the robot is elsewhere. The Intel log without wheels, share in the map: one scan in
/// four, 0.998 with 3, 0.973 with 8, 0.967 with 30; one in ten, 0.50, 0.30, 0.57.
const SPARSE_FRAMES: usize = 3;
/// Two searches have come to one place if they are no farther apart, metres and radians. Halved and doubled as it is
/// ([`crate::loops::planar`]).
const SAME: (f64, f64) = (0.3, 0.1);

/// Wheels that differ so much from the velocity before, in one frame, are doubted: metres and radians. Halved and
/// doubled as it is on the log with wheels ([`crate::loops::planar`]).
const SUDDEN: (f64, f64) = (0.15, 0.15);

/// Turns of a gyro and of the motion before that differ by less lead to the same place, radians. Trying both takes two
/// registrations, and such turns move a point at 10 m by 0.1 m, which one covers.
const ALIKE: f64 = 0.01;

impl LocalOdometry {
    /// The motion prior if there is one; what it leaves open, as a gyro does the translation, from constant velocity. Of a prior that
    /// tells a part of the way each axis is taken from where it is known.
    pub(super) fn predict(&self, dt: f64, prior: Option<&MotionPrior>) -> Prediction {
        let constant = self.constant_velocity(dt);
        let Some(prior) = prior else { return constant };
        let covariance = prior.covariance + self.limits.prior_floor();
        let t_odom_base = self.t_odom_base * prior.t_prev_now;
        if prior.tells_the_way() {
            return Prediction { t_odom_base, covariance, is_measured: true, measured: [true; 6], ..constant };
        }
        if !prior.is_turn_only() {
            return fused(constant, &t_odom_base, &covariance);
        }
        let way = self.t_odom_base.inv_mul(&constant.t_odom_base).translation;
        let mut both = constant.covariance;
        both.fixed_view_mut::<3, 3>(3, 3).copy_from(&covariance.fixed_view::<3, 3>(3, 3));
        let t_odom_base = self.t_odom_base * Pose::from_parts(way, prior.t_prev_now.rotation);
        Prediction { t_odom_base, covariance: both, is_turn_felt: true, ..constant }
    }

    /// Constant velocity while frames are near in time.
    fn constant_velocity(&self, dt: f64) -> Prediction {
        let t = &self.params.tracking;
        let velocity = self.velocity.filter(|_| dt <= t.max_gap_s);
        let moving = velocity.unwrap_or_else(Vector6::zeros) * dt;
        // Without a velocity, or lost, the robot may have done anything that robots usually do.
        let unsure = if self.num_lost > 0 || velocity.is_none() { dt } else { 0.0 };
        let sigma_t =
            0.01 + 0.5 * self.limits.acceleration * dt.min(t.max_gap_s).powi(2) + 0.25 * self.limits.speed * unsure;
        let sigma_r = 0.01 + 0.5 * self.limits.turn_acceleration * dt.min(t.max_gap_s).powi(2) + 0.5 * unsure;
        let usual = self.rhythm.error();
        let (sigma_t, sigma_r) = (sigma_t.max(1.5 * usual), sigma_r.max(1.5 * usual));
        let t_now_next = se3::exp(&moving);
        let covariance = se3::compose_covariance(&self.left_open, &t_now_next, &diagonal(sigma_t, sigma_r.min(1.0)));
        Prediction {
            t_odom_base: self.t_odom_base * t_now_next,
            covariance,
            is_measured: false,
            measured: [false; 6],
            is_turn_felt: false,
            elapsed_s: self.unplaced_s + dt,
            t_odom_before: self.is_tracking().then_some(self.t_odom_base),
            inertial: None,
        }
    }

    /// Places a frame; a planar scan that fits nowhere near is looked for wherever a robot can be by now, and is believed to be
    /// where it fits as scans usually do. So is one that comes long after the one before, if nothing measured the way: near
    /// where it was expected it may fit as well, along a wall.
    pub(super) fn place_or_search(&self, dt: f64, prediction: &Prediction) -> Result<Registration, LostReason> {
        let found = self.place_or_doubt(dt, prediction);
        if !self.limits.is_planar {
            return found;
        }
        let is_poor = !found.as_ref().is_ok_and(|m| m.inlier_ratio >= POOR * self.usual_inlier_ratio);
        let reach_s = self.unplaced_s + dt;
        // Faster than the motion before leads to, as robots that begin to turn on the spot are.
        let (way, turn) = (self.limits.speed * reach_s, self.limits.turn_rate * reach_s);
        if dt >= SPARSE_S && (is_poor || !prediction.is_measured) {
            // What fits where it was expected may fit as well a door farther.
            let Some(mut places) = self.model.search(&self.t_odom_base, way.min(SPARSE_M), turn) else {
                return if prediction.is_measured { found } else { Err(LostReason::Degenerate) };
            };
            places.retain(|m| m.inlier_ratio >= POOR * self.usual_inlier_ratio);
            return self.only_place(&places, found);
        }
        if !is_poor || reach_s > self.params.tracking.max_gap_s {
            return found;
        }
        let wide = Prediction::within(self.t_odom_base, diagonal(way / 3.0, turn / 3.0));
        let can_be = |m: &Registration| {
            let off = self.t_odom_base.inv_mul(&m.t_odom_base);
            m.inlier_ratio >= DOUBTFUL * self.usual_inlier_ratio
                && off.translation.vector.norm() <= way + 0.1
                && off.rotation.angle() <= turn + 0.1
        };
        self.model.register(&wide).ok().filter(can_be).map_or(found, Ok)
    }

    /// The only place that a search has come to; if there is none, what was found where the frame was expected, and of several as
    /// well, if that is the best of them.
    fn only_place(
        &self,
        places: &[Registration],
        found: Result<Registration, LostReason>,
    ) -> Result<Registration, LostReason> {
        let is_same = |a: &Registration, b: &Registration| {
            let off = a.t_odom_base.inv_mul(&b.t_odom_base);
            off.translation.vector.norm() < SAME.0 && off.rotation.angle() < SAME.1
        };
        match (places, found) {
            ([only], _) => Ok(only.clone()),
            (places, Ok(found)) if places.first().is_none_or(|best| is_same(best, &found)) => Ok(found),
            (_, Ok(_)) => Err(LostReason::TimeGap),
            (_, Err(reason)) => Err(reason),
        }
    }

    /// Wheels that slip or lag shall not lose what the scan alone can place: where they fail, or say what the motion
    /// before does not lead to, that is tried as well, and wins if it fits better.
    fn place_or_doubt(&self, dt: f64, prediction: &Prediction) -> Result<Registration, LostReason> {
        let measured = self.place(dt, prediction);
        if !prediction.is_measured || !self.limits.is_planar {
            return measured;
        }
        let assumed = self.predict(dt, None);
        let apart = prediction.t_odom_base.inverse() * assumed.t_odom_base;
        let likely = apart.translation.vector.norm() < SUDDEN.0 && apart.rotation.angle() < SUDDEN.1;
        if likely && measured.is_ok() {
            return measured;
        }
        match (measured, self.place(dt, &assumed)) {
            (Ok(a), Ok(b)) => Ok(if b.inlier_ratio > 1.02 * a.inlier_ratio { b } else { a }),
            (measured, assumed) => measured.or_else(|reason| assumed.map_err(|_| reason)),
        }
    }

    /// A gyro of which nothing is known yet may be the only one that leads to the frame, or be mounted otherwise: its turn is tried
    /// beside the motion before, and wins if it fits better.
    pub(super) fn place_or_try_gyro(
        &self,
        dt: f64,
        prediction: &Prediction,
        gyro: &MotionPrior,
        found: Result<Registration, LostReason>,
    ) -> Result<Registration, LostReason> {
        let led = self.predict(dt, Some(gyro));
        if led.t_odom_base.rotation.angle_to(&prediction.t_odom_base.rotation) < ALIKE {
            return found;
        }
        match (found, self.place(dt, &led)) {
            (Err(_), Ok(b)) => Ok(b),
            (Ok(a), Ok(b)) if b.inlier_ratio > 1.02 * a.inlier_ratio => Ok(b),
            (found, _) => found,
        }
    }

    /// Tries the prediction and, if that fails or fits worse than usual, where base was before, turned as a gyro felt it if one did;
    /// the better is taken.
    pub(super) fn place(&self, dt: f64, prediction: &Prediction) -> Result<Registration, LostReason> {
        let predicted = self.try_from(dt, prediction);
        let sound = |m: &Registration| m.inlier_ratio >= DOUBTFUL * self.usual_inlier_ratio;
        let t_still_predicted = self.t_odom_base.inverse() * prediction.t_odom_base;
        if predicted.as_ref().is_ok_and(sound) || se3::log(&t_still_predicted).norm() < 1e-3 {
            return predicted.map_err(|reason| self.with_gap(dt, reason));
        }
        // After a gap the place of before may look like the one where wheels have led to since.
        if prediction.is_measured && !self.limits.is_planar && self.is_after_gap(dt) {
            return predicted.map_err(|reason| self.with_gap(dt, reason));
        }
        let turned = if prediction.is_turn_felt { prediction.t_odom_base.rotation } else { self.t_odom_base.rotation };
        let t_odom_still = Pose::from_parts(self.t_odom_base.translation, turned);
        let still = self.try_from(dt, &Prediction { t_odom_base: t_odom_still, ..prediction.clone() });
        let still = still.and_then(|m| match self.may_deny(prediction, &m) {
            true => Ok(m),
            false => Err(LostReason::ResidualTooLarge),
        });
        match (predicted, still) {
            (Ok(a), Ok(b)) => Ok(if b.inlier_ratio > 1.02 * a.inlier_ratio { b } else { a }),
            (Err(_), Ok(b)) => Ok(b),
            (predicted, Err(_)) => predicted.map_err(|reason| self.with_gap(dt, reason)),
        }
    }

    /// Whether a place found elsewhere than wheels say is believed rather than they: a frame fits anywhere along a wall. It has
    /// to fit as well as frames usually do, contradict nothing, and show the motion that it denies.
    fn may_deny(&self, prediction: &Prediction, found: &Registration) -> bool {
        if !prediction.is_measured || self.limits.is_planar {
            return true;
        }
        let off = se3::log(&prediction.t_odom_base.inv_mul(&found.t_odom_base));
        let is_seen = |k: usize| !found.degenerate_axes[k] || off[k].abs() < 3.0 * prediction.covariance[(k, k)].sqrt();
        (0..6).all(is_seen)
            && found.inlier_ratio >= DOUBTFUL * self.usual_inlier_ratio
            && self.model.is_certain(found, After::Gap)
    }

    /// Undoes the sweep's motion again where it was other than assumed, and places the scan once more. A turn about z that was
    /// felt (rad/s) stays.
    pub(super) fn sharpen(
        &mut self,
        dt: f64,
        scan: &Scan,
        (assumed, felt_rate): (&Vector6<f64>, Option<f64>),
        found: Registration,
    ) -> Registration {
        if self.model.sweep_velocity().is_some() || !scan.is_sweep() || dt < 1e-3 || dt > self.params.tracking.max_gap_s
        {
            return found;
        }
        let mut velocity = se3::log(&(self.t_odom_base.inverse() * found.t_odom_base)) / dt;
        if let Some(rate) = felt_rate {
            velocity[5] = rate;
        }
        // Over a sweep of 0.1 s: 1 cm, or 5 mrad.
        let off = velocity - assumed;
        if off.fixed_rows::<3>(0).norm() < 0.1 && off.fixed_rows::<3>(3).norm() < 0.05 {
            return found;
        }
        if self.model.prepare(scan, &velocity).is_err() {
            return found;
        }
        self.sweep_velocity = velocity;
        let covariance = diagonal(0.05, 0.02);
        let near = Prediction::within(found.t_odom_base, covariance);
        let again = Prediction { is_measured: true, measured: [true; 6], ..near };
        self.try_from(dt, &again).unwrap_or(found)
    }

    fn try_from(&self, dt: f64, prediction: &Prediction) -> Result<Registration, LostReason> {
        let found = self.model.register(prediction)?;
        self.plausible(dt, found)
    }

    /// Whether frames were missing before the first one that could not be placed.
    pub(super) fn is_after_silence(&self, dt: f64) -> bool {
        dt > self.params.tracking.max_gap_s || (self.num_lost > 0 && self.after_silence)
    }

    /// Lost frames in a row after which the local model starts anew.
    pub(super) fn patience(&self, dt: f64) -> usize {
        let most = self.params.tracking.restart_after_frames;
        // All of them have to come late: a lidar that pauses once while it is lost is tried as others are.
        let since_placed_s = self.unplaced_s + dt;
        if self.limits.is_planar && dt >= SPARSE_S && since_placed_s >= SPARSE_S * (self.num_lost + 1) as f64 {
            return most.min(SPARSE_FRAMES);
        }
        if self.is_after_silence(dt) { most.min(self.limits.frames_after_silence) } else { most }
    }

    fn is_after_gap(&self, dt: f64) -> bool {
        self.unplaced_s + dt > self.params.tracking.max_gap_s
    }

    fn with_gap(&self, dt: f64, reason: LostReason) -> LostReason {
        if dt > self.params.tracking.max_gap_s { LostReason::TimeGap } else { reason }
    }

    fn plausible(&self, dt: f64, found: Registration) -> Result<Registration, LostReason> {
        let t_last_now = self.t_odom_base.inverse() * found.t_odom_base;
        // The constants allow for stamps that jitter.
        let too_far = t_last_now.translation.vector.norm() > self.limits.speed * dt.max(0.05) + 0.1;
        let too_much = t_last_now.rotation.angle() > self.limits.turn_rate * dt.max(0.05) + 0.1;
        if too_far || too_much {
            return Err(LostReason::MotionTooLarge);
        }
        // Meanwhile somebody may have carried the robot to a place that resembles the old one.
        if self.is_after_gap(dt) && !self.model.is_certain(&found, After::Gap) {
            Err(LostReason::TimeGap)
        } else {
            Ok(found)
        }
    }
}

/// Constant velocity and what was measured along some axes, each by its information.
fn fused(constant: Prediction, t_odom_measured: &Pose, covariance: &Covariance6) -> Prediction {
    let both = || -> Option<(Pose, Covariance6)> {
        let (a, b) = (constant.covariance.try_inverse()?, covariance.try_inverse()?);
        let fused = (a + b).try_inverse()?;
        let off = se3::log(&constant.t_odom_base.inv_mul(t_odom_measured));
        Some((constant.t_odom_base * se3::exp(&(fused * b * off)), (fused + fused.transpose()) * 0.5))
    };
    let Some((t_odom_base, fused)) = both() else { return constant };
    let measured = std::array::from_fn(|k| covariance[(k, k)] <= UNKNOWN_VARIANCE);
    Prediction { t_odom_base, covariance: fused, measured, ..constant }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::{Found, LocalModel, OdometryKind, OdometryParams};
    use crate::scan::CloudScan;
    use crate::tracking::TrackingState;
    use nalgebra::{UnitQuaternion, Vector3};
    use percept_geometry::{KeyframeScan, PointCloud, Timestamp};
    use std::sync::Arc;

    /// Fits badly where it is expected and well where the robot was before.
    struct Doorway {
        inlier_ratio_before: f64,
        is_open_ahead: bool,
        is_certain: bool,
        is_empty: bool,
    }

    impl LocalModel for Doorway {
        fn prepare(&mut self, _: &Scan, _: &Vector6<f64>) -> Result<(), LostReason> {
            Ok(())
        }
        fn is_empty(&self) -> bool {
            self.is_empty
        }
        fn register(&self, prediction: &Prediction) -> Result<Registration, LostReason> {
            let is_before = se3::log(&prediction.t_odom_base).norm() < 0.01;
            Ok(Registration {
                t_odom_base: prediction.t_odom_base,
                covariance: diagonal(0.001, 0.001),
                inlier_ratio: if is_before { self.inlier_ratio_before } else { 0.4 },
                rmse_m: 0.001,
                iterations: 1,
                degenerate_axes: [is_before && self.is_open_ahead, false, false, false, false, false],
                told: None,
                found: Found::PoseAlone,
            })
        }
        fn is_certain(&self, _: &Registration, _: After) -> bool {
            self.is_certain
        }
        fn integrate(&mut self, _: &Pose) {
            self.is_empty = false;
        }
        fn memory_bytes(&self) -> usize {
            0
        }
        fn clear(&mut self) {}
        fn seed(&mut self, _: &Pose, _: &[(Pose, Arc<KeyframeScan>)]) {}
    }

    /// Where the robot is said to be along x, in metres, when wheels say that it drove half a metre.
    fn driven(model: Doorway) -> f64 {
        let mut odometry = LocalOdometry::new(OdometryKind::Rgbd, Box::new(model), OdometryParams::default());
        let scan = Scan::Cloud(CloudScan { cloud: Arc::new(PointCloud::default()), t_base_sensor: Pose::identity() });
        let stay = MotionPrior { t_prev_now: Pose::identity(), covariance: diagonal(0.002, 0.002) };
        for k in 0..20 {
            odometry.register(Timestamp::from_secs_f64(0.1 * f64::from(k)), &scan, Some(&stay), None);
        }
        let drive = MotionPrior { t_prev_now: se3::from_xy_yaw(0.5, 0.0, 0.1), covariance: diagonal(0.005, 0.005) };
        let estimate = odometry.register(Timestamp::from_secs_f64(2.5), &scan, Some(&drive), None);
        assert!(estimate.state.is_tracking());
        estimate.t_odom_base.translation.x
    }

    #[test]
    fn what_a_prior_leaves_open_of_the_way_is_taken_from_the_velocity() {
        let mut odometry = LocalOdometry::new(
            OdometryKind::Rgbd,
            Box::new(crate::odometry::rgbd::Rgbd::new(Default::default())),
            OdometryParams::default(),
        );
        odometry.velocity = Some(Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0));
        odometry.last_stamp = Some(Timestamp::default());
        let mut covariance = diagonal(0.002, 0.002);
        covariance[(0, 0)] = 1e6;
        let prior = MotionPrior { t_prev_now: se3::from_xy_yaw(0.2, 0.05, 0.02), covariance };
        let predicted = odometry.predict(0.1, Some(&prior));
        let t = predicted.t_odom_base;
        assert!((t.translation.x - 0.1).abs() < 0.01 && (t.translation.y - 0.05).abs() < 0.01, "{t}");
        assert!((se3::yaw(&t) - 0.02).abs() < 0.005);
        assert!(!predicted.is_measured && predicted.measured == [false, true, true, true, true, true]);
        assert!(predicted.covariance[(0, 0)] > 1e-4 && predicted.covariance[(1, 1)] < 1e-5);
    }

    #[test]
    fn wheels_are_denied_by_what_shows_the_motion_and_by_nothing_less() {
        let slipped = || Doorway { inlier_ratio_before: 0.8, is_open_ahead: false, is_certain: true, is_empty: true };
        assert!(driven(slipped()).abs() < 1e-9);
        // It fits anywhere along the wall, or contradicts what was seen: the robot was left behind by the whole step.
        assert!((driven(Doorway { is_open_ahead: true, ..slipped() }) - 0.5).abs() < 1e-9);
        assert!((driven(Doorway { is_certain: false, ..slipped() }) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn a_turn_that_a_believed_gyro_felt_is_not_denied_by_what_fits_without_it() {
        let model = Doorway { inlier_ratio_before: 0.8, is_open_ahead: false, is_certain: true, is_empty: true };
        let mut odometry = LocalOdometry::new(OdometryKind::Rgbd, Box::new(model), OdometryParams::default());
        let turn = |angle: f64| UnitQuaternion::from_scaled_axis(Vector3::z() * angle);
        for k in 0..10 {
            let now = turn(0.1 * f64::from(k));
            odometry.gyro.compare(&now, &turn(0.0), &now);
        }
        let scan = Scan::Cloud(CloudScan { cloud: Arc::new(PointCloud::default()), t_base_sensor: Pose::identity() });
        let felt = |angle: f64| {
            let mut covariance = diagonal(0.01, 0.002);
            (0..3).for_each(|k| covariance[(k, k)] = 1e6);
            MotionPrior { t_prev_now: Pose::from_parts(Vector3::zeros().into(), turn(angle)), covariance }
        };
        let mut yaw_at = |s: f64, angle: f64| {
            let estimate = odometry.register(Timestamp::from_secs_f64(s), &scan, Some(&felt(angle)), None);
            assert!(estimate.state.is_tracking() || s == 0.0);
            se3::yaw(&estimate.t_odom_base)
        };
        for k in 0..20 {
            yaw_at(0.1 * f64::from(k), 0.0);
        }
        // A wall fits better as it was seen before; the robot looks at the next one, which is hardly known.
        assert!((yaw_at(2.0, 0.3) - 0.3).abs() < 1e-3);
    }

    #[test]
    fn a_scan_that_comes_late_and_fits_in_too_many_places_is_lost_and_not_where_it_was_expected() {
        let model = Doorway { inlier_ratio_before: 0.8, is_open_ahead: false, is_certain: true, is_empty: true };
        let mut odometry = LocalOdometry::new(OdometryKind::Lidar2d, Box::new(model), OdometryParams::default());
        let scan = Scan::Cloud(CloudScan { cloud: Arc::new(PointCloud::default()), t_base_sensor: Pose::identity() });
        let mut at = |s: f64, prior: Option<&MotionPrior>| {
            odometry.register(Timestamp::from_secs_f64(s), &scan, prior, None).state
        };
        for k in 0..20 {
            at(0.1 * f64::from(k), None);
        }
        let wheels = MotionPrior { t_prev_now: Pose::identity(), covariance: diagonal(0.002, 0.002) };
        assert!(at(2.7, Some(&wheels)).is_tracking(), "wheels tell how far it came");
        for k in 1..SPARSE_FRAMES {
            let state = at(2.7 + 0.8 * k as f64, None);
            assert_eq!(state, TrackingState::Lost { reason: LostReason::Degenerate }, "{k}");
        }
        assert_eq!(at(2.7 + 0.8 * SPARSE_FRAMES as f64, None), TrackingState::Initialising);
    }

    #[test]
    fn a_lidar_that_pauses_once_while_it_is_lost_keeps_its_local_map() {
        let mut odometry = LocalOdometry::new(
            OdometryKind::Lidar2d,
            Box::new(crate::odometry::lidar2d::Lidar2d::new(Default::default())),
            OdometryParams::default(),
        );
        (odometry.num_lost, odometry.unplaced_s) = (3, 0.3);
        assert_eq!(odometry.patience(0.6), OdometryParams::default().tracking.restart_after_frames);
        (odometry.num_lost, odometry.unplaced_s) = (2, 1.2);
        assert_eq!(odometry.patience(0.6), SPARSE_FRAMES);
    }
}
