//! Keys, tokens and attachments of `rmw_zenoh_cpp`, against what it writes.

use percept_ros::rmw_zenoh::{
    Attachment, DataKey, Durability, Endpoint, EntityKind, History, Liveliness, LivelinessToken, Qos, QosDuration,
    Reliability, liveliness_key, subscription_key, topic_key, type_key,
};
use percept_ros::{Message, TypeHash, TypeName, messages::PointCloud2};
use proptest::prelude::*;

const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

fn string() -> TypeName {
    TypeName::parse("std_msgs/msg/String").unwrap()
}

#[test]
fn data_keys_read_and_write_inner_slashes() {
    let text = format!("42/robot_1/lidar/points/sensor_msgs::msg::dds_::PointCloud2_/{}", PointCloud2::type_hash());
    let key = DataKey::parse(&text).unwrap();
    assert_eq!((key.domain, key.topic.as_str()), (42, "/robot_1/lidar/points"));
    assert_eq!((key.type_name.to_string().as_str(), key.type_hash), (PointCloud2::TYPE_NAME, PointCloud2::type_hash()));
    assert_eq!(key.to_string(), text);
    let same = DataKey::new(42, "robot_1/lidar/points/", key.type_name.clone(), key.type_hash).unwrap();
    assert_eq!(same, key);
}

#[test]
fn humble_keys_have_no_hash() {
    let key = DataKey::parse("0/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported").unwrap();
    assert_eq!((key.type_hash, key.topic.as_str()), (TypeHash::NotSupported, "/chatter"));
}

#[test]
fn keys_that_are_none_say_which_part_is_wrong() {
    let hash = HASH;
    for (text, part) in [
        ("", "key"),
        ("0/a/b", "key"),
        (&format!("x/chatter/std_msgs::msg::dds_::String_/{hash}"), "domain"),
        (&format!("0/chatter/std_msgs::msg::String/{hash}x"), "type hash"),
        (&format!("0/chatter/String/{hash}"), "type"),
        (&format!("0/cha*er/std_msgs::msg::dds_::String_/{hash}"), "topic"),
        (&format!("0/a//b/std_msgs::msg::dds_::String_/{hash}"), "topic"),
        (&format!("0//std_msgs::msg::dds_::String_/{hash}"), "topic"),
    ] {
        assert_eq!(DataKey::parse(text).unwrap_err().part, part, "{text}");
    }
}

#[test]
fn subscriptions_leave_the_hash_open() {
    assert_eq!(subscription_key(0, "/a/b", &string()).unwrap(), "0/a/b/std_msgs::msg::dds_::String_/*");
    assert_eq!(topic_key(3, "/a/b").unwrap(), "3/a/b/*/*");
    assert_eq!(type_key(0, &string()), "0/**/std_msgs::msg::dds_::String_/*");
    assert_eq!(liveliness_key(7), "@ros2_lv/7/**");
    assert!(subscription_key(0, "/", &string()).is_err() && topic_key(0, "a/**").is_err());
}

#[test]
fn the_tokens_of_the_design_document_read_and_write() {
    // ros2/rmw_zenoh, docs/design.md, "Graph Cache".
    let node = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener";
    let talker = format!(
        "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/{HASH}/::,7:,:,:,,"
    );
    let token = LivelinessToken::parse(node).unwrap();
    assert_eq!((token.kind, token.node.as_str(), token.endpoint.is_none()), (EntityKind::Node, "listener", true));
    assert_eq!((token.namespace.as_str(), token.to_string().as_str()), ("/", node));
    let token = LivelinessToken::parse(&talker).unwrap();
    assert_eq!((token.domain, token.node_id, token.entity_id), (2, 0, 10));
    let qos = Qos { history: History::KeepLast(7), ..Qos::default() };
    let endpoint = Endpoint { topic: "/chatter".into(), type_name: string(), type_hash: HASH.parse().unwrap(), qos };
    assert_eq!(token.endpoint.as_ref(), Some(&endpoint));
    assert_eq!(token.to_string(), talker);
    // Rolling appends what transports it offers.
    assert_eq!(LivelinessToken::parse(&format!("{talker}/cpu")).unwrap(), token);
}

#[test]
fn names_in_tokens_keep_their_slashes() {
    let text = format!(
        "@ros2_lv/0/ab/1/2/SS/%sec%robot/%fleet%r1/nav/%fleet%r1%get_map/nav_msgs::srv::dds_::GetMap_/{HASH}/2:1:2,:,:,:3,5,0"
    );
    let token = LivelinessToken::parse(&text).unwrap();
    assert_eq!((token.enclave.as_str(), token.namespace.as_str()), ("/sec/robot", "/fleet/r1"));
    let endpoint = token.endpoint.as_ref().unwrap();
    assert_eq!(
        (endpoint.topic.as_str(), endpoint.type_name.to_string().as_str()),
        ("/fleet/r1/get_map", "nav_msgs/srv/GetMap")
    );
    let expected = Qos {
        reliability: Reliability::BestEffort,
        durability: Durability::TransientLocal,
        history: History::KeepAll,
        liveliness: Liveliness::ManualByTopic,
        liveliness_lease: QosDuration { sec: 5, nsec: 0 },
        ..Qos::default()
    };
    assert_eq!(endpoint.qos, expected);
    assert_eq!(token.to_string(), text);
}

