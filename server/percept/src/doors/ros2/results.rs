//! What a robot gets back, on topics that RViz and nav2 use as they are.
//!
//! `tf` map to odom (or map to base where there is no odometry), `map` (latched), and under `percept/`: `pose`, `path`, `cloud`,
//! `objects` (markers), `detections`, `plan` (to the last `goal_pose`). What somebody else publishes already is left to them.

use super::super::zenoh::Failure;
use super::book::Root;
use super::checks::lock;
use super::link::{Entities, Found, Manner, Node, Topic};
use super::motion::Motion;
use super::settings::Robot;
use percept_geometry::{Pose, Stamped, Timestamp, se3};
use percept_pipeline::PoseEstimate;
use percept_ros::Message;
use percept_ros::convert::{self, pose_covariance, pose_message, transform_message};
use percept_ros::messages::{
    BoundingBox3D, ColorRGBA, Detection3D, Detection3DArray, Header, Marker, MarkerArray, ObjectHypothesis,
    ObjectHypothesisWithPose, OccupancyGrid, Path, PointCloud2, PoseWithCovariance, PoseWithCovarianceStamped,
    TFMessage, TransformStamped, Vector3,
};
use percept_scene::Object;
use percept_service::{Caller, CloudDetail, EventKind, EventLog, ObjectQuery, PathOptions, PlanRequest};
use percept_wire::convert::navigation::planned_to;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::mpsc;

/// How often the transform is published, as slam_toolbox does (`transform_publish_period`, 0.02 s) or a little less.
const TRANSFORM_PERIOD: Duration = Duration::from_millis(40);
/// Maps, paths and things are published no more often.
const MAP_PERIOD: Duration = Duration::from_secs(1);
/// Clouds are large: every so many of those periods.
const CLOUD_EVERY: u32 = 5;
/// Points of a published cloud at most: 16 MB.
const MAX_POINTS: u64 = 1_000_000;
/// Somebody who published the transform from map to odom so recently does so still.
const LEFT_TO_OTHERS: Duration = Duration::from_secs(5);
/// Things and keyframes asked for at a time, and pages of them at most.
const PAGE: u32 = 1000;
const MAX_PAGES: usize = 20;
/// Events read at a time.
const EVENTS_PER_READ: usize = 64;

/// Where a robot is to go.
pub(super) struct Goal {
    pub(super) t_map_goal: Pose,
}

/// What the listener knows and the results need.
#[derive(Default)]
pub(super) struct Shared(Mutex<Known>);

#[derive(Default)]
pub(super) struct Known {
    pub(super) motion: Motion,
    /// The topic that the motion came by.
    tf_topic: Option<String>,
    /// The robot's own frame.
    pub(super) base: Option<String>,
    /// What that hangs on.
    pub(super) root: Option<Root>,
    /// Whether the robot is on ROS 2 Humble, whose types have no hashes.
    is_unhashed: bool,
    /// Whether somebody else publishes the map.
    is_map_taken: bool,
    /// When somebody else last published where odom is in the map.
    pub(super) tf_taken: Option<Instant>,
}

impl Shared {
    pub(super) fn lock(&self) -> MutexGuard<'_, Known> {
        lock(&self.0)
    }

    /// Notes what a publisher tells of its network.
    pub(super) fn note(&self, found: &Found, robot: &Robot) {
        let mut known = self.lock();
        known.is_unhashed |= found.is_unhashed;
        known.is_map_taken |= found.topic == robot.topic("map") && found.type_name == OccupancyGrid::TYPE_NAME;
    }

    /// Notes where the robot is in its odometry's frame.
    pub(super) fn moved(&self, topic: &str, stamp: Timestamp, t_odom_base: Pose) {
        let mut known = self.lock();
        known.motion.push(stamp, t_odom_base);
        if !topic.ends_with("_static") {
            known.tf_topic.get_or_insert_with(|| topic.to_owned());
        }
    }
}

/// Publishes a session's results from its first pose on.
pub(super) struct Results<'a> {
    node: Node<'a>,
    robot: &'a Robot,
    caller: &'a Caller,
    shared: &'a Shared,
    t_map_odom: Option<Pose>,
    published: Option<Timestamp>,
    newest: Option<PoseEstimate>,
    /// What has to be published anew.
    is_map_old: bool,
    are_things_old: bool,
    is_cloud_old: bool,
    periods: u32,
}

