//! Whether the robot's place in the map is measured or guessed, and the way back from a guess.
//!
//! Odometry that was lost for too long starts a new local model at a pose that it predicted. If wheels covered
//! every frame of the loss, that pose is dead reckoning and mapping goes on. Otherwise nothing measured ties it to
//! the map: the robot counts as lost and the map stays as it is, until a frame fits the keyframes where it was last
//! known to be.

use percept_geometry::{KeyframeScan, Pose, Timestamp};
use percept_slam::{MotionPrior, Odometry, OdometryEstimate, OdometryKind, OdometryParams, Scan, TrackingState};
use std::sync::Arc;

/// While adrift, every so many frames are tried against the old keyframes: the model has to be built each time.
const TRY_EVERY: u32 = 3;
/// A frame is believed to be back if it fits this share of how well frames usually fit, and this well at least:
/// rooms resemble each other.
const SURE: (f64, f64) = (0.8, 0.6);

/// Where odometry stands towards the map.
#[derive(Debug)]
pub(crate) struct Anchoring {
    /// Odom pose and time of the newest frame that was measured or dead-reckoned.
    last: Option<(Pose, Timestamp)>,
    /// Whether wheels covered every frame since then.
    reckoned: bool,
    /// Frames since odometry restarted from a guess; none while it did not.
    adrift: Option<u32>,
    /// Running mean of the inlier ratio; 0 before the first.
    usual_inlier_ratio: f64,
}

impl Default for Anchoring {
    fn default() -> Self {
        Self { last: None, reckoned: true, adrift: None, usual_inlier_ratio: 0.0 }
    }
}

impl Anchoring {
    /// An anchoring that goes on from a stored pose.
    pub(crate) fn at(t_odom_base: Pose, stamp: Timestamp) -> Self {
        Self { last: Some((t_odom_base, stamp)), ..Self::default() }
    }

    /// Whether the frame's pose is tied to the map, by measurement or by wheels.
    pub(crate) fn judge(&mut self, estimate: &OdometryEstimate, prior: Option<&MotionPrior>) -> bool {
        self.reckoned &= prior.is_some() || self.last.is_none() || estimate.state.is_tracking();
        if let Some(frames) = &mut self.adrift {
            *frames += 1;
            return false;
        }
        match estimate.state {
            TrackingState::Lost { .. } => return false,
            TrackingState::Initialising if !self.reckoned => {
                self.adrift = Some(0);
                return false;
            }
            TrackingState::Initialising | TrackingState::Tracking => {}
        }
        if estimate.state.is_tracking() {
            self.usual_inlier_ratio += 0.1 * (estimate.inlier_ratio - self.usual_inlier_ratio);
        }
        self.last = Some((estimate.t_odom_base, estimate.stamp));
        self.reckoned = true;
        true
    }

    /// Whether poses hang on a guess.
    pub(crate) fn is_adrift(&self) -> bool {
        self.adrift.is_some()
    }

    /// Tries to find the frame among the keyframes where the robot was last known to be, oldest first; the odometry
    /// to go on with, if it fits.
    pub(crate) fn recover(
        &mut self,
        (kind, params): (OdometryKind, &OdometryParams),
        keyframes: impl FnOnce() -> Vec<(Pose, Arc<KeyframeScan>)>,
        stamp: Timestamp,
        scan: &Scan,
    ) -> Option<(Odometry, OdometryEstimate)> {
        let (t_odom_base, last) = self.last?;
        if !self.adrift?.is_multiple_of(TRY_EVERY) {
            return None;
        }
        let mut odometry = Odometry::new(kind, params.clone());
        odometry.seed(&t_odom_base, &keyframes(), last);
        let estimate = odometry.register(stamp, scan, None);
        let sure = estimate.inlier_ratio >= SURE.1.max(SURE.0 * self.usual_inlier_ratio);
        (estimate.state.is_tracking() && sure).then(|| {
            self.last = Some((estimate.t_odom_base, stamp));
            (self.reckoned, self.adrift) = (true, None);
            (odometry, estimate)
        })
    }
}
