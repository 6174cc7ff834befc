//! Topics of ROS 2 as zenoh has them: who publishes what, what to subscribe to, how to publish.

use super::super::zenoh::Failure;
use super::settings::{Protocol, Robot};
use percept_ros::rmw_zenoh::{
    self, Attachment, DataKey, Durability, Endpoint, EntityKind, History, LivelinessToken, Qos,
};
use percept_ros::ros2dds::{self, RouteKind, RouteQos, RouteToken};
use percept_ros::{Message, TypeHash, TypeName, topics};
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use zenoh::liveliness::LivelinessToken as Announced;
use zenoh::qos::{CongestionControl, Priority};
use zenoh_ext::{AdvancedPublisher, AdvancedPublisherBuilderExt, CacheConfig};

/// Name of the node that percept is on the robot's network.
const NODE: &str = "percept";

/// A topic that somebody publishes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Found {
    /// With a slash in front.
    pub(super) topic: String,
    /// `sensor_msgs/msg/LaserScan`.
    pub(super) type_name: String,
    /// What to subscribe to.
    pub(super) key: String,
    /// Whether late joiners get what was sent before.
    pub(super) is_latched: bool,
    /// Whether it is of ROS 2 Humble, whose types have no hashes.
    pub(super) is_unhashed: bool,
    /// Whether the publisher's definition of the type is not ours.
    pub(super) is_of_other_definition: bool,
}

/// What to look at for who publishes.
pub(super) fn liveliness_key(robot: &Robot) -> String {
    match robot.protocol {
        Protocol::RmwZenoh => rmw_zenoh::liveliness_key(robot.domain),
        Protocol::Ros2dds => ros2dds::LIVELINESS_KEY.to_owned(),
    }
}

/// What a token says that somebody else publishes; none for what is no publisher.
pub(super) fn found(robot: &Robot, token: &str, own_zid: &str) -> Option<Found> {
    match robot.protocol {
        Protocol::RmwZenoh => {
            let token = LivelinessToken::parse(token).ok()?;
            let endpoint = token.endpoint.filter(|_| token.kind == EntityKind::Publisher && token.zid != own_zid)?;
            Some(Found {
                key: rmw_zenoh::subscription_key(token.domain, &endpoint.topic, &endpoint.type_name).ok()?,
                type_name: endpoint.type_name.to_string(),
                is_latched: endpoint.qos.durability == Durability::TransientLocal,
                is_unhashed: endpoint.type_hash == TypeHash::NotSupported,
                is_of_other_definition: is_other(&endpoint.type_name.to_string(), endpoint.type_hash),
                topic: endpoint.topic,
            })
        }
        Protocol::Ros2dds => {
            let token = RouteToken::parse(token).ok().filter(|t| t.kind == RouteKind::Publisher && t.zid != own_zid)?;
            Some(Found {
                topic: format!("/{}", token.key),
                type_name: token.type_name.to_string(),
                is_latched: token.qos.is_some_and(|q| q.durability == Some(Durability::TransientLocal)),
                is_unhashed: false,
                is_of_other_definition: false,
                key: token.key,
            })
        }
    }
}

fn is_other(type_name: &str, theirs: TypeHash) -> bool {
    theirs != TypeHash::NotSupported && topics::type_hash(type_name).is_some_and(|ours| ours != theirs)
}

/// Counts what percept has on a network of ROS 2.
#[derive(Default)]
pub(super) struct Entities {
    next: AtomicU64,
}

impl Entities {
    fn take(&self) -> u64 {
        self.next.fetch_add(1, Ordering::Relaxed)
    }
}

/// How a topic is published.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Manner {
    /// What is worth something at once, or not at all: transforms and poses.
    Now,
    /// What changes now and then, and is large: maps. Late joiners get the last.
    Latched,
}

/// percept's node on a network of ROS 2, for one robot; gone when it is dropped.
pub(super) struct Node<'a> {
    zenoh: &'a zenoh::Session,
    entities: &'a Entities,
    robot: &'a Robot,
    id: u64,
    /// Whether types have no hashes there.
    is_unhashed: bool,
    _token: Option<Announced>,
}

impl<'a> Node<'a> {
    pub(super) async fn declare(
        zenoh: &'a zenoh::Session,
        entities: &'a Entities,
        robot: &'a Robot,
        is_unhashed: bool,
    ) -> Result<Self, Failure> {
        let id = entities.take();
        let mut node = Self { zenoh, entities, robot, id, is_unhashed, _token: None };
        if robot.protocol == Protocol::RmwZenoh {
            let token = node.token(id, EntityKind::Node, None).to_string();
            node._token = Some(zenoh.liveliness().declare_token(token).await?);
        }
        Ok(node)
    }

    fn token(&self, entity_id: u64, kind: EntityKind, endpoint: Option<Endpoint>) -> LivelinessToken {
        LivelinessToken {
            domain: self.robot.domain,
            zid: self.zenoh.zid().to_string(),
            node_id: self.id,
            entity_id,
            kind,
            enclave: "/".to_owned(),
            namespace: self.robot.topic("").trim_end_matches('/').to_owned(),
            node: NODE.to_owned(),
            endpoint,
        }
    }