/// The topics.
struct Topics<'a> {
    tf: Topic<'a>,
    pose: Topic<'a>,
    map: Option<Topic<'a>>,
    path: Topic<'a>,
    cloud: Topic<'a>,
    objects: Topic<'a>,
    detections: Topic<'a>,
    plan: Topic<'a>,
}

/// Waits for a session's first pose, then publishes until an error.
pub(super) async fn serve(
    zenoh: &zenoh::Session,
    entities: &Entities,
    robot: &Robot,
    caller: &Caller,
    shared: &Shared,
    mut goals: mpsc::Receiver<Goal>,
) -> Result<(), Failure> {
    let mut events = Events::default();
    let first = events.next_pose(caller, robot).await;
    let is_unhashed = shared.lock().is_unhashed;
    let node = Node::declare(zenoh, entities, robot, is_unhashed).await?;
    let mut this = Results {
        node,
        robot,
        caller,
        shared,
        t_map_odom: None,
        published: None,
        newest: None,
        is_map_old: true,
        are_things_old: true,
        is_cloud_old: true,
        periods: 0,
    };
    let topics = this.topics().await?;
    this.pose(&topics, first).await?;
    let (mut transform, mut map) = (tokio::time::interval(TRANSFORM_PERIOD), tokio::time::interval(MAP_PERIOD));
    for interval in [&mut transform, &mut map] {
        interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    }
    loop {
        tokio::select! {
            happened = events.next(caller, robot) => this.happened(&topics, happened).await?,
            _ = transform.tick() => this.transform(&topics).await?,
            _ = map.tick() => this.maps(&topics).await?,
            Some(goal) = goals.recv() => this.plan(&topics, goal).await?,
        }
    }
}

impl<'a> Results<'a> {
    async fn topics(&self) -> Result<Topics<'a>, Failure> {
        let (node, robot) = (&self.node, self.robot);
        let own = |name: &str| robot.topic(&format!("percept/{name}"));
        let (tf_topic, is_map_taken) = {
            let known = self.shared.lock();
            (known.tf_topic.clone().unwrap_or_else(|| robot.topic("tf")), known.is_map_taken)
        };
        let map = robot.topic("map");
        if is_map_taken {
            tracing::warn!(session = robot.session, topic = map, "somebody else publishes the map: it is left to them");
        }
        Ok(Topics {
            tf: node.publisher::<TFMessage<'_>>(&tf_topic, Manner::Now).await?,
            pose: node.publisher::<PoseWithCovarianceStamped<'_>>(&own("pose"), Manner::Now).await?,
            map: match is_map_taken {
                true => None,
                false => Some(node.publisher::<OccupancyGrid<'_>>(&map, Manner::Latched).await?),
            },
            path: node.publisher::<Path<'_>>(&own("path"), Manner::Latched).await?,
            cloud: node.publisher::<PointCloud2<'_>>(&own("cloud"), Manner::Latched).await?,
            objects: node.publisher::<MarkerArray<'_>>(&own("objects"), Manner::Latched).await?,
            detections: node.publisher::<Detection3DArray<'_>>(&own("detections"), Manner::Latched).await?,
            plan: node.publisher::<Path<'_>>(&own("plan"), Manner::Latched).await?,
        })
    }

    async fn happened(&mut self, topics: &Topics<'_>, kind: EventKind) -> Result<(), Failure> {
        match kind {
            EventKind::Pose(pose) => self.pose(topics, *pose).await?,
            EventKind::Object(_) => self.are_things_old = true,
            EventKind::Keyframe(_) | EventKind::MapVersion(_) => {
                self.is_map_old = true;
                self.is_cloud_old = true;
            }
            EventKind::Loop(_) | EventKind::Resync(_) => {}
        }
        Ok(())
    }

    async fn pose(&mut self, topics: &Topics<'_>, pose: PoseEstimate) -> Result<(), Failure> {
        let is_sure = !pose.state.is_lost() && pose.scale.is_metric();
        if is_sure {
            let t_odom_base = self.shared.lock().motion.at(pose.stamp);
            self.t_map_odom =
                t_odom_base.map(|t_odom_base| pose.t_map_base * t_odom_base.inverse()).or(self.t_map_odom);
            let header = Header::new(pose.stamp, &self.robot.map_frame);
            let covariance = pose_covariance(&pose.t_map_base, &pose.covariance);
            let with = PoseWithCovariance { pose: pose_message(&pose.t_map_base), covariance };
            topics.pose.send(&PoseWithCovarianceStamped { header, pose: with }, now_ns()).await?;
            // A frame has one parent: what hangs on another is placed by that.
            if t_odom_base.is_none() && self.t_map_odom.is_none() {
                let (base, root) = {
                    let known = self.shared.lock();
                    (known.base.clone().unwrap_or_else(|| "base_link".to_owned()), known.root.clone())
                };
                match root {
                    None => self.send_transform(topics, pose.stamp, &base, &pose.t_map_base).await?,
                    Some(Root { frame, t_root_base: Some(t_root_base) }) => {
                        let t_map_root = pose.t_map_base * t_root_base.inverse();
                        self.send_transform(topics, pose.stamp, &frame, &t_map_root).await?;
                    }
                    // Its motion has not been heard yet.
                    Some(_) => {}
                }
            }
        }
        self.newest = Some(pose);
        Ok(())
    }

