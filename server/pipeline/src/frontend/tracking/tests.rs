//! Every way from one state to another, as a robot goes it.

use super::*;
use percept_geometry::Covariance6;
use percept_slam::Scale;

const MEASURED: TrackingState = TrackingState::Tracking;
const STARTED: TrackingState = TrackingState::Initialising;
const DARK: TrackingState = TrackingState::Lost { reason: LostReason::TooFewPoints };
const GAP: TrackingState = TrackingState::Lost { reason: LostReason::TimeGap };

/// Frames, one a second and metre.
#[derive(Default)]
struct Robot {
    tracking: Tracking,
    num_frames: i64,
}

impl Robot {
    fn estimate(&self, state: TrackingState, scale: Scale) -> OdometryEstimate {
        OdometryEstimate {
            stamp: Timestamp(self.num_frames * 1_000_000_000),
            t_odom_base: Pose::translation(self.num_frames as f64, 0.0, 0.0),
            covariance: Covariance6::identity(),
            state,
            inlier_ratio: 0.0,
            rmse_m: 0.0,
            iterations: 0,
            degenerate_axes: [false; 6],
            scale,
            waiting: None,
        }
    }

    fn frame(&mut self, state: TrackingState, scale: Scale, has_wheels: bool, is_mapped: bool) -> TrackingState {
        self.num_frames += 1;
        let estimate = self.estimate(state, scale);
        self.tracking.step(&estimate, has_wheels, || is_mapped);
        self.tracking.told(&estimate)
    }

    /// With wheels, away from what is mapped.
    fn drives(&mut self, state: TrackingState) -> TrackingState {
        self.frame(state, Scale::Measured, true, false)
    }

    /// Without wheels.
    fn is_carried(&mut self, state: TrackingState) -> TrackingState {
        self.frame(state, Scale::Measured, false, false)
    }

    /// With wheels, where the map knows the place.
    fn returns(&mut self, state: TrackingState) -> TrackingState {
        self.frame(state, Scale::Measured, true, true)
    }

    /// A camera in a unit of its own.
    fn without_scale(&mut self, state: TrackingState, has_wheels: bool) -> TrackingState {
        self.frame(state, Scale::Unknown, has_wheels, true)
    }

    /// Where it was anchored in the map, metres.
    fn anchored_at(&self) -> Option<f64> {
        let last = match self.tracking {
            Tracking::Initialising | Tracking::WaitingForScale => return None,
            Tracking::Anchored { last }
            | Tracking::DeadReckoning { last, .. }
            | Tracking::Lost { last }
            | Tracking::Tentative { last } => last,
            Tracking::Unanchored(unanchored) => unanchored.last,
        };
        Some(last.t_odom_base.translation.x)
    }
}

#[test]
fn the_first_frame_that_starts_a_local_model_is_anchored_to_the_map() {
    let mut robot = Robot::default();
    assert_eq!(robot.is_carried(DARK), DARK);
    assert_eq!((robot.tracking, robot.anchored_at()), (Tracking::Initialising, None));
    assert_eq!(robot.is_carried(STARTED), STARTED);
    assert!(robot.tracking.is_anchored());
    assert_eq!((robot.is_carried(MEASURED), robot.anchored_at()), (MEASURED, Some(3.0)));
}

#[test]
fn who_is_lost_for_a_moment_goes_on_where_the_old_model_fits_again() {
    let mut robot = Robot::default();
    robot.drives(STARTED);
    for _ in 0..3 {
        assert_eq!(robot.is_carried(DARK), DARK);
        assert!(matches!(robot.tracking, Tracking::Lost { .. }) && robot.anchored_at() == Some(1.0));
    }
    // Wheels that come back do not tell what happened before.
    robot.drives(DARK);
    assert!(matches!(robot.tracking, Tracking::Lost { .. }));
    robot.drives(MEASURED);
    assert!(robot.tracking.is_anchored());
}

