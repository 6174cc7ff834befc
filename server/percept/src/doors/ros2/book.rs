//! Which of a robot's topics become sensors: decided once what they say is known.
//!
//! A topic is heard first: its messages tell frame, and of images kind and size. Then it waits for what goes with it (a
//! transform, a calibration, the colour beside depth), and is taken or left, with the reason.

use super::settings::Robot;
use percept_geometry::{Pose, SensorId, SensorKind, SensorSpec};
use percept_ros::FrameTree;
use percept_ros::topics::{self, Content, Topic};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Others that say the same, and what goes with a topic, have this time to be heard.
const SETTLE: Duration = Duration::from_secs(1);
/// What has not come by then is not waited for: a transform that nobody sends, an image without calibration.
const PATIENCE: Duration = Duration::from_secs(5);
/// Topics of one robot that are listened to at most; robots have some hundred.
const MAX_TOPICS: usize = 1024;

/// What became of a topic.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Standing {
    /// No message has come, or what goes with it has not.
    Open,
    /// It goes with others: transforms, calibration.
    Beside,
    /// It is a sensor's.
    Taken(SensorId),
    /// Colour of the depth images of that topic.
    ColorOf(String),
    /// It is not used; why.
    Left(String),
    /// It is not used before its calibration has come.
    Uncalibrated,
}

/// A topic, and since when it is heard: time since the robot was found.
#[derive(Debug, Clone)]
pub(super) struct Heard {
    pub(super) topic: Topic,
    pub(super) standing: Standing,
    since: Option<Duration>,
}

/// What was decided.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Decision {
    /// A topic is a sensor's; what had to be supposed.
    Take { topic: String, spec: Box<SensorSpec>, color: Option<String>, supposed: Option<String> },
    /// A topic is left, and need not be listened to; what has to come for it to be looked at again is its calibration.
    Leave { topic: String, why: String, lacks_calibration: bool },
}

/// What a robot hangs on.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Root {
    /// Its frame.
    pub(super) frame: String,
    /// Where the robot is in it, if it stays there.
    pub(super) t_root_base: Option<Pose>,
}

/// The topics of one robot.
#[derive(Debug, Default)]
pub(super) struct Book {
    pub(super) topics: BTreeMap<String, Heard>,
    pub(super) frames: FrameTree,
    /// Frames that are told of as they move.
    moving: BTreeSet<String>,
    /// Whether transforms tell where the robot is in its odometry's frame.
    has_odometry_transform: bool,
}

impl Book {
    /// Notes a topic that is published; whether it is to be listened to.
    pub(super) fn add(&mut self, robot: &Robot, name: &str, type_name: &str) -> bool {
        if self.topics.contains_key(name) || self.topics.len() >= MAX_TOPICS || !robot.has(name) {
            return false;
        }
        let topic = Topic::new(name, type_name);
        let standing = match topic.content {
            Content::Other => return false,
            Content::Transforms | Content::Calibration { .. } => Standing::Beside,
            _ if robot.wants(name) => Standing::Open,
            // The colour of depth images that are named need not be.
            Content::Color { .. } => Standing::Open,
            _ => return false,
        };
        self.topics.insert(name.to_owned(), Heard { topic, standing, since: None });
        true
    }

    /// Notes that a message of a topic has come.
    pub(super) fn heard(&mut self, name: &str, now: Duration) {
        if let Some(heard) = self.topics.get_mut(name) {
            heard.since.get_or_insert(now);
        }
    }

    /// Notes that transforms lead from the robot to its odometry's frame.
    pub(super) fn note_odometry(&mut self) {
        self.has_odometry_transform = true;
    }

    /// All sensors are to be declared again: their session is another.
    pub(super) fn begin_anew(&mut self) {
        for heard in self.topics.values_mut() {
            if matches!(heard.standing, Standing::Taken(_) | Standing::ColorOf(_)) {
                heard.standing = Standing::Open;
            }
        }
    }

