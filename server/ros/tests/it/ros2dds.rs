//! Keys and tokens of zenoh-plugin-ros2dds, against what it writes.

use percept_ros::rmw_zenoh::{Durability, History, Reliability};
use percept_ros::ros2dds::{RouteKind, RouteQos, RouteToken, data_key};
use proptest::prelude::*;

#[test]
fn data_keys_are_topics_behind_the_bridges_namespace() {
    assert_eq!(data_key("/", "/scan").unwrap(), "scan");
    assert_eq!(data_key("", "lidar/points").unwrap(), "lidar/points");
    assert_eq!(data_key("/bot1", "/tf").unwrap(), "bot1/tf");
    assert!(data_key("bot*", "/tf").is_err() && data_key("", "/").is_err());
}

#[test]
fn a_publishers_token_tells_key_type_and_quality() {
    let text = "@/aac3178e146ba6f1fc6e6a4085e77f21/@ros2_lv/MP/bot1§lidar§points/sensor_msgs§msg§PointCloud2/:1:1:0,5";
    let token = RouteToken::parse(text).unwrap();
    assert_eq!((token.kind, token.key.as_str()), (RouteKind::Publisher, "bot1/lidar/points"));
    assert_eq!(token.type_name.to_string(), "sensor_msgs/msg/PointCloud2");
    let qos = RouteQos {
        is_keyless: true,
        reliability: Some(Reliability::Reliable),
        durability: Some(Durability::TransientLocal),
        history: Some(History::KeepLast(5)),
    };
    assert_eq!(token.qos, Some(qos));
    assert_eq!(token.to_string(), text);
    let older =
        text.replace("@/aac3178e146ba6f1fc6e6a4085e77f21/@ros2_lv", "@ros2_lv/aac3178e146ba6f1fc6e6a4085e77f21");
    assert_eq!(RouteToken::parse(&older).unwrap(), token);
}

#[test]
fn services_and_actions_have_no_quality_and_what_is_not_said_is_none() {
    let token = RouteToken::parse("@/ab/@ros2_lv/AS/navigate/nav2_msgs§action§NavigateToPose").unwrap();
    assert_eq!((token.kind, token.qos), (RouteKind::ActionServer, None));
    let qos = RouteToken::parse("@/ab/@ros2_lv/MS/t/a§msg§B/K:::").unwrap().qos.unwrap();
    assert_eq!(qos, RouteQos { is_keyless: false, reliability: None, durability: None, history: None });
    assert_eq!(
        RouteToken::parse("@/ab/@ros2_lv/MS/t/a§msg§B/::1:1,-1").unwrap().qos.unwrap().history,
        Some(History::KeepAll)
    );
}

#[test]
fn tokens_that_are_none_say_which_part_is_wrong() {
    for (text, part) in [
        ("", "prefix"),
        ("@/ab/@ros2_lv", "key"),
        ("@/ab/@ros2_lv/XX/t/a§msg§B", "kind"),
        ("@/ab/@ros2_lv/MP/t/B", "type"),
        ("@/ab/@ros2_lv/MP/t§/a§msg§B/::", "quality of service"),
    ] {
        assert_eq!(RouteToken::parse(text).unwrap_err().part, part, "{text}");
    }
}

proptest! {
    #[test]
    fn any_text_never_panics(text in "[-@a-zMPS0-9_/:,*§]{0,60}") {
        for text in [text.clone(), format!("@/ab/@ros2_lv/MP/{text}"), format!("@/ab/@ros2_lv/MP/t/a§msg§B/{text}")] {
            if let Ok(token) = RouteToken::parse(&text) {
                let _ = token.to_string();
            }
        }
    }
}