    async fn transform(&mut self, topics: &Topics<'_>) -> Result<(), Failure> {
        let newest = self.shared.lock().motion.newest();
        let Some((t_map_odom, stamp)) = self.t_map_odom.zip(newest).filter(|(_, stamp)| self.published != Some(*stamp))
        else {
            return Ok(());
        };
        self.published = Some(stamp);
        let root = self.shared.lock().root.clone();
        let odom = root.map_or_else(|| self.robot.odom_frame.clone(), |root| root.frame);
        self.send_transform(topics, stamp, &odom, &t_map_odom).await
    }

    async fn send_transform(
        &self,
        topics: &Topics<'_>,
        stamp: Timestamp,
        child: &str,
        t_map_child: &Pose,
    ) -> Result<(), Failure> {
        if self.shared.lock().tf_taken.is_some_and(|at| at.elapsed() < LEFT_TO_OTHERS) {
            if self.caller.faults().admit(&format!("ros2 tf of {}", self.robot.session)).is_some() {
                tracing::warn!(
                    session = self.robot.session,
                    "somebody else publishes the transform from {} to {child}: it is left to them",
                    self.robot.map_frame,
                );
            }
            return Ok(());
        }
        let transform = TransformStamped {
            header: Header::new(stamp, &self.robot.map_frame),
            child_frame_id: child,
            transform: transform_message(t_map_child),
        };
        topics.tf.send(&TFMessage { transforms: vec![transform] }, now_ns()).await
    }

    /// Publishes what has changed and somebody may hear.
    async fn maps(&mut self, topics: &Topics<'_>) -> Result<(), Failure> {
        let session = self.robot.session.as_str();
        self.periods = self.periods.wrapping_add(1);
        if self.is_map_old {
            self.is_map_old = false;
            let snapshot = self.caller.snapshot("MapsService/GetOccupancyGrid", session).await;
            if let Some(map) = &topics.map
                && let Some(snapshot) = self.told("map", snapshot)
                && let Some(grid) = self.told("map", self.caller.occupancy_grid(session, None, None, false).await)
            {
                let occupied = snapshot.params.planning.occupied_probability;
                let (g, header) = (grid.grid, Header::new(grid.stamp, &self.robot.map_frame));
                let cells: Vec<i8> = g.cells.iter().map(|&c| trinary(c, occupied)).collect();
                map.send(&convert::grid_message(&g.geometry, g.width, &cells, header)?, now_ns()).await?;
            }
            if topics.path.is_heard().await {
                self.path(topics).await?;
            }
        }
        if self.is_cloud_old && self.periods.is_multiple_of(CLOUD_EVERY) && topics.cloud.is_heard().await {
            self.is_cloud_old = false;
            let detail = CloudDetail { max_points: Some(MAX_POINTS), ..CloudDetail::default() };
            if let Some(answer) = self.told("cloud", self.caller.cloud(session, None, detail).await) {
                let header = Header::new(answer.stamp, &self.robot.map_frame);
                topics.cloud.send(&convert::cloud_message(&answer.cloud, header)?, now_ns()).await?;
            }
        }
        if self.are_things_old && (topics.objects.is_heard().await || topics.detections.is_heard().await) {
            self.are_things_old = false;
            self.things(topics).await?;
        }
        Ok(())
    }

    async fn path(&self, topics: &Topics<'_>) -> Result<(), Failure> {
        let (mut poses, mut token) = (Vec::new(), String::new());
        for _ in 0..MAX_PAGES {
            let page = self.caller.list_keyframes(&self.robot.session, PAGE, &token).await;
            let Some(page) = self.told("path", page) else { return Ok(()) };
            poses.extend(page.items.iter().map(|k| Stamped { stamp: k.stamp, value: k.t_map_base }));
            token = page.next_page_token;
            if token.is_empty() {
                break;
            }
        }
        let Some(stamp) = poses.last().map(|p| p.stamp) else { return Ok(()) };
        let header = Header::new(stamp, &self.robot.map_frame);
        topics.path.send(&convert::path_message(&poses, header), now_ns()).await
    }

