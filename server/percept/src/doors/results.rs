//! A session's results as messages of ROS 2, encoded: for robots on ROS 2, and for who looks at them in Foxglove.

use percept_geometry::{Pose, Stamped, Timestamp, se3};
use percept_pipeline::PoseEstimate;
use percept_planning::{PlanOutcome, Waypoint};
use percept_ros::convert::{self, ConvertError, pose_covariance, pose_message, transform_message};
use percept_ros::messages::{
    BoundingBox3D, ColorRGBA, Detection3D, Detection3DArray, Header, Marker, MarkerArray, ObjectHypothesis,
    ObjectHypothesisWithPose, PoseWithCovariance, PoseWithCovarianceStamped, TFMessage, TransformStamped, Vector3,
};
use percept_ros::{EncodeError, Message};
use percept_scene::Object;
use percept_service::{Caller, CloudDetail, EventKind, EventLog, ObjectQuery, PathOptions, PlanRequest};
use percept_wire::convert::navigation::planned_to;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// Points of a cloud at most: 16 MB.
const MAX_POINTS: u64 = 1_000_000;
/// Things and keyframes asked for at a time, and pages of them at most.
const PAGE: u32 = 1000;
const MAX_PAGES: usize = 20;
/// Events read at a time.
const EVENTS_PER_READ: usize = 64;
/// A session that is not there, or sleeps, is asked for again after this.
const PAUSE: Duration = Duration::from_secs(1);

