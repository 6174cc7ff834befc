//! One robot: sensor frames in; its pose in odom, whether that is anchored in the map, and keyframes out.
//!
//! The front end knows no pose in the map. What it has to know of the map it asks by functions that it is handed.
//! Start with [`Frontend::take`] and [`Frontend::register`].

mod clock_offset;
mod comoving;
mod extrinsics;
mod floor_beams;
mod imu_prior;
mod keyframes;
mod leading;
mod motion;
mod odometry_prior;
mod restart_check;
mod resume;
mod scale_hints;
mod second;
mod sensors;
mod stray_returns;
mod sureness;
mod tracking;
mod view;
mod wheels_check;

pub use extrinsics::MountOffset;
pub use sensors::check_frame;
pub use stray_returns::{MOSTLY_STRAY, share_of_strays};
pub(crate) use sureness::FoundAt;
pub(crate) use tracking::{Tracking, Unanchored};
pub(crate) use view::{Found, Keyframe, Registered, View};
pub use wheels_check::WheelsFault;

use crate::{FrameError, SlamParams};
use comoving::Comoving;
use extrinsics::ExtrinsicsCheck;
use motion::{MotionSensors, Prior};
use nalgebra::{Unit, Vector3};
use percept_geometry::{Pose, SensorFrame, SensorId, SensorKind, SensorSpec, Timestamp};
use percept_slam::{
    ImuFault, KeyframePolicy, LostReason, Odometry, OdometryEstimate, OdometryKind, Scan, TrackingState,
};
use restart_check::Restarts;
use scale_hints::ScaleHints;
use second::SecondSensors;
use sensors::{Sensors, scan_of};
use std::collections::BTreeMap;
use std::sync::Arc;

/// One robot's sensors, priors, odometry, and what that is worth.
pub(crate) struct Frontend {
    params: SlamParams,
    sensors: Sensors,
    motion: MotionSensors,
    odometry: Option<Odometry>,
    second: SecondSensors,
    scale_hints: ScaleHints,
    tracking: Tracking,
    /// Local models that were begun anew, as wheels see them.
    restarts: Restarts,
    comoving: Comoving,
    /// Whether the newest pose is in metres.
    is_metric: bool,
    /// Running mean of the inlier ratio of frames that were anchored in the map; 0 before the first.
    usual_inlier_ratio: f64,
    extrinsics: ExtrinsicsCheck,
    keyframe_policies: BTreeMap<SensorId, KeyframePolicy>,
    last_registered: Option<Timestamp>,
}

