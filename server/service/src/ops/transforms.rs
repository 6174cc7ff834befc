//! Where the robot was, where frames are, and parts of the trajectory.

use crate::reason;
use crate::{Error, ErrorCode, Page, Result, SensorDeclaration, Service, Session, SessionMode, check_id};
use percept_geometry::{Pose, Timestamp};
use percept_pipeline::{LookupError, PoseAt, PoseEstimate, Snapshot, Told, TrajectoryEntry};
use std::sync::Arc;

/// Coordinates that a robot can have in a map, metres: the earth's radius, of maps whose origin is its centre.
const FARTHEST_M: f64 = 6.4e6;
/// Poses that a thinned trajectory has at least.
const LEAST_POSES: u32 = 2;

/// Where one frame is, seen from another.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform {
    /// Source coordinates to target coordinates.
    pub t_target_source: Pose,
    /// For which time, and how well it is known; none if it holds for all times.
    pub moving: Option<Moving>,
    /// Version of the map that it refers to.
    pub map_version: u64,
}

/// A transform between frames that move against each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moving {
    /// For this time.
    pub stamp: Timestamp,
    /// Whether it was measured.
    pub is_tracked: bool,
    /// Whether lengths are metres.
    pub is_metric: bool,
}

/// Which part of a trajectory is asked for.
#[derive(Debug, Clone, Default)]
pub struct TrajectoryRequest {
    /// From this time on.
    pub from: Option<Timestamp>,
    /// Up to this time.
    pub to: Option<Timestamp>,
    /// At most this many, at even distances; 0: all.
    pub max_poses: u32,
    /// At most this many at a time; 0: all.
    pub page_size: u32,
    /// Where to go on; empty: from the start.
    pub page_token: String,
}

/// A frame of the tree that has the robot's base as its root.
#[derive(Debug, Clone, PartialEq)]
enum Frame {
    Map,
    Odom,
    Base,
    Sensor(Pose),
}

/// What moves base, at a time.
struct Place {
    t_map_base: Pose,
    t_odom_base: Option<Pose>,
    moving: Moving,
}

fn no_map() -> Error {
    let words = "there is no map yet that the robot could be in; send frames, or import a map, first";
    Error::new(ErrorCode::FailedPrecondition, reason::MAP_EMPTY, words)
}

impl Service {
    /// Where the robot was at a time, and the version of the map that this refers to.
    ///
    /// # Errors
    /// `TRAJECTORY_EMPTY`, `STAMP_BEFORE_TRAJECTORY`, `STAMP_AFTER_TRAJECTORY`, `SCALE_CHANGES`; `SESSION_NOT_FOUND`.
    pub async fn pose_at(&self, session: &str, at: Timestamp) -> Result<(PoseAt, u64)> {
        let snapshot = self.snapshot(session).await?;
        Ok((pose_at(&snapshot, at)?, snapshot.map_version))
    }

