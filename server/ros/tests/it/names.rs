//! Names of types in their three forms.

use percept_ros::TypeName;

#[test]
fn the_three_forms_name_the_same_type() {
    let name = TypeName::parse("sensor_msgs/msg/PointCloud2").unwrap();
    assert_eq!((name.package(), name.kind(), name.name()), ("sensor_msgs", "msg", "PointCloud2"));
    assert_eq!(name.to_dds(), "sensor_msgs::msg::dds_::PointCloud2_");
    assert_eq!(name.to_ros1(), "sensor_msgs/PointCloud2");
    for text in [name.to_string(), name.to_dds(), name.to_ros1()] {
        assert_eq!(TypeName::parse(&text).unwrap(), name);
    }
    let service = TypeName::parse("nav_msgs::srv::dds_::GetMap_Request_").unwrap();
    assert_eq!(service.to_string(), "nav_msgs/srv/GetMap_Request");
}

#[test]
fn what_is_no_type_is_refused() {
    for text in ["", "PointCloud2", "a//B", "a/msg/B/c", "a::msg::dds_::B", "a/msg/B*", "a/msg/B\u{e9}", "/a/B"] {
        let error = TypeName::parse(text).unwrap_err().to_string();
        assert!(error.contains(&format!("'{text}'")) && error.contains("package/msg/Name"), "{error}");
    }
}