impl Frontend {
    /// Bytes that odometry takes, about.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.odometry.as_ref().map_or(0, Odometry::memory_bytes) + self.second.memory_bytes()
    }

    /// Without sensors. Validate `params` first.
    pub(crate) fn new(params: SlamParams) -> Self {
        Self {
            params,
            sensors: Sensors::default(),
            motion: MotionSensors::default(),
            odometry: None,
            second: SecondSensors::default(),
            scale_hints: ScaleHints::default(),
            tracking: Tracking::default(),
            restarts: Restarts::default(),
            comoving: Comoving::default(),
            is_metric: false,
            usual_inlier_ratio: 0.0,
            extrinsics: ExtrinsicsCheck::default(),
            keyframe_policies: BTreeMap::new(),
            last_registered: None,
        }
    }

    /// Makes keyframes by other parameters from now on; others hold for a session's life.
    pub(crate) fn set_params(&mut self, params: SlamParams) {
        let keyframe = &params.odometry.keyframe;
        self.keyframe_policies.values_mut().for_each(|policy| policy.set_params(keyframe.clone()));
        if let Some(odometry) = &mut self.odometry {
            odometry.set_keyframe_params(keyframe.clone());
        }
        self.second.set_keyframe_params(keyframe);
        self.params = params;
    }

    /// Adds a sensor, or replaces its declaration. What waits of one whose clock or extrinsics are others now is dropped.
    pub(crate) fn declare_sensor(&mut self, spec: SensorSpec) {
        let is_other = |before: &SensorSpec| {
            before.time_offset_s != spec.time_offset_s || before.t_base_sensor != spec.t_base_sensor
        };
        if self.sensors.spec(&spec.id).is_some_and(is_other) {
            self.motion.forget(&spec.id);
            if let Some(odometry) = self.odometry.as_mut().filter(|_| spec.kind == SensorKind::Imu) {
                odometry.forget_imu();
            }
        }
        if self.sensors.spec(&spec.id).is_some_and(|before| *before != spec) {
            self.second.forget(&spec.id);
        }
        self.sensors.declare(spec);
    }

    /// The declaration of a sensor.
    pub(crate) fn sensor(&self, id: &SensorId) -> Option<&SensorSpec> {
        self.sensors.spec(id)
    }

    /// The sensor that moves the pose, once it is chosen.
    pub(crate) fn pose_sensor(&self) -> Option<&SensorId> {
        self.sensors.pose_sensor()
    }

    /// Takes a frame in; none for wheels and IMUs, whose samples wait for the frames that they are priors of.
    ///
    /// # Errors
    /// Bad input, by variant; nothing was changed.
    pub(crate) fn take(&mut self, frame: &SensorFrame) -> Result<Option<View>, FrameError> {
        let (spec, stamp) = self.sensors.admit(frame)?;
        self.motion.take(&spec, stamp, &frame.data);
        let Some(mut scan) = scan_of(&spec, &frame.data) else { return Ok(None) };
        let before = self.sensors.pose_sensor().cloned();
        let is_of_pose_sensor = self.sensors.is_pose_sensor(&frame.sensor, &self.params.pose_sensor, stamp);
        let has_taken_over = is_of_pose_sensor && before.is_some_and(|before| before != frame.sensor);
        if is_of_pose_sensor {
            self.scale_hints.see_image(stamp, &mut scan);
        } else {
            self.tell_scale(stamp, &scan);
        }
        Ok(Some(View { spec, stamp, scan, is_of_pose_sensor, has_taken_over }))
    }

    /// A frame of another sensor tells a camera its scale, perhaps; a second camera holds it as well.
    fn tell_scale(&mut self, stamp: Timestamp, scan: &Scan) {
        if self.is_metric && !matches!(scan, Scan::Image(_)) {
            return;
        }
        if let (Some(hint), Some(odometry)) = (self.scale_hints.see_other(stamp, scan), &mut self.odometry) {
            odometry.tell_scale(&hint);
        }
    }

    /// Places a view that moves the pose, and steps on with what that is worth. `is_mapped`: whether the robot has been before
    /// where odometry believes to be.
    pub(crate) fn register(&mut self, view: &View, is_mapped: impl Fn(&Pose) -> bool) -> Registered {
        let (stamp, since) = (view.stamp, self.last_registered);
        if self.motion.choose_imu(stamp)
            && let Some(odometry) = &mut self.odometry
        {
            odometry.forget_imu();
        }
        let kind = kind_of(&view.scan);
        let led = self.led(kind, stamp);
        // What sees well needs no help, and what is a little off in every step would drag its map along.
        let needs_help = !self.second.is_pose_known();
        let second = led.as_ref().filter(|_| needs_help).and_then(|led| self.second.motion_to(led));
        let Prior { motion, wheels, imu } = self.motion.prior(since, stamp, second);
        let odometry = self.odometry.get_or_insert_with(|| Odometry::new(kind, self.params.odometry.clone()));
        let (t_odom_last, was_tracking) = (*odometry.t_odom_base(), odometry.is_tracking());
        let trusted = wheels.as_ref().filter(|w| !w.are_blamed).map(|w| &w.t_prev_now);
        let without = self.comoving.leave_out(&view.scan, trusted, &t_odom_last);
        let (scan, motion) = match &without {
            Some(without) => (&without.scan, without.prior(&t_odom_last).or(motion)),
            None => (&view.scan, motion),
        };
        let estimate = odometry.register_with_imu(stamp, scan, motion.as_ref(), imu);
        self.comoving.placed(Some((&t_odom_last, &estimate.t_odom_base)).filter(|_| estimate.state.is_tracking()));
        let moves_along = self.restarts.compare(wheels.as_ref().map(|w| &w.t_prev_now), &estimate);
        let anew = moves_along.and_then(|(t_odom_base, told)| odometry.lead_to(&t_odom_base, &told, stamp));
        let moved_along = anew.is_some();
        let estimate = anew.unwrap_or(estimate);
        let (moved, num_unbelieved) = (odometry.take_moved(), odometry.num_imu_unbelieved());
        self.restarts.follow(wheels.as_ref().map(|w| w.are_proven), &estimate);
        if let Some(last) =
            since.filter(|_| was_tracking && estimate.state.is_tracking() && !self.restarts.is_comparing())
        {
            let moved = t_odom_last.inv_mul(&estimate.t_odom_base);
            let known = (kind == OdometryKind::Lidar2d, estimate.scale.is_metric());
            self.motion.learn((last, stamp), &moved, known, num_unbelieved);
        } else {
            self.motion.was_lost();
        }
        self.last_registered = Some(stamp);
        self.is_metric = estimate.scale.is_metric();
        let (estimate, led_by) = self.with_stand_in(estimate, kind, led);
        let is_back = self.tracking.is_lost() && estimate.state.is_tracking() && led_by.is_none();
        let is_doubtful = is_back && !is_sure(estimate.inlier_ratio, self.usual_inlier_ratio);
        // What spoke against the place where wheels have led moved with the robot, or wheels never agreed with it.
        let begins = self.restarts.is_comparing() && estimate.state == TrackingState::Initialising;
        if (begins || moved_along) && self.restarts.speak_against_nothing() {
            self.tracking.reckon();
        }
        self.tracking.step(&estimate, wheels.is_some(), || is_mapped(&estimate.t_odom_base));
        if self.tracking.unanchored().is_none() {
            self.restarts.forget();
        }
        if self.tracking.is_anchored() && led_by.is_none() && estimate.state.is_tracking() {
            self.usual_inlier_ratio += 0.1 * (estimate.inlier_ratio - self.usual_inlier_ratio);
        }
        Registered { estimate, kind, led_by, is_doubtful, moved_along, moved }
    }

    /// How the newest pose hangs on the map.
    pub(crate) fn tracking(&self) -> &Tracking {
        &self.tracking
    }

    /// Whether odometry has begun anew, and may have begun with what moves with the robot.
    pub(crate) fn may_move_along(&self) -> bool {
        self.restarts.may_move_along()
    }

    /// What is said of a pose that odometry has estimated.
    pub(crate) fn told(&self, estimate: &OdometryEstimate) -> TrackingState {
        let state = self.tracking.told(estimate);
        let is_along = self.restarts.are_along() && !state.is_lost();
        if is_along { TrackingState::Lost { reason: LostReason::Adrift } } else { state }
    }

    /// How well frames that were anchored in the map usually fitted: share of their points, 0 before the first.
    pub(crate) fn usual_inlier_ratio(&self) -> f64 {
        self.usual_inlier_ratio
    }

    /// Goes on in the map where the robot was found.
    pub(crate) fn found(&mut self, found: Found) -> OdometryEstimate {
        if let Some(odometry) = found.odometry {
            self.odometry = Some(odometry);
            self.comoving.forget_places();
        }
        self.tracking.found(&found.estimate, found.is_certain);
        self.second.pose_jumped();
        self.is_metric = found.estimate.scale.is_metric();
        found.estimate
    }

    /// The robot may be elsewhere than where it is in the map.
    pub(crate) fn doubt(&mut self) {
        self.tracking.doubt();
    }

    /// The robot is where it was found; or it is not, and adrift.
    pub(crate) fn confirm(&mut self, estimate: &OdometryEstimate, is_there: bool) {
        if is_there { self.tracking.found(estimate, true) } else { self.tracking.withdraw() }
    }

    /// The direction against gravity in base, if an IMU was at rest just before a stamp.
    pub(crate) fn up(&self, stamp: Timestamp) -> Option<Unit<Vector3<f64>>> {
        self.motion.up(stamp)
    }

    /// Seconds by which sensors' stamps are late behind the pose sensor's, as far as that is known.
    pub(crate) fn clock_offsets(&self) -> Arc<BTreeMap<SensorId, f64>> {
        self.motion.clock_offsets()
    }

    /// How wheels contradict the pose sensor, as far as that is known.
    pub(crate) fn wheels_faults(&self) -> Arc<BTreeMap<SensorId, Vec<WheelsFault>>> {
        self.motion.wheels_faults()
    }

    /// What is wrong with IMUs, as far as that is known.
    pub(crate) fn imu_faults(&self) -> Arc<BTreeMap<SensorId, Vec<ImuFault>>> {
        self.motion.imu_faults()
    }

    /// Sensors that are not mounted as declared, by how far.
    pub(crate) fn mount_offsets(&self) -> Arc<BTreeMap<SensorId, MountOffset>> {
        self.extrinsics.told()
    }
}

/// A frame is believed to be back if it fits this share of how well frames usually fit, and this well at least: rooms resemble each other.
const SURE: (f64, f64) = (0.8, 0.6);

/// Whether a frame of a robot that was lost fits well enough to be where it was.
pub(crate) fn is_sure(inlier_ratio: f64, usual_inlier_ratio: f64) -> bool {
    inlier_ratio >= SURE.1.max(SURE.0 * usual_inlier_ratio)
}

/// The method for what a scan shows.
fn kind_of(scan: &Scan) -> OdometryKind {
    match scan {
        Scan::Depth(_) => OdometryKind::Rgbd,
        Scan::Cloud(_) => OdometryKind::Lidar3d,
        Scan::Planar(_) => OdometryKind::Lidar2d,
        Scan::Image(_) => OdometryKind::Mono,
    }
}
