//! What a robot gets back, on topics that RViz and nav2 use as they are.
//!
//! `tf` map to odom (or map to base where there is no odometry), `map` (latched), and under `percept/`: `pose`, `path`, `cloud`,
//! `objects` (markers), `detections`, `plan` (to the last `goal_pose`). What somebody else publishes already is left to them.

use super::super::results::{Events, NoMessage, Results};
use super::super::zenoh::Failure;
use super::book::Root;
use super::checks::lock;
use super::link::{Entities, Found, Manner, Node, Topic};
use super::motion::Motion;
use super::settings::Robot;
use percept_geometry::{Pose, Timestamp};
use percept_pipeline::PoseEstimate;
use percept_ros::Message;
use percept_ros::messages::{
    Detection3DArray, MarkerArray, OccupancyGrid, Path, PointCloud2, PoseWithCovarianceStamped, TFMessage,
};
use percept_service::{Caller, EventKind};
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::mpsc;

/// How often the transform is published, as slam_toolbox does (`transform_publish_period`, 0.02 s) or a little less.
const TRANSFORM_PERIOD: Duration = Duration::from_millis(40);
/// Maps, paths and things are published no more often.
const MAP_PERIOD: Duration = Duration::from_secs(1);
/// Clouds are large: every so many of those periods.
const CLOUD_EVERY: u32 = 5;
/// Somebody who published the transform from map to odom so recently does so still.
const LEFT_TO_OTHERS: Duration = Duration::from_secs(5);
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
struct Publishing<'a> {
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
    let first = first_pose(&mut events, caller, robot).await;
    let is_unhashed = shared.lock().is_unhashed;
    let node = Node::declare(zenoh, entities, robot, is_unhashed).await?;
    let mut this = Publishing {
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
            happened = events.next(caller, &robot.session) => this.happened(&topics, happened).await?,
            _ = transform.tick() => this.transform(&topics).await?,
            _ = map.tick() => this.maps(&topics).await?,
            Some(goal) = goals.recv() => this.plan(&topics, goal).await?,
        }
    }
}

impl<'a> Publishing<'a> {
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
            topics.pose.send(self.results().pose(&pose)?, now_ns()).await?;
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
        topics.tf.send(self.results().transform(stamp, child, t_map_child)?, now_ns()).await
    }

    /// Publishes what has changed and somebody may hear.
    async fn maps(&mut self, topics: &Topics<'_>) -> Result<(), Failure> {
        self.periods = self.periods.wrapping_add(1);
        if self.is_map_old {
            self.is_map_old = false;
            if let Some(map) = &topics.map
                && let Some(message) = self.told("map", self.results().map().await)
            {
                map.send(message, now_ns()).await?;
            }
            if topics.path.is_heard().await
                && let Some(Some(message)) = self.told("path", self.results().path().await)
            {
                topics.path.send(message, now_ns()).await?;
            }
        }
        if self.is_cloud_old && self.periods.is_multiple_of(CLOUD_EVERY) && topics.cloud.is_heard().await {
            self.is_cloud_old = false;
            if let Some(message) = self.told("cloud", self.results().cloud().await) {
                topics.cloud.send(message, now_ns()).await?;
            }
        }
        let are_things_heard =
            self.are_things_old && (topics.objects.is_heard().await || topics.detections.is_heard().await);
        if are_things_heard && let Some(stamp) = self.newest.as_ref().map(|p| p.stamp) {
            self.are_things_old = false;
            if let Some((markers, detections)) = self.told("objects", self.results().things(stamp).await) {
                topics.objects.send(markers, now_ns()).await?;
                topics.detections.send(detections, now_ns()).await?;
            }
        }
        Ok(())
    }

    async fn plan(&self, topics: &Topics<'_>, goal: Goal) -> Result<(), Failure> {
        let Some(planned) = self.told("plan", self.results().plan(&goal.t_map_goal).await) else { return Ok(()) };
        if let Some(why) = planned.why_none {
            tracing::warn!(session = self.robot.session, why, "no path to goal_pose");
        }
        topics.plan.send(planned.path, now_ns()).await
    }

    fn results(&self) -> Results<'_> {
        Results { caller: self.caller, session: &self.robot.session, map_frame: &self.robot.map_frame }
    }

    /// What was asked for; what cannot be given is told in the log, once in a while.
    fn told<T>(&self, what: &str, answer: Result<T, NoMessage>) -> Option<T> {
        let session = self.robot.session.as_str();
        answer
            .inspect_err(|error| {
                if self.caller.faults().admit(&format!("ros2 {what} of {session} {}", error.reason())).is_some() {
                    tracing::warn!(session, what, reason = error.reason(), %error, "not published to ROS 2");
                }
            })
            .ok()
    }
}

/// Waits for a session's next pose.
async fn first_pose(events: &mut Events, caller: &Caller, robot: &Robot) -> PoseEstimate {
    loop {
        if let EventKind::Pose(pose) = events.next(caller, &robot.session).await {
            return *pose;
        }
    }
}

/// ns since the Unix epoch, by this machine's clock.
fn now_ns() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
}
