//! Which robots are listened to, and where.

use crate::config::is_loopback;
use serde::{Deserialize, Serialize};

/// Robots on ROS 2 whose sensors are taken in, and who get poses and maps back: by rmw_zenoh, or by the bridge of zenoh and DDS.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Ros2 {
    /// One entry a robot, as tables `[[ros2.robots]]` with `session` (made if absent), and `connect` (where the robot's
    /// zenoh router is, such as "tcp/robot-7.local:7447") or `listen` (where its router connects to). If they are not
    /// so: `domain` (0), `namespace` of its topics (""), `protocol` ("rmw_zenoh", or "ros2dds" for the bridge),
    /// `topics` that are taken alone ([]: all that are found and fit), `base_frame` ("": base_link, else
    /// base_footprint), `odom_frame` ("odom", else what base hangs on), `map_frame` ("map"), `publishes` (true: tf, map,
    /// pose and what else is found goes back), `tenant` ("default").
    pub robots: Vec<Robot>,
}

/// One robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Robot {
    /// Session that its sensors feed; made if it is absent.
    pub session: String,
    /// Endpoint of its zenoh router.
    pub connect: String,
    /// Endpoint that its zenoh router connects to, instead.
    pub listen: String,
    /// ROS domain.
    pub domain: u32,
    /// What its topics begin with.
    pub namespace: String,
    /// How its topics are on zenoh.
    pub protocol: Protocol,
    /// Topics of sensors that are taken alone; empty: all that are found and fit.
    pub topics: Vec<String>,
    /// Its own frame; empty: as REP-105 names it.
    pub base_frame: String,
    /// The frame that its wheels count in.
    pub odom_frame: String,
    /// The frame of the map.
    pub map_frame: String,
    /// Whether it gets results back.
    pub publishes: bool,
    /// Tenant of the session.
    pub tenant: String,
}

impl Default for Robot {
    fn default() -> Self {
        Self {
            session: String::new(),
            connect: String::new(),
            listen: String::new(),
            domain: 0,
            namespace: String::new(),
            protocol: Protocol::default(),
            topics: vec![],
            base_frame: String::new(),
            odom_frame: "odom".to_owned(),
            map_frame: "map".to_owned(),
            publishes: true,
            tenant: percept_identity::DEFAULT_TENANT.to_owned(),
        }
    }
}

/// How topics of ROS 2 are on zenoh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Protocol {
    /// As nodes on rmw_zenoh put them.
    #[default]
    RmwZenoh,
    /// As zenoh-plugin-ros2dds and its bridge put them.
    Ros2dds,
}

/// What is wrong with a setting: field, value, remedy.
pub(crate) type Complaint = (String, String, String);

impl Ros2 {
    /// What is wrong, the first of it. `takes_anybody`: whether whoever reaches a door may call.
    pub(crate) fn complaint(&self, takes_anybody: bool) -> Option<Complaint> {
        let mut sessions = std::collections::BTreeSet::new();
        for (i, robot) in self.robots.iter().enumerate() {
            let found = |field: &str, value: &dyn std::fmt::Debug, remedy: &str| {
                Some((format!("ros2.robots[{i}].{field}"), format!("{value:?}"), remedy.to_owned()))
            };
            if percept_service::check_id("session", &robot.session).is_err() {
                return found("session", &robot.session, "write 1 to 64 letters, digits, - and _");
            }
            if !sessions.insert(&robot.session) {
                return found("session", &robot.session, "give each robot a session of its own");
            }
            let (connect, listen) = (&robot.connect, &robot.listen);
            match (connect.is_empty(), listen.is_empty()) {
                (true, true) => {
                    return found(
                        "connect",
                        connect,
                        "write where the robot's router is, such as \"tcp/10.0.0.7:7447\"",
                    );
                }
                (false, false) => return found("listen", listen, "leave it empty: connect says where the robot is"),
                _ => {}
            }
            for (field, endpoint) in [("connect", connect), ("listen", listen)] {
                if !endpoint.is_empty() && !is_endpoint(endpoint) {
                    return found(
                        field,
                        endpoint,
                        "write tcp/ or udp/, address and port, such as \"tcp/10.0.0.7:7447\"",
                    );
                }
            }
            if !listen.is_empty() && !takes_anybody && !is_loopback(listen) {
                let remedy = "which others can reach, and ROS 2 tells nobody's name: connect to the robot's router instead, \
                              listen on 127.0.0.1, or let everybody in with auth.allow_anonymous_beyond_loopback = true";
                return found("listen", listen, remedy);
            }
            if robot.domain > 232 {
                return found("domain", &robot.domain, "set it between 0 and 232");
            }
            if !is_name(&robot.namespace) {
                return found("namespace", &robot.namespace, "write names parted by slashes, such as \"robot_7\"");
            }
            if let Some(topic) = robot.topics.iter().find(|t| t.trim_matches('/').is_empty() || !is_name(t)) {
                return found("topics", topic, "write names parted by slashes, such as \"/scan\"");
            }
            for (field, frame) in [("odom_frame", &robot.odom_frame), ("map_frame", &robot.map_frame)] {
                if frame.is_empty() {
                    return found(field, frame, "name the frame, as the robot's transforms do");
                }
            }
            if robot.tenant.is_empty() {
                return found("tenant", &robot.tenant, "name the session's tenant");
            }
        }
        None
    }
}