#[test]
fn wheels_carry_the_map_through_the_dark() {
    let mut robot = Robot::default();
    robot.drives(STARTED);
    (0..5).for_each(|_| assert_eq!(robot.drives(DARK), DARK));
    assert!(matches!(robot.tracking, Tracking::DeadReckoning { is_contradicted: false, .. }));
    assert_eq!(robot.drives(STARTED), STARTED);
    assert_eq!((robot.tracking.is_anchored(), robot.anchored_at()), (true, Some(7.0)));
}

#[test]
fn a_guess_without_wheels_anchors_nothing_until_the_robot_is_found() {
    let mut robot = Robot::default();
    robot.drives(STARTED);
    robot.is_carried(DARK);
    let adrift = TrackingState::Lost { reason: LostReason::Adrift };
    for num_frames in 0..4 {
        let state = if num_frames == 0 { STARTED } else { MEASURED };
        assert_eq!(robot.is_carried(state), adrift);
        let unanchored = robot.tracking.unanchored().expect("unanchored");
        assert_eq!(
            (unanchored.num_frames, unanchored.is_reckoned, robot.anchored_at()),
            (num_frames, false, Some(1.0))
        );
    }
    // In the dark, that is what is said.
    assert_eq!(robot.is_carried(DARK), DARK);
    assert!(robot.tracking.unanchored().is_some());
    let estimate = robot.estimate(MEASURED, Scale::Measured);
    robot.tracking.found(&estimate, true);
    assert_eq!((robot.tracking.is_anchored(), robot.anchored_at()), (true, Some(7.0)));
}

#[test]
fn who_was_carried_off_is_not_where_wheels_say_if_the_map_knows_that_place_otherwise() {
    // The frame that starts anew is where the map knows the place.
    let mut robot = Robot::default();
    robot.drives(STARTED);
    robot.drives(DARK);
    robot.returns(STARTED);
    assert!(robot.tracking.unanchored().is_some_and(|u| u.is_reckoned));
    // The first frame after the gap was; the one that starts anew is not.
    let mut robot = Robot::default();
    robot.drives(STARTED);
    robot.returns(GAP);
    robot.drives(DARK);
    robot.drives(STARTED);
    assert!(robot.tracking.unanchored().is_some());
    // In the dark nothing contradicts.
    let mut robot = Robot::default();
    robot.drives(STARTED);
    robot.returns(DARK);
    robot.drives(STARTED);
    assert!(robot.tracking.is_anchored());
}

#[test]
fn a_camera_waits_for_its_scale_and_is_not_anchored_before() {
    let mut robot = Robot::default();
    assert_eq!(robot.without_scale(STARTED, false), STARTED);
    assert_eq!(robot.without_scale(MEASURED, false), MEASURED);
    assert_eq!((robot.tracking, robot.anchored_at()), (Tracking::WaitingForScale, None));
    robot.frame(MEASURED, Scale::FromOdometry, true, true);
    assert!(robot.tracking.is_anchored());
}

#[test]
fn a_camera_that_begins_anew_keeps_its_place_as_long_as_something_covers_it() {
    let mut robot = Robot::default();
    robot.frame(MEASURED, Scale::FromOdometry, true, false);
    assert_eq!(robot.without_scale(STARTED, true), STARTED);
    assert_eq!(robot.without_scale(MEASURED, false), MEASURED);
    assert!(matches!(robot.tracking, Tracking::DeadReckoning { .. }) && robot.anchored_at() == Some(1.0));
    assert_eq!(robot.without_scale(DARK, false), DARK);
    assert!(robot.tracking.unanchored().is_some_and(|u| u.num_frames == 0));
    let adrift = TrackingState::Lost { reason: LostReason::Adrift };
    assert_eq!(robot.without_scale(STARTED, true), STARTED, "it says what it waits for");
    assert_eq!(robot.without_scale(MEASURED, true), adrift);
    assert_eq!(robot.frame(MEASURED, Scale::FromOdometry, true, false), adrift);
    assert_eq!(robot.tracking.unanchored().map(|u| u.num_frames), Some(1));
}
