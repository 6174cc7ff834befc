//! Sessions, poses, trajectories, acknowledgements, events.

use super::{geometry, scene, sensors, streams};
use crate::{params, v1};
use percept_geometry::{Pose, Timestamp};
use percept_pipeline::{KeyframeInfo, PipelineParams, PoseAt, PoseEstimate, TrajectoryEntry};
use percept_service::{
    Error, Event, EventKind, NewSession, Processed, Result, SessionDescription, SessionMode, SessionState, SessionView,
    TrajectoryRequest, Transform,
};
use percept_slam::{LostReason, Scale, TrackingState, Waiting};

/// What a session is created with.
///
/// # Errors
/// Naming the field.
pub fn new_session(r: &v1::CreateSessionRequest, defaults: &PipelineParams) -> Result<NewSession> {
    use v1::SessionMode as M;
    let mode = match M::try_from(r.mode) {
        Ok(M::Unspecified | M::Mapping) => SessionMode::Mapping,
        Ok(M::IngestOnly) => SessionMode::IngestOnly,
        Err(_) => return Err(super::unknown_enum("mode", r.mode)),
    };
    let declare =
        |(i, s): (usize, &v1::SensorSpec)| sensors::declaration(s).map_err(|e| e.within(&format!("sensors[{i}]")));
    let sensors: Vec<_> = r.sensors.iter().enumerate().map(declare).collect::<Result<_>>()?;
    let specs: Vec<_> = sensors.iter().map(|d| d.spec.clone()).collect();
    Ok(NewSession {
        id: r.session_id.clone(),
        display_name: r.display_name.clone(),
        labels: r.labels.clone().into_iter().collect(),
        mode,
        sensors,
        params: params::pipeline(r.params.as_ref(), defaults, &specs)?,
        request_id: r.request_id.clone(),
    })
}

/// What is known of a session as a message: without parameters and sensors, as lists have it.
pub fn view_to(s: &SessionView) -> v1::Session {
    let mode = match s.mode {
        SessionMode::Mapping => v1::SessionMode::Mapping,
        SessionMode::IngestOnly => v1::SessionMode::IngestOnly,
    };
    let pose = s.live.as_ref().and_then(|live| live.snapshot().pose.as_ref().map(pose_to));
    let fault = s.fault.as_ref().map(|fault| v1::ErrorInfo {
        reason: fault.reason.to_owned(),
        message: fault.message.clone(),
        field: String::new(),
        code: percept_service::ErrorCode::FailedPrecondition.name().to_owned(),
        ..v1::ErrorInfo::default()
    });
    v1::Session {
        session_id: s.id.clone(),
        display_name: s.display_name.clone(),
        mode: mode.into(),
        create_time_ns: s.create_time_ns,
        params: None,
        sensors: vec![],
        pose,
        num_keyframes: s.counts.num_keyframes,
        num_objects: s.counts.num_objects,
        map_version: s.counts.map_version,
        queue_length: s.live.as_ref().map_or(0, |live| live.queue_len() as u32),
        state: state_to(s.state).into(),
        fault,
        last_used_ns: s.last_used_ns,
        last_stamp_ns: Some(s.counts.last_stamp_ns).filter(|stamp| *stamp != 0),
        tenant: s.tenant.clone(),
        labels: s.labels.clone().into_iter().collect(),
        etag: s.etag.clone(),
        zones: vec![],
        zone_masks: vec![],
        stream_notes: vec![],
        recorded: s.recording.is_recorded,
        recording: s.recording.newest.as_ref().map(super::recordings::recording_to),
    }
}

/// A session as a message, with parameters and sensors where they can be read.
///
/// # Errors
/// `INTERNAL` if the parameters do not fit the contract.
pub fn description_to(s: &SessionDescription) -> Result<v1::Session> {
    let view = view_to(&s.view);
    let Some((meta, statuses)) = &s.whole else { return Ok(view) };
    let params = Some(params::pipeline_to(&meta.params)?);
    Ok(v1::Session {
        display_name: meta.display_name.clone(),
        labels: meta.labels.clone().into_iter().collect(),
        etag: meta.etag(),
        zones: meta.zones.iter().map(super::zones::zone_to).collect(),
        zone_masks: meta.zone_masks.iter().map(super::zones::mask_to).collect(),
        params,
        sensors: statuses.iter().map(streams::status_to).collect(),
        stream_notes: s.view.live.iter().flat_map(|live| live.stream_notes()).map(streams::note_to).collect(),
        ..view
    })
}