    /// The topics that were left for want of a calibration which is there now: they are to be listened to again.
    pub(super) fn calibrated(&mut self) -> Vec<String> {
        let waits = |h: &&Heard| h.standing == Standing::Uncalibrated;
        let is_there = |h: &&Heard| topics::calibration(self.told(), &h.topic).is_some();
        let found = self.topics.values().filter(waits).filter(is_there).map(|h| h.topic.name.clone());
        let found: Vec<String> = found.collect();
        for name in &found {
            if let Some(heard) = self.topics.get_mut(name) {
                (heard.standing, heard.since) = (Standing::Open, None);
            }
        }
        found
    }

    /// Notes that frames move, or may.
    pub(super) fn note_moving<'f>(&mut self, frames: impl Iterator<Item = &'f str>) {
        for frame in frames.map(|f| f.trim_start_matches('/')) {
            if !self.moving.contains(frame) && self.moving.len() < MAX_TOPICS {
                self.moving.insert(frame.to_owned());
            }
        }
    }

    /// What the robot hangs on in the tree of transforms, below the map: the frame that its odometry counts in, whatever that
    /// is called, and whether it stays where the robot is. None: nothing is above the robot.
    pub(super) fn root(&self, robot: &Robot) -> Option<Root> {
        let base = self.base(robot)?;
        let above = self.frames.above(&base);
        let below_map = above.iter().take_while(|frame| **frame != robot.map_frame);
        let root = above.iter().find(|frame| **frame == robot.odom_frame).or(below_map.last())?;
        let mut between = [base.as_str()].into_iter().chain(above.iter().copied().take_while(|frame| frame != root));
        let t_root_base = self.frames.t_a_b(root, &base).filter(|_| !between.any(|frame| self.moving.contains(frame)));
        Some(Root { frame: (*root).to_owned(), t_root_base })
    }

    /// Whether the robot hangs on this frame.
    pub(super) fn hangs_on(&self, robot: &Robot, frame: &str) -> bool {
        frame == robot.odom_frame
            || self.base(robot).is_some_and(|base| base == frame || is_above(&self.frames, frame, &base))
    }

    /// The robot's own frame, if it is known.
    pub(super) fn base(&self, robot: &Robot) -> Option<String> {
        if !robot.base_frame.is_empty() {
            return Some(robot.base_frame.clone());
        }
        let of_odometry = || {
            let mut odometry = self.topics.values().filter(|h| h.topic.content == Content::Odometry);
            odometry.find(|h| !h.topic.child_frame_id.is_empty()).map(|h| h.topic.child_frame_id.clone())
        };
        let prefixed = || ["base_link", "base_footprint"].into_iter().find_map(|name| self.frames.prefixed(name));
        let usual = topics::usual_base(&self.frames).map(str::to_owned);
        usual.or_else(of_odometry).or_else(|| prefixed().map(str::to_owned))
    }

    /// Decides what can be decided at `now`.
    pub(super) fn decide(&mut self, robot: &Robot, now: Duration) -> Vec<Decision> {
        let open = |h: &&Heard| h.standing == Standing::Open && h.since.is_some();
        let mut names: Vec<(u8, usize, String)> = self
            .topics
            .values()
            .filter(open)
            .map(|h| (h.topic.content.rank(), h.topic.name.len(), h.topic.name.clone()))
            .collect();
        // What is preferred first, so that the others find it taken.
        names.sort();
        let mut decisions = Vec::new();
        for (.., name) in names {
            let Some(heard) = self.topics.get(&name).cloned() else { continue };
            let waited = now.saturating_sub(heard.since.unwrap_or(now));
            if waited < SETTLE || heard.standing != Standing::Open {
                continue;
            }
            let Some(decision) = self.decision(robot, &heard.topic, waited >= PATIENCE) else { continue };
            let standing = match &decision {
                Decision::Take { spec, color, .. } => {
                    if let Some(color) = color.as_ref().and_then(|c| self.topics.get_mut(c)) {
                        color.standing = Standing::ColorOf(name.clone());
                    }
                    Standing::Taken(spec.id.clone())
                }
                Decision::Leave { lacks_calibration: true, .. } => Standing::Uncalibrated,
                Decision::Leave { why, .. } => Standing::Left(why.clone()),
            };
            if let Some(heard) = self.topics.get_mut(&name) {
                heard.standing = standing;
            }
            decisions.push(decision);
        }
        decisions
    }

    fn told(&self) -> impl Iterator<Item = &Topic> + Clone {
        self.topics.values().map(|h| &h.topic)
    }

    fn taken(&self) -> impl Iterator<Item = &Topic> {
        self.topics.values().filter(|h| matches!(h.standing, Standing::Taken(_))).map(|h| &h.topic)
    }

    /// None: it is waited for more.
    fn decision(&self, robot: &Robot, topic: &Topic, is_late: bool) -> Option<Decision> {
        let leave = |why: String| Some(Decision::Leave { topic: topic.name.clone(), why, lacks_calibration: false });
        let base = self.base(robot);
        let is_named = robot.names(&topic.name);
        if let Some(base) = base.as_deref()
            && is_above(&self.frames, &topic.frame_id, base)
            && topic.content != Content::Odometry
        {
            return leave(format!("its frame {} does not move with the robot", topic.frame_id));
        }
        if !is_named && let Some(other) = self.same(topic) {
            return leave(format!("{other} says the same"));
        }
        let is_color = matches!(topic.content, Content::Color { .. });
        if is_color && !is_named {
            // Whether it is depth's, and whether the robot has nothing better, takes longer to know.
            if !is_late {
                return None;
            }
            if !robot.wants(&topic.name) {
                return leave("it is not among the topics that are named".to_owned());
            }
            if self.taken().any(|t| t.content.is_sensing()) {
                return leave("a camera beside what knows distance is taken only if topics names it".to_owned());
            }
        }
        let color = self.told().filter(|c| topics::is_partner(self.told(), topic, c)).min_by_key(|c| {
            // A raw image before one that loses, the shorter name before the longer.
            (matches!(c.content, Content::Color { compressed: true, .. }), c.name.len(), c.name.clone())
        });
        let is_depth = matches!(topic.content, Content::Depth { .. });
        let unheard = |h: &Heard| h.since.is_none() && matches!(h.topic.content, Content::Color { .. });
        if is_depth && color.is_none() && !is_late && self.topics.values().any(unheard) {
            return None;
        }
        let intrinsics = if topic.content.is_image() { topics::calibration(self.told(), topic) } else { None };
        if topic.content.is_image() && intrinsics.is_none() {
            let why = "there is no camera_info of its size beside it".to_owned();
            let waits = Decision::Leave { topic: topic.name.clone(), why, lacks_calibration: true };
            return is_late.then_some(waits);
        }
        let kind = topic.content.kind(color.is_some());
        let (t_base_sensor, supposed) = if topic.content == Content::Odometry {
            // Its samples are of the frame that moves, which is the base but for a transform that stands still.
            let t_base_child = base.as_deref().and_then(|b| self.frames.t_a_b(b, &topic.child_frame_id));
            (t_base_child.unwrap_or_else(Pose::identity), None)
        } else {
            topics::mount(&self.frames, base.as_deref(), topic, kind)
        };
        if supposed.is_some() && !is_late {
            return None;
        }
        let spec = SensorSpec {
            id: topic.sensor_id(),
            kind,
            t_base_sensor,
            intrinsics,
            time_offset_s: 0.0,
            range_max_m: None,
        };
        let color = color.map(|c| c.name.clone());
        Some(Decision::Take { topic: topic.name.clone(), spec: Box::new(spec), color, supposed })
    }

    /// Another topic that is taken and says what this one says.
    fn same(&self, topic: &Topic) -> Option<String> {
        if topics::is_of_depth_camera(self.told(), topic) {
            let depth =
                self.told().find(|d| matches!(d.content, Content::Depth { .. }) && d.frame_id == topic.frame_id);
            return depth.map(|d| d.name.clone());
        }
        let is_same = |other: &&Topic| match (&topic.content, &other.content) {
            // A robot has one odometry, and one inertial sensor that counts.
            (Content::Odometry, Content::Odometry) | (Content::Imu, Content::Imu) => true,
            (Content::Scan, Content::Scan)
            | (Content::Cloud, Content::Cloud)
            | (Content::Depth { .. }, Content::Depth { .. })
            | (Content::Color { .. }, Content::Color { .. }) => topic.frame_id == other.frame_id,
            _ => false,
        };
        self.taken().find(is_same).map(|other| other.name.clone())
    }

    /// Whether transforms have to tell where the wheels are: nobody publishes odometry, and they do.
    pub(super) fn odometry_by_transforms(&self) -> bool {
        let is_odometry = |h: &Heard| {
            h.topic.content == Content::Odometry && !matches!(h.standing, Standing::Left(_)) && h.since.is_some()
        };
        self.has_odometry_transform && !self.topics.values().any(is_odometry)
    }
}