impl Robot {
    /// A topic of this robot by its name in the robot's namespace: `/robot_7/map` for `map`.
    pub(super) fn topic(&self, name: &str) -> String {
        match self.namespace.trim_matches('/') {
            "" => format!("/{name}"),
            space => format!("/{space}/{name}"),
        }
    }

    /// Whether a topic is this robot's. Transforms of all robots may be on one topic.
    pub(super) fn has(&self, topic: &str) -> bool {
        let space = self.topic("");
        topic.starts_with(&space) || matches!(topic, "/tf" | "/tf_static")
    }

    /// Whether a sensor's topic is wanted.
    pub(super) fn wants(&self, topic: &str) -> bool {
        let bare = topic.trim_matches('/');
        self.topics.is_empty() || self.topics.iter().any(|t| t.trim_matches('/') == bare)
    }

    /// Whether the settings name a topic.
    pub(super) fn names(&self, topic: &str) -> bool {
        !self.topics.is_empty() && self.wants(topic)
    }
}

fn is_endpoint(text: &str) -> bool {
    let Some((protocol, address)) = text.split_once('/') else { return false };
    let Some((host, port)) = address.rsplit_once(':') else { return false };
    matches!(protocol, "tcp" | "udp") && !host.is_empty() && port.parse::<u16>().is_ok()
}

fn is_name(text: &str) -> bool {
    let is_word = |w: &str| !w.is_empty() && w.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    text.trim_matches('/').is_empty() || text.trim_matches('/').split('/').all(is_word)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(change: impl FnOnce(&mut Robot)) -> Option<String> {
        let mut robot = Robot { session: "r".to_owned(), connect: "tcp/h:7447".to_owned(), ..Robot::default() };
        change(&mut robot);
        Ros2 { robots: vec![robot] }.complaint(false).map(|(field, ..)| field)
    }

    #[test]
    fn what_cannot_be_is_told_by_its_field() {
        assert_eq!(robot(|_| {}), None);
        type Change = fn(&mut Robot);
        let cases: [(&str, Change); 9] = [
            ("session", |r| r.session = "a b".to_owned()),
            ("connect", |r| r.connect = String::new()),
            ("connect", |r| r.connect = "robot:7447".to_owned()),
            ("listen", |r| r.listen = "tcp/127.0.0.1:7448".to_owned()),
            ("domain", |r| r.domain = 300),
            ("namespace", |r| r.namespace = "a//b".to_owned()),
            ("topics", |r| r.topics = vec!["/scan*".to_owned()]),
            ("map_frame", |r| r.map_frame = String::new()),
            ("listen", |r| {
                r.connect = String::new();
                r.listen = "tcp/0.0.0.0:7448".to_owned();
            }),
        ];
        for (field, change) in cases {
            assert_eq!(robot(change), Some(format!("ros2.robots[0].{field}")));
        }
        let twice = Robot { session: "r".to_owned(), connect: "tcp/h:1".to_owned(), ..Robot::default() };
        assert!(Ros2 { robots: vec![twice.clone(), twice] }.complaint(false).is_some());
    }

    #[test]
    fn a_robot_has_the_topics_of_its_namespace_and_transforms() {
        let robot =
            Robot { namespace: "/robot_7/".to_owned(), topics: vec!["robot_7/scan".to_owned()], ..Robot::default() };
        assert_eq!(robot.topic("map"), "/robot_7/map");
        let has = ["/robot_7/scan", "/tf", "/tf_static", "/scan", "/robot_77/scan"].map(|t| robot.has(t));
        assert_eq!(has, [true, true, true, false, false]);
        assert!(robot.wants("/robot_7/scan") && robot.names("/robot_7/scan") && !robot.wants("/robot_7/points"));
        let any = Robot::default();
        assert!(any.has("/scan") && any.wants("/scan") && !any.names("/scan"));
    }
}