    /// Says where the robot is, base to map; where it is by what it sees there, and whether there was anything to compare that with.
    ///
    /// # Errors
    /// `OUT_OF_RANGE`, `POSE_REFUTED`, `ROBOT_SILENT`, `MAP_EMPTY`, `POSE_NOT_COMPARABLE`, `SESSION_NOT_MAPPING`; `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn set_pose(&self, session: &str, t_map_base: Pose) -> Result<(PoseEstimate, bool)> {
        check_id("session_id", session)?;
        if t_map_base.translation.vector.amax() > FARTHEST_M {
            let message = format!(
                "t_map_base lies {:e} m from the map's origin; at most {FARTHEST_M:e} is a place on earth",
                t_map_base.translation.vector.amax()
            );
            return Err(Error::invalid(reason::OUT_OF_RANGE, "t_map_base", message));
        }
        let tell = |session: Arc<Session>| async move {
            if session.meta().mode == SessionMode::IngestOnly {
                let words = "the session is of mode INGEST_ONLY: it has no map; use one of mode MAPPING";
                return Err(Error::new(ErrorCode::FailedPrecondition, reason::SESSION_NOT_MAPPING, words));
            }
            // Who has no map need not wait for a frame to hear so.
            if session.snapshot().keyframes.is_empty() {
                return Err(no_map());
            }
            session.tell_pose(t_map_base).await
        };
        let told = self.registry.awake(session, tell).await?;
        let refuse = |reason, words: &str| Err(Error::new(ErrorCode::FailedPrecondition, reason, words));
        match told {
            Some((Told::Placed, pose)) => Ok((pose, true)),
            Some((Told::Believed, pose)) => Ok((pose, false)),
            Some((Told::Refuted, _)) => refuse(
                reason::POSE_REFUTED,
                "what the robot sees does not fit the map within a metre and half a radian of t_map_base; nothing was changed: point \
                 it out more precisely, or let it be looked for",
            ),
            Some((Told::NoMap, _)) => Err(no_map()),
            Some((Told::CannotTell, _)) => refuse(
                reason::POSE_NOT_COMPARABLE,
                "a camera alone cannot be compared with the map where it is said to be; let it be looked for",
            ),
            None => refuse(
                reason::ROBOT_SILENT,
                "no frame of the sensor that moves the pose came within five seconds; nothing was changed: send frames, and say it \
                 again",
            ),
        }
    }

    /// Where `source` is, seen from `target`, now or at a time.
    ///
    /// # Errors
    /// `FRAME_NOT_FOUND`, `ODOM_NOT_KNOWN`, and as [`pose_at`](Self::pose_at).
    pub async fn lookup_transform(
        &self,
        session: &str,
        target: &str,
        source: &str,
        at: Option<Timestamp>,
    ) -> Result<Transform> {
        check_id("session_id", session)?;
        let session: Arc<Session> = self.session(session).await?;
        let (sensors, snapshot) = (session.meta().sensors, session.snapshot());
        transform(&snapshot, &sensors, target, source, at)
    }

    /// A part of the trajectory, corrected, in order of time: base to map, frame.
    ///
    /// # Errors
    /// `TRAJECTORY_RANGE_INVALID`, `PAGE_TOKEN_INVALID`, `SESSION_NOT_FOUND`.
    pub async fn trajectory(
        &self,
        session: &str,
        request: TrajectoryRequest,
    ) -> Result<(Page<(Pose, TrajectoryEntry)>, u64)> {
        let snapshot = self.snapshot(session).await?;
        let map_version = snapshot.map_version;
        let part = self.compute.query(&self.asker(session)?, move || part_of(&snapshot, &request)).await??;
        Ok((part, map_version))
    }
}

fn failed(reason: &'static str, field: &str, words: String) -> Error {
    let error = Error::new(ErrorCode::FailedPrecondition, reason, words);
    Error { field: field.to_owned(), ..error }
}

fn empty() -> Error {
    let words = "no frame was registered yet, so that nobody knows where the robot is; send some first".to_owned();
    failed(reason::TRAJECTORY_EMPTY, "at_ns", words)
}

/// Where the robot was at a time.
pub(super) fn pose_at(snapshot: &Snapshot, at: Timestamp) -> Result<PoseAt> {
    let asked = at.nanos();
    snapshot.pose_at(at).map_err(|e| match e {
        LookupError::Empty => empty(),
        LookupError::Before { first, last } => {
            let words = format!(
                "at_ns is {asked}, before the trajectory, which goes from {} to {}; ask for a time in it",
                first.nanos(),
                last.nanos()
            );
            Error::invalid(reason::STAMP_BEFORE_TRAJECTORY, "at_ns", words)
        }
        LookupError::After { first, last } => {
            let words = format!(
                "at_ns is {asked}, {:.3} s after the trajectory, which goes from {} to {}; ask again when frames of that \
                 time were sent, or leave at_ns out for the newest pose",
                at.seconds_since(last),
                first.nanos(),
                last.nanos()
            );
            failed(reason::STAMP_AFTER_TRAJECTORY, "at_ns", words)
        }
        LookupError::UnitsDiffer { before, after } => {
            let words = format!(
                "at_ns is {asked}, where the scale changes: of the frames at {} and {} one is in a unit of its own; ask for a \
                 time not between them",
                before.nanos(),
                after.nanos()
            );
            failed(reason::SCALE_CHANGES, "at_ns", words)
        }
    })
}