/// Whether `frame` is one that `base` moves in.
fn is_above(frames: &FrameTree, frame: &str, base: &str) -> bool {
    let mut at = base.to_owned();
    // No tree is deeper than it has frames.
    for _ in 0..=frames.len() {
        let Some((parent, _)) = frames.parent(&at) else { return false };
        if parent == frame.trim_start_matches('/') {
            return true;
        }
        parent.to_owned().clone_into(&mut at);
    }
    false
}

/// The kind of sensor that odometry by transforms is, and its id.
pub(super) fn transforms_sensor() -> SensorSpec {
    SensorSpec {
        id: SensorId("tf".to_owned()),
        kind: SensorKind::Odometry,
        t_base_sensor: Pose::identity(),
        intrinsics: None,
        time_offset_s: 0.0,
        range_max_m: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_ros::messages::{CameraInfo, Header, Image};

    const LASER: &str = "sensor_msgs/msg/LaserScan";
    const CLOUD: &str = "sensor_msgs/msg/PointCloud2";
    const IMAGE: &str = "sensor_msgs/msg/Image";

    fn seconds(s: f64) -> Duration {
        Duration::from_secs_f64(s)
    }

    /// A robot with a laser, a lidar and a camera on its base.
    fn book() -> Book {
        let mut book = Book::default();
        for (parent, child, z) in [
            ("odom", "base_link", 0.0),
            ("base_link", "laser", 0.2),
            ("base_link", "lidar", 0.8),
            ("base_link", "optical", 0.5),
        ] {
            book.frames.insert(parent, child, Pose::translation(0.0, 0.0, z));
        }
        book
    }

    fn hear(book: &mut Book, robot: &Robot, name: &str, type_name: &str, frame: &str, at: f64) {
        assert!(book.add(robot, name, type_name), "{name}");
        frame.clone_into(&mut book.topics.get_mut(name).unwrap().topic.frame_id);
        book.heard(name, seconds(at));
    }

    fn outcome(decisions: &[Decision]) -> Vec<(String, bool)> {
        let each = decisions.iter().map(|d| match d {
            Decision::Take { topic, .. } => (topic.clone(), true),
            Decision::Leave { topic, .. } => (topic.clone(), false),
        });
        each.collect()
    }

    #[test]
    fn lidars_of_several_frames_are_taken_and_what_says_the_same_is_left() {
        let (mut book, robot) = (book(), Robot::default());
        hear(&mut book, &robot, "/points_filtered", CLOUD, "lidar", 0.0);
        hear(&mut book, &robot, "/points", CLOUD, "lidar", 0.5);
        hear(&mut book, &robot, "/scan", LASER, "laser", 0.0);
        hear(&mut book, &robot, "/map_cloud", CLOUD, "odom", 0.0);
        assert!(book.decide(&robot, seconds(0.9)).is_empty());
        let decisions = book.decide(&robot, seconds(1.6));
        let expected = [("/points", true), ("/map_cloud", false), ("/points_filtered", false), ("/scan", true)];
        assert_eq!(outcome(&decisions), expected.map(|(t, taken)| (t.to_owned(), taken)));
        let Decision::Take { spec, supposed, .. } = &decisions[3] else { panic!() };
        assert_eq!((spec.kind, spec.t_base_sensor.translation.z, supposed), (SensorKind::Lidar2d, 0.2, &None));
        assert!(book.decide(&robot, seconds(9.0)).is_empty());
    }

    #[test]
    fn a_transform_is_waited_for_and_then_supposed() {
        let (mut book, robot) = (book(), Robot::default());
        hear(&mut book, &robot, "/scan", LASER, "elsewhere", 0.0);
        assert!(book.decide(&robot, seconds(4.9)).is_empty());
        let decisions = book.decide(&robot, seconds(5.1));
        let Some(Decision::Take { supposed: Some(words), .. }) = decisions.first() else { panic!("{decisions:?}") };
        assert!(words.contains("no transform from base_link to elsewhere"), "{words}");
    }

    #[test]
    fn depth_takes_its_colour_and_a_camera_alone_only_counts_without_lidar() {
        let (mut book, robot) = (book(), Robot::default());
        let header = Header { frame_id: "optical", ..Header::default() };
        for (name, encoding) in [("/camera/depth/image", "16UC1"), ("/camera/color/image", "rgb8")] {
            hear(&mut book, &robot, name, IMAGE, "optical", 0.0);
            let image = Image { header, width: 64, height: 48, encoding, ..Image::default() };
            book.topics.get_mut(name).unwrap().topic.note_image(&image);
        }
        assert!(book.decide(&robot, seconds(2.0)).is_empty(), "no calibration yet");
        for name in ["/camera/depth/camera_info", "/camera/color/camera_info"] {
            assert!(book.add(&robot, name, "sensor_msgs/msg/CameraInfo"));
            let k = [60.0, 0.0, 32.0, 0.0, 60.0, 24.0, 0.0, 0.0, 1.0];
            let info = CameraInfo { header, width: 64, height: 48, k, ..CameraInfo::default() };
            book.topics.get_mut(name).unwrap().topic.note_calibration(&info);
        }
        let decisions = book.decide(&robot, seconds(2.0));
        let [Decision::Take { topic, spec, color, .. }] = &decisions[..] else { panic!("{decisions:?}") };
        assert_eq!(
            (topic.as_str(), spec.kind, color.as_deref()),
            ("/camera/depth/image", SensorKind::Rgbd, Some("/camera/color/image"))
        );
        assert!(matches!(book.topics["/camera/color/image"].standing, Standing::ColorOf(_)));
        // Another camera, beside what knows distance.
        hear(&mut book, &robot, "/rear/image", IMAGE, "optical", 2.0);
        assert_eq!(outcome(&book.decide(&robot, seconds(8.0))), [("/rear/image".to_owned(), false)]);
    }

    #[test]
    fn one_odometry_counts_and_transforms_tell_where_there_is_none() {
        let (mut book, robot) = (book(), Robot::default());
        book.note_odometry();
        assert!(book.odometry_by_transforms());
        hear(&mut book, &robot, "/odom", "nav_msgs/msg/Odometry", "odom", 0.0);
        hear(&mut book, &robot, "/odometry/filtered", "nav_msgs/msg/Odometry", "odom", 0.0);
        assert!(!book.odometry_by_transforms());
        let expected = [("/odom".to_owned(), true), ("/odometry/filtered".to_owned(), false)];
        assert_eq!(outcome(&book.decide(&robot, seconds(1.5))), expected);
    }

    #[test]
    fn topics_that_are_named_are_taken_alone() {
        let (mut book, robot) = (book(), Robot { topics: vec!["/scan".to_owned()], ..Robot::default() });
        assert!(!book.add(&robot, "/points", CLOUD) && book.add(&robot, "/tf", "tf2_msgs/msg/TFMessage"));
        hear(&mut book, &robot, "/scan", LASER, "laser", 0.0);
        assert_eq!(outcome(&book.decide(&robot, seconds(2.0))), [("/scan".to_owned(), true)]);
    }
}
