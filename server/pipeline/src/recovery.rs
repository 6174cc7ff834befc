//! Whether the robot's place in the map is measured or guessed, and the way back from a guess.
//!
//! Odometry that was lost for too long starts a new local model at a pose that it predicted. If wheels covered
//! every frame of the loss, that pose is dead reckoning and mapping goes on. Otherwise nothing measured ties it to
//! the map: the robot counts as lost and the map stays as it is, until a frame fits the keyframes where it was last
//! known to be.

use percept_geometry::{KeyframeScan, Pose, Timestamp};
use percept_slam::{
    LostReason, MotionPrior, Odometry, OdometryEstimate, OdometryKind, OdometryParams, Scan, TrackingState,
};
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
    /// Whether a frame that followed a gap did not fit the map where wheels said that it is in it.
    misplaced: bool,
    /// Frames since odometry restarted from a guess; none while it did not.
    adrift: Option<u32>,
    /// Running mean of the inlier ratio; 0 before the first.
    usual_inlier_ratio: f64,
}

impl Default for Anchoring {
    fn default() -> Self {
        Self { last: None, reckoned: true, misplaced: false, adrift: None, usual_inlier_ratio: 0.0 }
    }
}

impl Anchoring {
    /// An anchoring that goes on from a stored pose.
    pub(crate) fn at(t_odom_base: Pose, stamp: Timestamp) -> Self {
        Self { last: Some((t_odom_base, stamp)), ..Self::default() }
    }

    /// Whether the frame's pose is tied to the map, by measurement or by wheels.
    /// `is_mapped`: the robot has been before where odometry believes to be.
    pub(crate) fn judge(
        &mut self,
        estimate: &OdometryEstimate,
        prior: Option<&MotionPrior>,
        is_mapped: impl Fn() -> bool,
    ) -> bool {
        self.reckoned &= prior.is_some() || self.last.is_none() || estimate.state.is_tracking();
        if let Some(frames) = &mut self.adrift {
            *frames += 1;
            return false;
        }
        match estimate.state {
            TrackingState::Lost { reason } => {
                self.misplaced |= reason == LostReason::TimeGap && is_mapped();
                return false;
            }
            // A frame that does not fit the map where wheels say that it is in it: somebody carried the robot, perhaps.
            TrackingState::Initialising
                if !self.reckoned || (self.last.is_some() && (self.misplaced || is_mapped())) =>
            {
                (self.adrift, self.misplaced) = (Some(0), false);
                return false;
            }
            TrackingState::Initialising | TrackingState::Tracking => {}
        }
        if estimate.state.is_tracking() {
            self.usual_inlier_ratio += 0.1 * (estimate.inlier_ratio - self.usual_inlier_ratio);
        }
        self.last = Some((estimate.t_odom_base, estimate.stamp));
        (self.reckoned, self.misplaced) = (true, false);
        true
    }

    /// A frame whose pose is in no known unit: whether it goes on from the map is kept in mind until lengths are metres.
    pub(crate) fn judge_without_scale(&mut self, estimate: &OdometryEstimate, has_wheels: bool) {
        self.reckoned &= has_wheels || self.last.is_none() || estimate.state.is_tracking();
        if !self.reckoned {
            self.adrift.get_or_insert(0);
        }
    }

    /// Whether poses hang on a guess.
    pub(crate) fn is_adrift(&self) -> bool {
        self.adrift.is_some()
    }

    /// Frames since odometry restarted from a guess.
    pub(crate) fn frames_adrift(&self) -> Option<u32> {
        self.adrift
    }

    /// The frame's place in the map was found.
    pub(crate) fn found(&mut self, estimate: &OdometryEstimate) {
        self.last = Some((estimate.t_odom_base, estimate.stamp));
        (self.reckoned, self.adrift) = (true, None);
    }

    /// Tries to find the frame among the keyframes (oldest first) where the robot was last known to be, and in the first
    /// frame where wheels say it is; the odometry to go on with, if it fits.
    pub(crate) fn recover(
        &mut self,
        (kind, params): (OdometryKind, &OdometryParams),
        estimate: &OdometryEstimate,
        keyframes_near: impl Fn(&Pose) -> Vec<(Pose, Arc<KeyframeScan>)>,
        scan: &Scan,
    ) -> Option<(Odometry, OdometryEstimate)> {
        let (t_odom_base, last) = self.last?;
        let frames = self.adrift?;
        let (place, stamp) = match frames {
            0 if self.reckoned => (estimate.t_odom_base, last),
            n if n.is_multiple_of(TRY_EVERY) => (t_odom_base, last),
            _ => return None,
        };
        let mut odometry = Odometry::new(kind, params.clone());
        odometry.seed(&place, &keyframes_near(&place), stamp);
        let estimate = odometry.register(estimate.stamp, scan, None);
        let sure = estimate.inlier_ratio >= SURE.1.max(SURE.0 * self.usual_inlier_ratio);
        (estimate.state.is_tracking() && sure).then(|| {
            self.found(&estimate);
            (odometry, estimate)
        })
    }
}