pub(super) fn state_to(state: SessionState) -> v1::SessionState {
    match state {
        SessionState::Creating => v1::SessionState::Creating,
        SessionState::Asleep => v1::SessionState::Asleep,
        SessionState::Waking => v1::SessionState::Waking,
        SessionState::Awake => v1::SessionState::Awake,
        SessionState::Faulted => v1::SessionState::Faulted,
        SessionState::Deleting => v1::SessionState::Deleting,
    }
}

/// The state that a list is asked for, if any.
///
/// # Errors
/// `ENUM_UNKNOWN` naming the field.
pub fn wanted_state(state: i32) -> Result<Option<SessionState>> {
    use v1::SessionState as S;
    Ok(match S::try_from(state).map_err(|_| super::unknown_enum("state", state))? {
        S::Unspecified => None,
        S::Creating => Some(SessionState::Creating),
        S::Asleep => Some(SessionState::Asleep),
        S::Waking => Some(SessionState::Waking),
        S::Awake => Some(SessionState::Awake),
        S::Faulted => Some(SessionState::Faulted),
        S::Deleting => Some(SessionState::Deleting),
    })
}

/// A pose as a message.
pub fn pose_to(p: &PoseEstimate) -> v1::PoseEstimate {
    let (state, lost_reason) = match &p.state {
        TrackingState::Initialising => (v1::TrackingState::Initialising, None),
        TrackingState::Tracking => (v1::TrackingState::Tracking, None),
        TrackingState::Lost { reason } => (v1::TrackingState::Lost, Some(*reason)),
    };
    v1::PoseEstimate {
        stamp_ns: p.stamp.nanos(),
        state: state.into(),
        t_map_base: Some(geometry::pose_to(&p.t_map_base)),
        covariance: Some(geometry::covariance_to(&p.covariance)),
        t_odom_base: Some(geometry::pose_to(&p.t_odom_base)),
        lost_reason: lost_reason.map_or(v1::LostReason::Unspecified, lost_reason_to).into(),
        lost_message: lost_reason.map(|r| r.to_string()).unwrap_or_default(),
        inlier_ratio: p.inlier_ratio,
        rmse_m: p.rmse_m,
        degenerate_axes: p.degenerate_axes.to_vec(),
        scale: scale_to(p.scale.is_metric()).into(),
        scale_source: scale_source_to(p.scale).into(),
        scale_message: p.scale.to_string(),
        waiting_for: p.waiting.map_or(v1::WaitingFor::Unspecified, waiting_to).into(),
        waiting_message: p.waiting.map(|w| w.to_string()).unwrap_or_default(),
        relocalised: p.is_relocalised,
        tentative: p.is_tentative,
        led_by: p.led_by.as_ref().map(|s| s.0.clone()).unwrap_or_default(),
        map_version: p.map_version,
    }
}

/// A pose at a time as a message.
pub fn pose_at_to(p: &PoseAt, map_version: u64) -> v1::PoseAt {
    v1::PoseAt {
        stamp_ns: p.stamp.nanos(),
        t_map_base: Some(geometry::pose_to(&p.t_map_base)),
        t_odom_base: p.t_odom_base.as_ref().map(geometry::pose_to),
        state: tracked_to(p.is_tracked).into(),
        scale: scale_to(p.is_metric).into(),
        before_ns: p.before.nanos(),
        after_ns: p.after.nanos(),
        map_version,
    }
}

/// A transform as a message.
pub fn transform_to(r: &v1::LookupTransformRequest, t: &Transform) -> v1::Transform {
    v1::Transform {
        target_frame: r.target_frame.clone(),
        source_frame: r.source_frame.clone(),
        t_target_source: Some(geometry::pose_to(&t.t_target_source)),
        stamp_ns: t.moving.map(|m| m.stamp.nanos()),
        state: t.moving.map_or(v1::TrackingState::Unspecified, |m| tracked_to(m.is_tracked)).into(),
        scale: t.moving.map_or(v1::Scale::Unspecified, |m| scale_to(m.is_metric)).into(),
        map_version: t.map_version,
    }
}

fn tracked_to(is_tracked: bool) -> v1::TrackingState {
    if is_tracked { v1::TrackingState::Tracking } else { v1::TrackingState::Lost }
}

/// Which part of a trajectory is asked for.
pub fn trajectory_request(r: &v1::GetTrajectoryRequest) -> TrajectoryRequest {
    TrajectoryRequest {
        from: r.from_ns.map(Timestamp),
        to: r.to_ns.map(Timestamp),
        max_poses: r.max_poses,
        page_size: r.page_size,
        page_token: r.page_token.clone(),
    }
}