/// Why there is no message.
#[derive(Debug, thiserror::Error)]
pub(super) enum NoMessage {
    /// The session does not give it.
    #[error("{0}")]
    Refused(#[from] percept_service::Error),
    /// It cannot be said in a message.
    #[error(transparent)]
    Convert(#[from] ConvertError),
    #[error(transparent)]
    Encode(#[from] EncodeError),
}

impl NoMessage {
    /// A word for it, the same for all that are alike.
    pub(super) fn reason(&self) -> &str {
        match self {
            Self::Refused(error) => error.reason,
            Self::Convert(_) | Self::Encode(_) => percept_service::reason::INTERNAL,
        }
    }
}

type Encoded = Result<Vec<u8>, NoMessage>;

/// A path to a goal.
pub(super) struct Planned {
    /// `nav_msgs/msg/Path`, without poses if there is no way.
    pub(super) path: Vec<u8>,
    /// Why there is none.
    pub(super) why_none: Option<String>,
}

/// Makes messages of a session's results, asking in somebody's name.
#[derive(Clone, Copy)]
pub(super) struct Results<'a> {
    pub(super) caller: &'a Caller,
    pub(super) session: &'a str,
    /// What the map's frame is called.
    pub(super) map_frame: &'a str,
}

impl Results<'_> {
    /// `geometry_msgs/msg/PoseWithCovarianceStamped`.
    pub(super) fn pose(&self, pose: &PoseEstimate) -> Encoded {
        let covariance = pose_covariance(&pose.t_map_base, &pose.covariance);
        let with = PoseWithCovariance { pose: pose_message(&pose.t_map_base), covariance };
        let header = Header::new(pose.stamp, self.map_frame);
        Ok(PoseWithCovarianceStamped { header, pose: with }.encode()?)
    }

    /// `tf2_msgs/msg/TFMessage` of where `child` is in the map.
    pub(super) fn transform(&self, stamp: Timestamp, child: &str, t_map_child: &Pose) -> Encoded {
        transforms(stamp, self.map_frame, [(child, *t_map_child)])
    }

    /// `nav_msgs/msg/OccupancyGrid`: free, occupied or unknown as percept's own planner takes the cells.
    pub(super) async fn map(&self) -> Encoded {
        let snapshot = self.caller.snapshot("MapsService/GetOccupancyGrid", self.session).await?;
        let grid = self.caller.occupancy_grid(self.session, None, None, false).await?;
        let occupied = snapshot.params.planning.occupied_probability;
        let (g, header) = (grid.grid, Header::new(grid.stamp, self.map_frame));
        let cells: Vec<i8> = g.cells.iter().map(|&c| trinary(c, occupied)).collect();
        Ok(convert::grid_message(&g.geometry, g.width, &cells, header)?.encode()?)
    }

    /// `sensor_msgs/msg/PointCloud2`.
    pub(super) async fn cloud(&self) -> Encoded {
        let detail = CloudDetail { max_points: Some(MAX_POINTS), ..CloudDetail::default() };
        let answer = self.caller.cloud(self.session, None, detail).await?;
        let header = Header::new(answer.stamp, self.map_frame);
        Ok(convert::cloud_message(&answer.cloud, header)?.encode()?)
    }

    /// `nav_msgs/msg/Path` of the keyframes; none while there are none.
    pub(super) async fn path(&self) -> Result<Option<Vec<u8>>, NoMessage> {
        let (mut poses, mut token) = (Vec::new(), String::new());
        for _ in 0..MAX_PAGES {
            let page = self.caller.list_keyframes(self.session, PAGE, &token).await?;
            poses.extend(page.items.iter().map(|k| Stamped { stamp: k.stamp, value: k.t_map_base }));
            token = page.next_page_token;
            if token.is_empty() {
                break;
            }
        }
        let Some(stamp) = poses.last().map(|p| p.stamp) else { return Ok(None) };
        Ok(Some(convert::path_message(&poses, Header::new(stamp, self.map_frame)).encode()?))
    }

    /// Things, as `visualization_msgs/msg/MarkerArray` and as `vision_msgs/msg/Detection3DArray`.
    pub(super) async fn things(&self, stamp: Timestamp) -> Result<(Vec<u8>, Vec<u8>), NoMessage> {
        let (page, _) = self.caller.list_objects(self.session, ObjectQuery::default(), PAGE, "").await?;
        let header = Header::new(stamp, self.map_frame);
        let names: Vec<(String, String)> =
            page.items.iter().map(|o| (o.id.0.to_string(), format!("{} {}", o.class.name(), o.id.0))).collect();
        let mut markers = vec![Marker { header, action: DELETE_ALL, ..Marker::default() }];
        let mut detections = Vec::new();
        for (object, (id, label)) in page.items.iter().zip(&names) {
            markers.extend(shapes(object, label, header));
            detections.push(detection(object, id, header));
        }
        Ok((MarkerArray { markers }.encode()?, Detection3DArray { header, detections }.encode()?))
    }

    /// The way from where the robot is to a goal.
    pub(super) async fn plan(&self, t_map_goal: &Pose) -> Result<Planned, NoMessage> {
        let at = t_map_goal.translation;
        let options = PathOptions { goal_yaw_rad: None, ..PathOptions::default() };
        let request = PlanRequest { start: None, goal: nalgebra::Point2::new(at.x, at.y), params: None, options };
        let plan = self.caller.plan_path(self.session, request).await?;
        let (mut poses, why_none) = (Vec::new(), planned_to(&plan).err().map(|none| none.detail));
        if let (None, Some(PlanOutcome::Path(path))) = (&why_none, &plan.outcome) {
            let pose = |w: &Waypoint| se3::from_xy_yaw(w.position.x, w.position.y, w.yaw_rad);
            poses.extend(path.waypoints.iter().map(|w| Stamped { stamp: plan.stamp, value: pose(w) }));
            // The heading that was asked for is the robot's own matter once it is there.
            if let Some(last) = poses.last_mut() {
                last.value.rotation = t_map_goal.rotation;
            }
        }
        let header = Header::new(plan.stamp, self.map_frame);
        Ok(Planned { path: convert::path_message(&poses, header).encode()?, why_none })
    }
}

/// `tf2_msgs/msg/TFMessage` of where frames are in another.
pub(super) fn transforms<'a>(
    stamp: Timestamp,
    parent: &str,
    children: impl IntoIterator<Item = (&'a str, Pose)>,
) -> Encoded {
    let header = Header::new(stamp, parent);
    let transform = |(child_frame_id, t_parent_child)| TransformStamped {
        header,
        child_frame_id,
        transform: transform_message(&t_parent_child),
    };
    Ok(TFMessage { transforms: children.into_iter().map(transform).collect() }.encode()?)
}

/// Events of a session, begun again when they end: a session that sleeps, or is made anew.
#[derive(Default)]
pub(super) struct Events {
    log: Option<(Arc<EventLog>, u64)>,
    read: VecDeque<EventKind>,
}

impl Events {
    /// The next; waits for the session, too. Nothing is lost when it is dropped while it waits.
    pub(super) async fn next(&mut self, caller: &Caller, session: &str) -> EventKind {
        loop {
            if let Some(kind) = self.read.pop_front() {
                return kind;
            }
            let Some((log, token)) = &mut self.log else {
                match caller.session_events("SessionsService/WatchSession", session).await {
                    Ok(log) => {
                        let token = log.newest_token();
                        self.log = Some((log, token));
                    }
                    Err(_) => tokio::time::sleep(PAUSE).await,
                }
                continue;
            };
            match log.after(*token, EVENTS_PER_READ).await {
                Some(events) => {
                    *token = events.last().map_or(*token, |e| e.token);
                    self.read.extend(events.into_iter().map(|e| e.kind));
                }
                None => {
                    self.log = None;
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
    }
}

/// Unknown, free or occupied as percept's own planner takes a cell of 0 to 100, since nav2's costmap takes all below 100 for
/// free.
fn trinary(cell: i8, occupied_probability: f64) -> i8 {
    match cell {
        ..0 => -1,
        _ if f64::from(cell) >= 100.0 * occupied_probability => 100,
        _ => 0,
    }
}

/// `visualization_msgs/msg/Marker`: DELETEALL, CUBE, TEXT_VIEW_FACING.
const DELETE_ALL: i32 = 3;
const CUBE: i32 = 1;
const TEXT: i32 = 9;

/// A thing as a box and its name above.
fn shapes<'m>(object: &Object, label: &'m str, header: Header<'m>) -> [Marker<'m>; 2] {
    let size = object.bbox.size;
    let id = (object.id.0 & 0x7fff_ffff) as i32;
    let color = ColorRGBA { r: 0.2, g: 0.6, b: 0.9, a: 0.4 };
    let scale = Vector3 { x: size.x, y: size.y, z: size.z };
    let pose = pose_message(&object.bbox.t_frame_box);
    let cube = Marker { header, ns: "objects", id, r#type: CUBE, pose, scale, color, ..Marker::default() };
    let mut above = pose;
    above.position.z += size.z / 2.0 + 0.15;
    let white = ColorRGBA { r: 1.0, g: 1.0, b: 1.0, a: 1.0 };
    let letters = Vector3 { x: 0.0, y: 0.0, z: 0.2 };
    let text = Marker {
        header,
        ns: "names",
        id,
        r#type: TEXT,
        pose: above,
        scale: letters,
        color: white,
        text: label,
        ..Marker::default()
    };
    [cube, text]
}

fn detection<'m>(object: &'m Object, id: &'m str, header: Header<'m>) -> Detection3D<'m> {
    let (center, size) = (pose_message(&object.bbox.t_frame_box), object.bbox.size);
    let hypothesis = ObjectHypothesis { class_id: object.class.name(), score: object.confidence };
    let pose = PoseWithCovariance { pose: center, covariance: [0.0; 36] };
    Detection3D {
        header,
        results: vec![ObjectHypothesisWithPose { hypothesis, pose }],
        bbox: BoundingBox3D { center, size: Vector3 { x: size.x, y: size.y, z: size.z } },
        id,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_costmap_takes_for_free_is_free() {
        let cells = [-1, 0, 40, 59, 60, 100].map(|c| trinary(c, 0.6));
        assert_eq!(cells, [-1, 0, 0, 0, 100, 100]);
    }
}