fn transform(
    snapshot: &Snapshot,
    sensors: &[SensorDeclaration],
    target: &str,
    source: &str,
    at: Option<Timestamp>,
) -> Result<Transform> {
    let to = frame("target_frame", target, sensors)?;
    let from = frame("source_frame", source, sensors)?;
    let map_version = snapshot.map_version;
    let rigid = |frame: &Frame| matches!(frame, Frame::Base | Frame::Sensor(_));
    if to == from || (rigid(&to) && rigid(&from)) {
        let (to, from) = (t_base(&to, None)?, t_base(&from, None)?);
        return Ok(Transform { t_target_source: to.inverse() * from, moving: None, map_version });
    }
    let place = place(snapshot, at)?;
    let (to, from) = (t_base(&to, Some(&place))?, t_base(&from, Some(&place))?);
    Ok(Transform { t_target_source: to.inverse() * from, moving: Some(place.moving), map_version })
}

fn frame(field: &str, name: &str, sensors: &[SensorDeclaration]) -> Result<Frame> {
    let id = name.strip_prefix("sensors/");
    match (name, id) {
        ("map", None) => return Ok(Frame::Map),
        ("odom", None) => return Ok(Frame::Odom),
        ("base", None) => return Ok(Frame::Base),
        _ => {}
    }
    let id = id.unwrap_or(name);
    if let Some(sensor) = sensors.iter().find(|s| s.spec.id.0 == id) {
        return Ok(Frame::Sensor(sensor.spec.t_base_sensor));
    }
    let shown: String = name.chars().take(80).collect();
    let known: Vec<&str> =
        ["map", "odom", "base"].into_iter().chain(sensors.iter().map(|s| s.spec.id.0.as_str())).collect();
    let words = format!("{field} is {shown:?}; the session has the frames {}", known.join(", "));
    Err(Error::not_found(reason::FRAME_NOT_FOUND, field, words))
}

fn place(snapshot: &Snapshot, at: Option<Timestamp>) -> Result<Place> {
    if let Some(at) = at {
        let PoseAt { stamp, t_map_base, t_odom_base, is_tracked, is_metric, .. } = pose_at(snapshot, at)?;
        return Ok(Place { t_map_base, t_odom_base, moving: Moving { stamp, is_tracked, is_metric } });
    }
    let newest = snapshot.pose.as_ref().ok_or_else(empty)?;
    let moving =
        Moving { stamp: newest.stamp, is_tracked: !newest.state.is_lost(), is_metric: newest.scale.is_metric() };
    Ok(Place { t_map_base: newest.t_map_base, t_odom_base: Some(newest.t_odom_base), moving })
}

/// A frame, seen from base.
fn t_base(frame: &Frame, place: Option<&Place>) -> Result<Pose> {
    Ok(match (frame, place) {
        (Frame::Base, _) => Pose::identity(),
        (Frame::Sensor(t_base_sensor), _) => *t_base_sensor,
        (Frame::Map | Frame::Odom, None) => Pose::identity(),
        (Frame::Map, Some(place)) => place.t_map_base.inverse(),
        (Frame::Odom, Some(place)) => place.t_odom_base.map(|t| t.inverse()).ok_or_else(|| {
            let words =
                "at that time lengths were in a unit of their own, and odom's pose was not kept; ask for map, or for \
                         a time since the scale is known"
                    .to_owned();
            failed(reason::ODOM_NOT_KNOWN, "at_ns", words)
        })?,
    })
}

