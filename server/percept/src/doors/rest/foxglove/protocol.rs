//! Foxglove's WebSocket protocol, as much of it as is spoken here: what is on offer, who wants what, messages in both directions.
//!
//! Source: the specification in `foxglove/ws-protocol` (version 1 of the protocol), which `foxglove.sdk.v1` goes on with.

use percept_ros::Message;
use serde::Deserialize;
use serde_json::{Value, json};

/// Names of the protocol, as clients of today and of before ask for it.
pub(super) const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// The number of a message and its channel or subscription, and of a time.
const MESSAGE_DATA: u8 = 1;
const TIME: u8 = 2;
/// The only encoding that is spoken: of ROS 2.
const CDR: &str = "cdr";

/// A topic on offer.
pub(super) struct Channel {
    pub(super) topic: &'static str,
    type_name: &'static str,
    definition: fn() -> String,
}

impl Channel {
    pub(super) const fn of<'a, M: Message<'a>>(topic: &'static str) -> Self {
        Self { topic, type_name: M::TYPE_NAME, definition: M::definition }
    }
}

/// What a client says.
#[derive(Debug, Deserialize, PartialEq, Eq)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
pub(super) enum Said {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    Advertise {
        channels: Vec<ClientChannel>,
    },
    Unadvertise {
        channel_ids: Vec<u32>,
    },
    /// What is not on offer.
    #[serde(other)]
    Else,
}

/// What a client wants, and its own number for it.
#[derive(Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "camelCase")]
pub(super) struct Subscription {
    pub(super) id: u32,
    pub(super) channel_id: u64,
}

/// A topic that a client publishes, and its own number for it.
#[derive(Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "camelCase")]
pub(super) struct ClientChannel {
    pub(super) id: u32,
    pub(super) topic: String,
    pub(super) encoding: String,
    pub(super) schema_name: String,
}

impl ClientChannel {
    /// Whether it brings messages of a type, however that is written.
    pub(super) fn brings<'a, M: Message<'a>>(&self) -> bool {
        let short = |name: &str| name.replacen("/msg/", "/", 1);
        self.encoding == CDR && short(&self.schema_name) == short(M::TYPE_NAME)
    }
}

/// How bad a status is.
#[derive(Debug, Clone, Copy)]
pub(super) enum Level {
    Warning = 1,
    Error = 2,
}

/// The first message: who this is, and what it can do.
pub(super) fn server_info(name: &str, session_id: &str) -> String {
    let capabilities = ["clientPublish", "time"];
    // By the distribution a client knows how to write the messages that it publishes.
    let metadata = json!({"ROS_DISTRO": "jazzy"});
    json!({
        "op": "serverInfo", "name": name, "capabilities": capabilities, "supportedEncodings": [CDR],
        "metadata": metadata, "sessionId": session_id,
    })
    .to_string()
}

/// What is on offer; a channel's number is its place.
pub(super) fn advertise(channels: &[Channel]) -> String {
    let channel = |(id, channel): (usize, &Channel)| {
        json!({
            "id": id, "topic": channel.topic, "encoding": CDR, "schemaName": channel.type_name,
            "schema": (channel.definition)(), "schemaEncoding": "ros2msg",
        })
    };
    let channels: Vec<Value> = channels.iter().enumerate().map(channel).collect();
    json!({"op": "advertise", "channels": channels}).to_string()
}

/// Something that a person should read. A newer one of the same `id` stands for it.
pub(super) fn status(level: Level, id: &str, message: &str) -> String {
    json!({"op": "status", "level": level as u8, "message": message, "id": id}).to_string()
}

/// That a status is no longer so.
pub(super) fn remove_status(id: &str) -> String {
    json!({"op": "removeStatus", "statusIds": [id]}).to_string()
}

/// A message for a subscription, at a time in ns.
pub(super) fn message_data(subscription: u32, time_ns: u64, message: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(13 + message.len());
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&subscription.to_le_bytes());
    bytes.extend_from_slice(&time_ns.to_le_bytes());
    bytes.extend_from_slice(message);
    bytes
}

/// The time of what is shown, in ns.
pub(super) fn time(time_ns: u64) -> Vec<u8> {
    let mut bytes = vec![TIME];
    bytes.extend_from_slice(&time_ns.to_le_bytes());
    bytes
}

/// The client's channel and what came by it; none for what is no message.
pub(super) fn client_message(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (&MESSAGE_DATA, rest) = bytes.split_first()? else { return None };
    let (channel, message) = rest.split_first_chunk::<4>()?;
    Some((u32::from_le_bytes(*channel), message))
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_ros::messages::{OccupancyGrid, PoseStamped};

    #[test]
    fn what_clients_say_is_read_as_the_specification_writes_it() {
        let read = |text: &str| serde_json::from_str::<Said>(text).unwrap();
        let subscribe = read(r#"{"op": "subscribe", "subscriptions": [{"id": 0, "channelId": 3}]}"#);
        assert_eq!(subscribe, Said::Subscribe { subscriptions: vec![Subscription { id: 0, channel_id: 3 }] });
        let unsubscribe = read(r#"{"op": "unsubscribe", "subscriptionIds": [0, 1]}"#);
        assert_eq!(unsubscribe, Said::Unsubscribe { subscription_ids: vec![0, 1] });
        let advertise = read(
            r#"{"op": "advertise", "channels": [{"id": 1, "topic": "/goal_pose", "encoding": "cdr",
                "schemaName": "geometry_msgs/msg/PoseStamped", "schema": "x"}]}"#,
        );
        let Said::Advertise { channels } = advertise else { unreachable!("it is an advertisement") };
        assert!(channels[0].brings::<PoseStamped<'_>>() && !channels[0].brings::<OccupancyGrid<'_>>());
        assert_eq!(read(r#"{"op": "unadvertise", "channelIds": [2]}"#), Said::Unadvertise { channel_ids: vec![2] });
        assert_eq!(read(r#"{"op": "getParameters", "parameterNames": [], "id": "x"}"#), Said::Else);
        assert!(serde_json::from_str::<Said>(r#"{"op": "subscribe"}"#).is_err());
        assert!(serde_json::from_str::<Said>("[]").is_err());
    }

    #[test]
    fn binary_messages_have_the_layout_of_the_specification() {
        assert_eq!(message_data(5, 0x0102, b"ab"), [1, 5, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, b'a', b'b']);
        assert_eq!(time(7), [2, 7, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(client_message(&[1, 9, 0, 0, 0, b'x']), Some((9, &b"x"[..])));
        for cut in [&[][..], &[1][..], &[1, 2, 3, 4][..], &[2, 0, 0, 0, 0, 1][..]] {
            assert_eq!(client_message(cut), None);
        }
    }

    #[test]
    fn an_offer_names_type_and_definition() {
        let offer: Value = serde_json::from_str(&advertise(&[Channel::of::<OccupancyGrid<'_>>("/map")])).unwrap();
        let channel = &offer["channels"][0];
        assert_eq!((&channel["id"], &channel["topic"]), (&json!(0), &json!("/map")));
        assert_eq!(channel["schemaName"], "nav_msgs/msg/OccupancyGrid");
        assert!(channel["schema"].as_str().unwrap().contains("MSG: geometry_msgs/Pose\n"));
    }
}