fn lost_reason_to(reason: LostReason) -> v1::LostReason {
    use v1::LostReason as R;
    match reason {
        LostReason::TooFewPoints => R::TooFewPoints,
        LostReason::TooFewCorrespondences => R::TooFewCorrespondences,
        LostReason::ResidualTooLarge => R::ResidualTooLarge,
        LostReason::MotionTooLarge => R::MotionTooLarge,
        LostReason::Degenerate => R::Degenerate,
        LostReason::TimeGap => R::TimeGap,
        LostReason::UnsuitableScan => R::UnsuitableScan,
        LostReason::NoTexture => R::NoTexture,
        LostReason::BadExposure => R::BadExposure,
        LostReason::IntrinsicsMismatch => R::IntrinsicsMismatch,
        LostReason::Adrift => R::Adrift,
    }
}

fn scale_source_to(scale: Scale) -> v1::ScaleSource {
    match scale {
        Scale::Measured => v1::ScaleSource::Sensor,
        Scale::Unknown => v1::ScaleSource::None,
        Scale::FromOdometry => v1::ScaleSource::Odometry,
        Scale::FromDepth => v1::ScaleSource::Depth,
        Scale::FromBaseline => v1::ScaleSource::Baseline,
    }
}

fn waiting_to(waiting: Waiting) -> v1::WaitingFor {
    match waiting {
        Waiting::SecondView => v1::WaitingFor::SecondView,
        Waiting::NoParallax => v1::WaitingFor::Parallax,
        Waiting::FewMatches => v1::WaitingFor::Matches,
    }
}

fn scale_to(is_metric: bool) -> v1::Scale {
    if is_metric { v1::Scale::Metric } else { v1::Scale::Unknown }
}

/// A keyframe as a message.
pub fn keyframe_to(k: &KeyframeInfo) -> v1::Keyframe {
    v1::Keyframe {
        keyframe_id: k.id.0,
        stamp_ns: k.stamp.nanos(),
        sensor_id: k.sensor.0.clone(),
        t_map_base: Some(geometry::pose_to(&k.t_map_base)),
        num_points: k.num_points as u32,
    }
}

/// A pose of the trajectory as a message.
pub fn trajectory_pose_to(t_map_base: &Pose, entry: &TrajectoryEntry) -> v1::TrajectoryPose {
    v1::TrajectoryPose {
        stamp_ns: entry.stamp.nanos(),
        t_map_base: Some(geometry::pose_to(t_map_base)),
        state: tracked_to(entry.tracked).into(),
        keyframe_id: entry.anchor.filter(|_| entry.is_keyframe).map(|k| k.0),
        scale: scale_to(entry.anchor.is_some()).into(),
    }
}

/// What a frame did, as a message.
pub fn result_to(p: &Processed) -> v1::FrameResult {
    v1::FrameResult {
        pose: p.pose.as_ref().map(pose_to),
        keyframe_id: p.keyframe.map(|k| k.0),
        latency_s: p.latency_s,
        duplicate: p.is_duplicate,
    }
}

/// An error as a message.
pub fn error_to(e: &Error) -> v1::ErrorInfo {
    v1::ErrorInfo {
        reason: e.reason.to_owned(),
        message: e.message.clone(),
        field: e.field.clone(),
        code: e.code.name().to_owned(),
        // Of the stream: its sender knows it.
        trace_id: String::new(),
        server: e.server.clone(),
        retry_after_s: e.retry_after.map_or(0.0, |after| after.as_secs_f64()),
    }
}

/// An event as a message.
pub fn event_to(event: &Event) -> v1::SessionEvent {
    use v1::session_event::Event as E;
    let kind = match &event.kind {
        EventKind::Pose(p) => E::Pose(pose_to(p)),
        EventKind::Keyframe(k) => E::KeyframeAdded(keyframe_to(k)),
        EventKind::Object(changed) => E::ObjectChanged(scene::change_to(&changed.0, changed.1.as_ref())),
        EventKind::Loop(l) => E::LoopChanged(super::maps::loop_to(l)),
        EventKind::MapVersion(v) => E::MapVersion(*v),
        EventKind::Resync(missed) => E::Resync(v1::Resync { missed: *missed }),
    };
    v1::SessionEvent { token: event.token, stamp_ns: event.stamp.nanos(), event: Some(kind) }
}
