//! The messages, one file a package, each declared once: fields in the order of their definitions.
//!
//! Sources: the `.msg` files of ROS 2's common_interfaces, rcl_interfaces, geometry2, navigation_msgs, vision_msgs and
//! point_cloud_interfaces. A field that only one of ROS 1 and ROS 2 has is marked, and has its initial value when the other is
//! read. Stamps of ROS 1 are unsigned seconds; they are the same bits up to 2038.

// Before the modules that use it: macros are seen in the order of the text.
/// Declares messages: `"package/msg/Name" Name<'a> { field: Type, … }`.
///
/// `[ros1]` or `[ros2]` behind a field's type: it is in that one alone (and what is only in ROS 1 is not in the hash); behind a
/// message's name: the ROS 1 form is not known. `= value`: what the definition gives a field that nobody has set.
macro_rules! message {
    ($(
        $(#[$meta:meta])*
        $ros:literal $([$only:ident])? $name:ident $(<$life:lifetime>)? {
            $($(#[$field_meta:meta])* $field:ident : $type:ty $([$era:ident])? $(= $initial:expr)?),* $(,)?
        }
    )*) => { $(
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name $(<$life>)? {
            $($(#[$field_meta])* pub $field: $type,)*
        }

        impl $(<$life>)? Default for $name $(<$life>)? {
            fn default() -> Self {
                $crate::Wire::initial()
            }
        }

        message!(@wire ($($life)?) $name $ros ($($only)?) { $($field ($type) ($($era)?) ($($initial)?);)* });
    )* };

    (@wire () $name:ident $($rest:tt)*) => { message!(@impl 'de, $name; $($rest)*); };
    (@wire ($life:lifetime) $name:ident $($rest:tt)*) => { message!(@impl $life, $name<$life>; $($rest)*); };

    (@impl $life:lifetime, $self:ty; $ros:literal ($($only:ident)?) {
        $($field:ident ($type:ty) ($($era:ident)?) ($($initial:expr)?);)*
    }) => {
        impl<$life> $crate::Message<$life> for $self {
            const TYPE_NAME: &'static str = $ros;
            const IS_IN_ROS1: bool = message!(@in_ros1 $($only)?);
        }

        impl<$life> $crate::Wire<$life> for $self {
            const LEAST_BYTES: usize = 0 $(+ message!(@least ($type) $($era)?))*;

            fn read(reader: &mut $crate::cdr::Reader<$life>) -> Result<Self, $crate::DecodeError> {
                Ok(Self { $($field: message!(@read reader, stringify!($field), ($($era)?) ($($initial)?)),)* })
            }

            fn write(&self, writer: &mut $crate::cdr::Writer) {
                $(message!(@write writer, &self.$field, $($era)?);)*
            }

            fn num_bytes(&self) -> usize {
                0 $(+ $crate::Wire::num_bytes(&self.$field))*
            }

            fn initial() -> Self {
                Self { $($field: message!(@initial $($initial)?),)* }
            }

            fn describe(definitions: &mut $crate::description::Definitions) -> $crate::description::FieldType {
                let mut fields = Vec::new();
                $(message!(@describe fields, definitions, stringify!($field), ($type) $($era)?);)*
                definitions.insert($ros, fields);
                $crate::description::FieldType::one($crate::description::Base::Nested($ros))
            }

            fn value(&self) -> $crate::Value {
                $crate::Value::Fields(vec![$(
                    ($crate::messages::plain(stringify!($field)), $crate::Wire::value(&self.$field)),
                )*])
            }
        }
    };

    (@in_ros1) => { true };
    (@in_ros1 ros2) => { false };
    (@least ($type:ty)) => { <$type as $crate::Wire>::LEAST_BYTES };
    (@least ($type:ty) $era:ident) => { 0 };
    (@read $reader:ident, $name:expr, () $initial:tt) => { $reader.field($name)? };
    (@read $reader:ident, $name:expr, (ros1) ($($initial:expr)?)) => {
        if $reader.is_ros1() { $reader.field($name)? } else { message!(@initial $($initial)?) }
    };
    (@read $reader:ident, $name:expr, (ros2) ($($initial:expr)?)) => {
        if $reader.is_ros1() { message!(@initial $($initial)?) } else { $reader.field($name)? }
    };
    (@write $writer:ident, $value:expr,) => { $crate::Wire::write($value, $writer) };
    (@write $writer:ident, $value:expr, ros1) => { if $writer.is_ros1() { $crate::Wire::write($value, $writer) } };
    (@write $writer:ident, $value:expr, ros2) => { if !$writer.is_ros1() { $crate::Wire::write($value, $writer) } };
    (@initial) => { $crate::Wire::initial() };
    (@initial $initial:expr) => { $initial };
    (@describe $fields:ident, $definitions:ident, $name:expr, ($type:ty) ros1) => {};
    (@describe $fields:ident, $definitions:ident, $name:expr, ($type:ty) $($era:ident)?) => {
        let field_type = <$type as $crate::Wire>::describe($definitions);
        $fields.push($crate::description::Field { name: $crate::messages::plain($name), field_type });
    };
}

mod builtin_interfaces;
mod geometry_msgs;
mod map_msgs;
mod nav_msgs;
mod point_cloud_interfaces;
mod sensor_msgs;
mod std_msgs;
mod tf2_msgs;
mod vision_msgs;
mod visualization_msgs;

pub use builtin_interfaces::{Duration, Time};
pub use geometry_msgs::{
    Accel, Point, PointStamped, Pose, PoseArray, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped,
    Quaternion, Transform, TransformStamped, Twist, TwistStamped, TwistWithCovariance, TwistWithCovarianceStamped,
    Vector3,
};
pub use map_msgs::OccupancyGridUpdate;
pub use nav_msgs::{MapMetaData, OccupancyGrid, Odometry, Path};
pub use point_cloud_interfaces::CompressedPointCloud2;
pub use sensor_msgs::{
    CameraInfo, CompressedImage, Image, Imu, JointState, LaserScan, NavSatFix, NavSatStatus, PointCloud2, PointField,
    RegionOfInterest,
};
pub use std_msgs::{ColorRGBA, Header};
pub use tf2_msgs::TFMessage;
pub use vision_msgs::{BoundingBox3D, Detection3D, Detection3DArray, ObjectHypothesis, ObjectHypothesisWithPose};
pub use visualization_msgs::{Marker, MarkerArray, MeshFile, UVCoordinate};

/// A field's name as ROS has it: without Rust's mark of a keyword.
fn plain(name: &'static str) -> &'static str {
    name.strip_prefix("r#").unwrap_or(name)
}