    /// A publisher of a topic.
    pub(super) async fn publisher<'m, M: Message<'m>>(
        &self,
        topic: &str,
        manner: Manner,
    ) -> Result<Topic<'a>, Failure> {
        self.publisher_of(topic, M::TYPE_NAME, M::type_hash(), manner).await
    }

    async fn publisher_of(
        &self,
        topic: &str,
        type_name: &str,
        type_hash: TypeHash,
        manner: Manner,
    ) -> Result<Topic<'a>, Failure> {
        let type_name = TypeName::parse(type_name)?;
        let type_hash = if self.is_unhashed { TypeHash::NotSupported } else { type_hash };
        let durability = if manner == Manner::Latched { Durability::TransientLocal } else { Durability::Volatile };
        let history = History::KeepLast(if manner == Manner::Latched { 1 } else { 10 });
        let id = self.entities.take();
        let (key, token) = match self.robot.protocol {
            Protocol::RmwZenoh => {
                let key = DataKey::new(self.robot.domain, topic, type_name.clone(), type_hash)?.to_string();
                let qos = Qos { durability, history, ..Qos::default() };
                let endpoint = Endpoint { topic: topic.to_owned(), type_name, type_hash, qos };
                (key, self.token(id, EntityKind::Publisher, Some(endpoint)).to_string())
            }
            Protocol::Ros2dds => {
                let key = ros2dds::data_key("", topic)?;
                let qos = RouteQos {
                    is_keyless: true,
                    reliability: Some(rmw_zenoh::Reliability::Reliable),
                    durability: Some(durability),
                    history: Some(history),
                };
                let zid = self.zenoh.zid().to_string();
                let token = RouteToken { zid, kind: RouteKind::Publisher, key: key.clone(), type_name, qos: Some(qos) };
                (key, token.to_string())
            }
        };
        let publisher = self.zenoh.declare_publisher(key);
        let publisher = match manner {
            Manner::Now => publisher
                .congestion_control(CongestionControl::Drop)
                .priority(Priority::InteractiveHigh)
                .express(true)
                .advanced(),
            Manner::Latched => {
                let late = publisher.congestion_control(CongestionControl::Block).priority(Priority::DataLow);
                late.cache(CacheConfig::default().max_samples(1)).publisher_detection()
            }
        };
        let mut gid = [0; 16];
        gid[..8].copy_from_slice(&self.zenoh.zid().to_le_bytes()[..8]);
        gid[8..].copy_from_slice(&id.to_le_bytes());
        Ok(Topic {
            publisher: publisher.await?,
            _token: self.zenoh.liveliness().declare_token(token).await?,
            gid,
            sent: AtomicI64::new(0),
        })
    }
}

/// A topic that percept publishes.
pub(super) struct Topic<'a> {
    publisher: AdvancedPublisher<'a>,
    _token: Announced,
    gid: [u8; 16],
    sent: AtomicI64,
}

impl Topic<'_> {
    /// Whether somebody listens.
    pub(super) async fn is_heard(&self) -> bool {
        self.publisher.matching_status().await.is_ok_and(|status| status.matching())
    }

    /// Publishes an encoded message, as sent at `now_ns` (ns since the Unix epoch).
    pub(super) async fn send(&self, bytes: Vec<u8>, now_ns: i64) -> Result<(), Failure> {
        let sequence = self.sent.fetch_add(1, Ordering::Relaxed) + 1;
        let attachment = Attachment { sequence, source_time_ns: now_ns, gid: self.gid };
        self.publisher.put(bytes).attachment(attachment.to_bytes().to_vec()).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn publishers_of_both_protocols_are_found_and_ones_own_are_not() {
        let robot = Robot::default();
        let token = "@ros2_lv/0/abc/0/7/MP/%/%/lidar/%scan/sensor_msgs::msg::dds_::LaserScan_/\
                     RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828/2::,5:,:,:,,";
        let scan = found(&robot, token, "def").unwrap();
        assert_eq!((scan.topic.as_str(), scan.type_name.as_str()), ("/scan", "sensor_msgs/msg/LaserScan"));
        assert_eq!(scan.key, "0/scan/sensor_msgs::msg::dds_::LaserScan_/*");
        assert!(!scan.is_latched && !scan.is_unhashed && !scan.is_of_other_definition);
        assert!(found(&robot, &token.replace("RIHS01_64", "RIHS01_65"), "def").unwrap().is_of_other_definition);
        assert_eq!(found(&robot, token, "abc"), None);
        assert_eq!(found(&robot, &token.replace("/MP/", "/MS/"), "def"), None);
        assert_eq!(found(&robot, "rubbish", "def"), None);

        let robot = Robot { protocol: Protocol::Ros2dds, ..Robot::default() };
        let token = "@/abc/@ros2_lv/MP/bot1§tf_static/tf2_msgs§msg§TFMessage/:1:1:0,1";
        let tf = found(&robot, token, "def").unwrap();
        assert_eq!(
            (tf.topic.as_str(), tf.type_name.as_str(), tf.key.as_str()),
            ("/bot1/tf_static", "tf2_msgs/msg/TFMessage", "bot1/tf_static")
        );
        assert!(tf.is_latched);
    }
}
