//! Recordings that others made, of which it is known what is in them (`README.md` of the recorded data).

// Tests may fail by panicking.
#![allow(clippy::unwrap_used, clippy::panic)]

use percept_bags::{Recording, Topic};
use percept_geometry::cloud::Beam;
use percept_ros::{Message, convert, messages as m};
use std::path::Path;

percept_recorded::tests! {
    a_bag_with_a_damaged_index_has_all_its_scans: "bags/scan_tools_demo.bag";
    a_bag_of_poses_is_read_to_its_end: "bags/ROS_example.bag";
    a_robots_drive_has_its_odometry_and_transforms: "bags/nav2_turtlebot.mcap";
    tables_of_transforms_are_read_by_time: "bags/tf_example.db3";
}

fn topic<'a>(recording: &'a Recording, name: &str) -> (usize, &'a Topic) {
    recording
        .topics()
        .iter()
        .enumerate()
        .find(|(_, t)| t.name == name)
        .unwrap_or_else(|| panic!("{:?}", recording.topics()))
}

/// As it was recorded but for padding, in which DDS leaves whatever stood there.
fn assert_same_size_and_value<'a, M: Message<'a>>(message: &M, bytes: &[u8]) {
    let again = message.encode().unwrap();
    assert_eq!(again.len(), bytes.len());
    let num_other = again.iter().zip(bytes).filter(|(ours, theirs)| ours != theirs && **ours != 0).count();
    assert_eq!(num_other, 0, "{}", M::TYPE_NAME);
}

fn a_bag_with_a_damaged_index_has_all_its_scans(data: &Path) {
    let recording = Recording::open(&data.join("bags/scan_tools_demo.bag")).unwrap();
    let (index, scans) = topic(&recording, "/scan");
    assert_eq!((scans.type_name.as_str(), scans.num_messages), ("sensor_msgs/LaserScan", 278));
    let seconds = scans.last.unwrap().seconds_since(scans.first.unwrap());
    assert!((seconds - 27.6).abs() < 0.2, "{seconds}");
    let mut num_hits = 0;
    for message in recording.messages().map(|m| m.unwrap()).filter(|m| m.topic == index) {
        let scan = convert::scan(&m::LaserScan::decode_ros1(&message.bytes).unwrap()).unwrap();
        assert_eq!(scan.ranges_m.len(), 681);
        assert!((scan.angle_increment_rad.to_degrees() - 0.35).abs() < 0.01 && (scan.range_max_m - 5.6).abs() < 1e-3);
        num_hits += (0..681).filter(|&i| matches!(scan.beam(i), Beam::Hit(_))).count();
    }
    assert!(num_hits > 278 * 100, "{num_hits}");
}

fn a_bag_of_poses_is_read_to_its_end(data: &Path) {
    let recording = Recording::open(&data.join("bags/ROS_example.bag")).unwrap();
    assert_eq!(recording.warnings(), []);
    for (name, count) in [("groundtruth", 12765), ("ORB-SLAM", 8362), ("S-PTAM", 5439)] {
        assert_eq!(topic(&recording, name).1.num_messages, count, "{name}");
    }
    let mut last = None;
    for message in recording.messages().map(|m| m.unwrap()) {
        convert::pose(&m::PoseStamped::decode_ros1(&message.bytes).unwrap().pose).unwrap();
        assert!(last <= Some(message.log_time));
        last = Some(message.log_time);
    }
}

fn a_robots_drive_has_its_odometry_and_transforms(data: &Path) {
    let recording = Recording::open(&data.join("bags/nav2_turtlebot.mcap")).unwrap();
    assert_eq!(recording.warnings(), []);
    for (name, count) in [("/odom", 2639), ("/tf", 5422), ("/tf_static", 1), ("/amcl_pose", 135)] {
        let (_, topic) = topic(&recording, name);
        assert_eq!((topic.num_messages, topic.encoding.as_str()), (count, "cdr"), "{name}");
    }
    let names: Vec<&str> = recording.topics().iter().map(|t| t.name.as_str()).collect();
    for message in recording.messages().map(|m| m.unwrap()) {
        match names[message.topic] {
            "/odom" => {
                let odometry = m::Odometry::decode(&message.bytes).unwrap();
                assert!(convert::odometry(&odometry).unwrap().t_odom_base.translation.vector.norm() < 100.0);
                assert_same_size_and_value(&odometry, &message.bytes);
            }
            "/tf" | "/tf_static" => {
                let transforms = m::TFMessage::decode(&message.bytes).unwrap();
                assert!(transforms.transforms.iter().all(|t| convert::transform(&t.transform).is_ok()));
                assert_same_size_and_value(&transforms, &message.bytes);
            }
            "/amcl_pose" => {
                m::PoseWithCovarianceStamped::decode(&message.bytes).unwrap();
            }
            _ => {}
        }
    }
}

fn tables_of_transforms_are_read_by_time(data: &Path) {
    let recording = Recording::open(&data.join("bags/tf_example.db3")).unwrap();
    assert_eq!(recording.warnings(), []);
    let counted: u64 = recording.topics().iter().map(|t| t.num_messages).sum();
    assert_eq!(counted, 518);
    let (_, tf) = topic(&recording, "/tf");
    assert_eq!((tf.type_name.as_str(), tf.encoding.as_str()), ("tf2_msgs/msg/TFMessage", "cdr"));
    let messages: Vec<_> = recording.messages().map(|m| m.unwrap()).collect();
    assert!(messages.len() == 518 && messages.is_sorted_by_key(|m| m.log_time));
    assert_eq!(
        (messages[0].log_time.0, messages[517].log_time.0),
        (1_714_741_164_111_822_142, 1_714_741_215_796_545_476)
    );
    for message in messages {
        assert_same_size_and_value(&m::TFMessage::decode(&message.bytes).unwrap(), &message.bytes);
    }
}
