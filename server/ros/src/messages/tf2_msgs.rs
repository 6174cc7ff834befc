//! Transforms between frames.

use super::TransformStamped;

message! {
    /// Some of the transforms of a tree of frames: each message of `/tf` and `/tf_static` is a part.
    "tf2_msgs/msg/TFMessage" TFMessage<'a> {
        /// The transforms.
        transforms: Vec<TransformStamped<'a>>,
    }
}