#[test]
fn an_empty_depth_is_42_and_older_texts_are_shorter() {
    assert_eq!(Qos::parse("::,:,:,:,,").unwrap(), Qos::default());
    assert_eq!(Qos::default().to_string(), "::,:,:,:,,");
    assert_eq!(Qos::parse("::,0:,:,:,,").unwrap().history, History::KeepLast(42));
    assert_eq!(Qos::parse("2:1:2,10").unwrap().history, History::KeepAll);
    for text in ["", ":", "9::,:,:,:,,", "::,x:,:,:,,", "::,:,:,:,,:", "::,-1:,:,:,,"] {
        assert!(Qos::parse(text).is_err(), "{text}");
    }
}

#[test]
fn tokens_that_are_none_say_which_part_is_wrong() {
    for (text, part) in [
        ("", "prefix"),
        ("@ros2/0", "prefix"),
        ("@ros2_lv/-1/ab/1/2/NN/%/%/n", "domain"),
        ("@ros2_lv/0/ab/x/2/NN/%/%/n", "node id"),
        ("@ros2_lv/0/ab/1/2/XX/%/%/n", "kind"),
        ("@ros2_lv/0/ab/1/2/NN/%//n", "namespace"),
        ("@ros2_lv/0/ab/1/2/MP/%/%/n/%t", "type"),
    ] {
        assert_eq!(LivelinessToken::parse(text).unwrap_err().part, part, "{text}");
    }
}

fn attachment() -> Attachment {
    Attachment { sequence: 7, source_time_ns: 1_763_692_800_123_456_789, gid: *b"0123456789abcdef" }
}

/// As releases before jazzy 0.2.4 have it.
fn labelled() -> Vec<u8> {
    let Attachment { sequence, source_time_ns, gid } = attachment();
    let (sequence, time) = (sequence.to_le_bytes(), source_time_ns.to_le_bytes());
    let parts: [&[u8]; 7] =
        [b"\x0fsequence_number", &sequence, b"\x10source_timestamp", &time, b"\x0asource_gid", b"\x10", &gid];
    parts.concat()
}

#[test]
fn attachments_of_both_layouts_read_and_the_current_one_is_written() {
    let bytes = attachment().to_bytes();
    assert_eq!(bytes[..9], [7, 0, 0, 0, 0, 0, 0, 0, 0x15]);
    assert_eq!(bytes[16..19], [16, b'0', b'1']);
    assert_eq!(Attachment::parse(&bytes).unwrap(), attachment());
    assert_eq!(Attachment::parse(&labelled()).unwrap(), attachment());
    for whole in [bytes.to_vec(), labelled()] {
        for end in 0..whole.len() {
            let error = Attachment::parse(&whole[..end]).unwrap_err();
            assert!(error.length == end && error.byte <= end, "{error}");
        }
    }
    let error = Attachment::parse(&bytes[..20]).unwrap_err();
    assert_eq!((error.field, error.byte), ("source_gid", 16));
}

fn name() -> impl Strategy<Value = String> {
    "(/[a-z_][a-z0-9_]{0,6}){1,3}"
}

fn qos() -> impl Strategy<Value = Qos> {
    let duration = || (0u64..1000, 0u64..1_000_000_000).prop_map(|(sec, nsec)| QosDuration { sec, nsec });
    (any::<[bool; 3]>(), prop::option::of(1u32..99), duration(), duration(), prop::option::of(duration())).prop_map(
        |([best_effort, latched, manual], depth, deadline, lifespan, lease)| Qos {
            reliability: if best_effort { Reliability::BestEffort } else { Reliability::Reliable },
            durability: if latched { Durability::TransientLocal } else { Durability::Volatile },
            history: depth.map_or(History::KeepAll, History::KeepLast),
            deadline,
            lifespan,
            liveliness: if manual { Liveliness::ManualByTopic } else { Liveliness::Automatic },
            liveliness_lease: lease.unwrap_or_default(),
        },
    )
}

proptest! {
    #[test]
    fn what_is_written_reads_back(
        domain in 0u32..232, topic in name(), namespace in name(), node in "[a-z]{1,8}", qos in qos(), ids in any::<[u64; 2]>(),
        hash in any::<[u8; 32]>(), sequence in any::<i64>(), gid in any::<[u8; 16]>(),
    ) {
        let type_hash = TypeHash::Rihs01(hash);
        let key = DataKey::new(domain, &topic, string(), type_hash).unwrap();
        prop_assert_eq!(DataKey::parse(&key.to_string()).unwrap(), key);
        let token = LivelinessToken {
            domain, zid: "ab12".into(), node_id: ids[0], entity_id: ids[1], kind: EntityKind::Subscription, enclave: "/".into(),
            namespace, node, endpoint: Some(Endpoint { topic, type_name: string(), type_hash, qos }),
        };
        prop_assert_eq!(LivelinessToken::parse(&token.to_string()).unwrap(), token);
        let attachment = Attachment { sequence, source_time_ns: -sequence.saturating_abs(), gid };
        prop_assert_eq!(Attachment::parse(&attachment.to_bytes()).unwrap(), attachment);
    }

    #[test]
    fn any_text_never_panics(text in "[-@a-z0-9_/%:,*§ⅷ]{0,80}", tail in "\\PC{0,40}", bytes in prop::collection::vec(any::<u8>(), 0..80)) {
        for text in [text.clone(), format!("@ros2_lv/0/a/1/2/MP/%/%/n/{text}"), format!("0/{text}/{tail}/{tail}"), tail] {
            let _ = (DataKey::parse(&text), LivelinessToken::parse(&text), Qos::parse(&text));
            let _ = (TypeName::parse(&text), text.parse::<TypeHash>());
        }
        let _ = (Attachment::parse(&bytes), Attachment::parse(&[b"\x0fsequence_number", &bytes[..]].concat()));
    }
}