    async fn things(&self, topics: &Topics<'_>) -> Result<(), Failure> {
        let Some(stamp) = self.newest.as_ref().map(|p| p.stamp) else { return Ok(()) };
        let page = self.caller.list_objects(&self.robot.session, ObjectQuery::default(), PAGE, "").await;
        let Some((page, _)) = self.told("objects", page) else { return Ok(()) };
        let header = Header::new(stamp, &self.robot.map_frame);
        let names: Vec<(String, String)> =
            page.items.iter().map(|o| (o.id.0.to_string(), format!("{} {}", o.class.name(), o.id.0))).collect();
        let mut markers = vec![Marker { header, action: DELETE_ALL, ..Marker::default() }];
        let mut detections = Vec::new();
        for (object, (id, label)) in page.items.iter().zip(&names) {
            markers.extend(shapes(object, label, header));
            detections.push(detection(object, id, header));
        }
        topics.objects.send(&MarkerArray { markers }, now_ns()).await?;
        topics.detections.send(&Detection3DArray { header, detections }, now_ns()).await
    }

    async fn plan(&self, topics: &Topics<'_>, goal: Goal) -> Result<(), Failure> {
        let at = goal.t_map_goal.translation;
        let options = PathOptions { goal_yaw_rad: None, ..PathOptions::default() };
        let request = PlanRequest { start: None, goal: nalgebra::Point2::new(at.x, at.y), params: None, options };
        let Some(plan) = self.told("plan", self.caller.plan_path(&self.robot.session, request).await) else {
            return Ok(());
        };
        let mut poses = Vec::new();
        match planned_to(&plan) {
            Ok(_) => {
                if let Some(percept_planning::PlanOutcome::Path(path)) = &plan.outcome {
                    let pose = |w: &percept_planning::Waypoint| se3::from_xy_yaw(w.position.x, w.position.y, w.yaw_rad);
                    poses.extend(path.waypoints.iter().map(|w| Stamped { stamp: plan.stamp, value: pose(w) }));
                    // The heading that was asked for is the robot's own matter once it is there.
                    if let Some(last) = poses.last_mut() {
                        last.value.rotation = goal.t_map_goal.rotation;
                    }
                }
            }
            Err(none) => tracing::warn!(session = self.robot.session, why = none.detail, "no path to goal_pose"),
        }
        // Empty: there is none.
        let header = Header::new(plan.stamp, &self.robot.map_frame);
        topics.plan.send(&convert::path_message(&poses, header), now_ns()).await
    }

    /// What was asked for; what cannot be given is told in the log, once in a while.
    fn told<T>(&self, what: &str, answer: Result<T, percept_service::Error>) -> Option<T> {
        let session = self.robot.session.as_str();
        answer
            .inspect_err(|error| {
                if self.caller.faults().admit(&format!("ros2 {what} of {session} {}", error.reason)).is_some() {
                    tracing::warn!(session, what, reason = error.reason, %error, "not published to ROS 2");
                }
            })
            .ok()
    }
}

/// Events of a session, begun again when they end: a session that sleeps, or is made anew.
#[derive(Default)]
struct Events {
    log: Option<(Arc<EventLog>, u64)>,
    read: std::collections::VecDeque<EventKind>,
}

impl Events {
    /// The next; waits for the session, too. Nothing is lost when it is dropped while it waits.
    async fn next(&mut self, caller: &Caller, robot: &Robot) -> EventKind {
        loop {
            if let Some(kind) = self.read.pop_front() {
                return kind;
            }
            let Some((log, token)) = &mut self.log else {
                match caller.session_events("SessionsService/WatchSession", &robot.session).await {
                    Ok(log) => {
                        let token = log.newest_token();
                        self.log = Some((log, token));
                    }
                    Err(_) => tokio::time::sleep(MAP_PERIOD).await,
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
                    tokio::time::sleep(MAP_PERIOD).await;
                }
            }
        }
    }

    async fn next_pose(&mut self, caller: &Caller, robot: &Robot) -> PoseEstimate {
        loop {
            if let EventKind::Pose(pose) = self.next(caller, robot).await {
                return *pose;
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

/// ns since the Unix epoch, by this machine's clock.
fn now_ns() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
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