fn part_of(snapshot: &Snapshot, request: &TrajectoryRequest) -> Result<Page<(Pose, TrajectoryEntry)>> {
    let TrajectoryRequest { from, to, max_poses, page_size, .. } = *request;
    let invalid = |field: &str, words: String| Error::invalid(reason::TRAJECTORY_RANGE_INVALID, field, words);
    if let (Some(from), Some(to)) = (from, to)
        && from > to
    {
        let words = format!("from_ns is {}, after to_ns, {}; exchange them", from.nanos(), to.nanos());
        return Err(invalid("from_ns", words));
    }
    if (1..LEAST_POSES).contains(&max_poses) {
        return Err(invalid("max_poses", format!("max_poses is {max_poses}; set it to 0 for all, or to 2 or more")));
    }
    if max_poses > 0 && (page_size > 0 || !request.page_token.is_empty()) {
        let words = "max_poses thins the whole range, page_size cuts it into pages; set one of them".to_owned();
        return Err(invalid("max_poses", words));
    }
    let mut range = snapshot.trajectory_between(from, to);
    if !request.page_token.is_empty() {
        let bad = || {
            Error::invalid(reason::PAGE_TOKEN_INVALID, "page_token", "page_token is not one of ours; start without it")
        };
        let last = Timestamp(request.page_token.parse().map_err(|_| bad())?);
        let after = snapshot.trajectory.partition_point(|e| e.stamp <= last);
        range.start = after.clamp(range.start, range.end);
    }
    let (count, page) = (range.len(), page_size as usize);
    let placed = |e: &TrajectoryEntry| Some((snapshot.t_map_base_of(e)?, *e));
    let items: Vec<(Pose, TrajectoryEntry)> = if max_poses > 0 && count > max_poses as usize {
        let steps = u64::from(max_poses) - 1;
        let chosen = (0..=steps).map(|i| range.start + (i * (count as u64 - 1) / steps) as usize);
        chosen.filter_map(|i| placed(snapshot.trajectory.get(i)?)).collect()
    } else {
        let end = if page > 0 { range.end.min(range.start + page) } else { range.end };
        snapshot.trajectory.range(range.start..end).filter_map(placed).collect()
    };
    let is_cut = page > 0 && count > page;
    let last = items.last().filter(|_| is_cut).map(|(_, entry)| entry.stamp.nanos().to_string());
    Ok(Page { items, next_page_token: last.unwrap_or_default() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::OverloadPolicy;
    use nalgebra::{Isometry3, Vector3};
    use percept_geometry::{KeyframeId, SensorId, SensorKind, SensorSpec};
    use percept_pipeline::{Chunks, KeyframeInfo, Pipeline, PipelineParams};

    fn pose(x: f64, yaw: f64) -> Pose {
        Isometry3::new(Vector3::new(x, 0.0, 0.0), Vector3::z() * yaw)
    }

    /// Ten frames at 1, 2, ... s, a metre apart, on a keyframe that a correction turned by a quarter.
    fn snapshot() -> Snapshot {
        let mut snapshot = Pipeline::new(PipelineParams::default()).unwrap().snapshot();
        let keyframe = KeyframeInfo {
            id: KeyframeId(0),
            stamp: Timestamp(1_000_000_000),
            sensor: SensorId::from("laser"),
            t_map_base: pose(5.0, std::f64::consts::FRAC_PI_2),
            t_odom_base: pose(1.0, 0.0),
            num_points: 1,
            merged: None,
        };
        snapshot.keyframes = [keyframe].into_iter().collect();
        let mut trajectory = Chunks::default();
        for s in 1..=10 {
            let (stamp, t_anchor_base) = (Timestamp(s * 1_000_000_000), pose(s as f64 - 1.0, 0.0));
            let anchor = Some(KeyframeId(0));
            trajectory.push(TrajectoryEntry { stamp, tracked: true, anchor, t_anchor_base, is_keyframe: s == 1 });
        }
        snapshot.trajectory = trajectory;
        snapshot
    }

    fn sensors() -> Vec<SensorDeclaration> {
        let sensor = |id: &str, x: f64| SensorDeclaration {
            spec: SensorSpec {
                id: SensorId::from(id),
                kind: SensorKind::Lidar2d,
                t_base_sensor: pose(x, 0.3),
                intrinsics: None,
                time_offset_s: 0.0,
                range_max_m: None,
            },
            overload: OverloadPolicy::Block,
        };
        vec![sensor("front", 0.2), sensor("odom", -0.2)]
    }

    fn find(target: &str, source: &str, at_s: Option<f64>) -> Result<Transform> {
        let at = at_s.map(|s| Timestamp(0).plus_seconds(s));
        transform(&snapshot(), &sensors(), target, source, at)
    }

    #[test]
    fn transforms_chain_and_invert_as_a_group_does() {
        let names = ["map", "odom", "base", "front", "sensors/odom"];
        let t = |a: &str, b: &str| find(a, b, Some(3.5)).unwrap().t_target_source;
        let same = |a: Pose, b: Pose| (a.to_homogeneous() - b.to_homogeneous()).norm() < 1e-12;
        for a in names {
            assert!(same(t(a, a), Pose::identity()), "{a}");
            for b in names {
                assert!(same(t(a, b), t(b, a).inverse()), "{a} {b}");
                for c in names {
                    assert!(same(t(a, b) * t(b, c), t(a, c)), "{a} {b} {c}");
                }
            }
        }
        // 3.5 s: 2.5 m on the way, which the correction turned to y.
        assert!((t("map", "base").translation.vector - Vector3::new(5.0, 2.5, 0.0)).norm() < 1e-12);
        assert!((t("odom", "base").translation.vector - Vector3::new(3.5, 0.0, 0.0)).norm() < 1e-12);
        assert!((t("base", "front").translation.vector - Vector3::new(0.2, 0.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn what_does_not_move_needs_no_time_and_no_trajectory() {
        let empty = Pipeline::new(PipelineParams::default()).unwrap().snapshot();
        let fixed = transform(&empty, &sensors(), "base", "front", Some(Timestamp(1))).unwrap();
        assert_eq!(fixed.moving, None);
        let moving = transform(&empty, &sensors(), "map", "front", None).unwrap_err();
        assert_eq!(moving.reason, "TRAJECTORY_EMPTY");
    }

    #[test]
    fn unknown_frames_are_told_which_there_are() {
        for (target, source, field) in [("map", "rear", "source_frame"), ("base_link", "map", "target_frame")] {
            let e = find(target, source, None).unwrap_err();
            assert_eq!((e.reason, e.field.as_str()), ("FRAME_NOT_FOUND", field));
            assert!(e.message.contains("map, odom, base, front, odom"), "{e}");
        }
    }

    #[test]
    fn times_outside_are_told_the_range() {
        for (at, reason) in [(0.5, "STAMP_BEFORE_TRAJECTORY"), (10.5, "STAMP_AFTER_TRAJECTORY")] {
            let e = find("map", "base", Some(at)).unwrap_err();
            assert_eq!((e.reason, e.field.as_str()), (reason, "at_ns"));
            assert!(e.message.contains("from 1000000000 to 10000000000"), "{e}");
        }
    }

    fn stamps(request: &TrajectoryRequest) -> (Vec<i64>, String) {
        let page = part_of(&snapshot(), request).unwrap();
        (page.items.iter().map(|(_, e)| e.stamp.nanos() / 1_000_000_000).collect(), page.next_page_token)
    }

    #[test]
    fn pages_join_to_the_range_and_thinning_keeps_both_ends() {
        let (from, to) = (Some(Timestamp(2_000_000_000)), Some(Timestamp(9_000_000_000)));
        let whole = TrajectoryRequest { from, to, ..Default::default() };
        assert_eq!(stamps(&whole), ((2..=9).collect(), String::new()));
        let (mut joined, mut page_token) = (vec![], String::new());
        loop {
            let (part, next) = stamps(&TrajectoryRequest { page_size: 3, page_token, ..whole.clone() });
            assert!(!part.is_empty() && part.len() <= 3);
            joined.extend(part);
            if next.is_empty() {
                break;
            }
            page_token = next;
        }
        assert_eq!(joined, (2..=9).collect::<Vec<_>>());
        assert_eq!(stamps(&TrajectoryRequest { max_poses: 3, ..whole.clone() }).0, [2, 5, 9]);
        assert_eq!(stamps(&TrajectoryRequest { max_poses: 8, ..whole.clone() }).0, (2..=9).collect::<Vec<_>>());
        let reason = |request: &TrajectoryRequest| part_of(&snapshot(), request).unwrap_err().reason;
        assert_eq!(reason(&TrajectoryRequest { from: to, to: from, ..whole.clone() }), "TRAJECTORY_RANGE_INVALID");
        assert_eq!(reason(&TrajectoryRequest { max_poses: 1, ..whole.clone() }), "TRAJECTORY_RANGE_INVALID");
        assert_eq!(
            reason(&TrajectoryRequest { max_poses: 3, page_size: 2, ..whole.clone() }),
            "TRAJECTORY_RANGE_INVALID"
        );
        assert_eq!(reason(&TrajectoryRequest { page_token: "x".to_owned(), ..whole }), "PAGE_TOKEN_INVALID");
    }
}
