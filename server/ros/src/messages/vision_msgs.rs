//! Detections, as vision_msgs 4 (ROS 2) has them; ROS 1's have other fields.

use super::{Header, Pose, PoseWithCovariance, Vector3};

message! {
    /// A class and its score.
    #[derive(Copy)]
    "vision_msgs/msg/ObjectHypothesis" [ros2] ObjectHypothesis<'a> {
        /// Name or number of the class.
        class_id: &'a str,
        /// Probability or confidence, greater for more likely.
        score: f64,
    }

    /// A class, its score, and where the object would be.
    #[derive(Copy)]
    "vision_msgs/msg/ObjectHypothesisWithPose" [ros2] ObjectHypothesisWithPose<'a> {
        /// Class and score.
        hypothesis: ObjectHypothesis<'a>,
        /// Pose of the object.
        pose: PoseWithCovariance,
    }

    /// A box of any orientation.
    #[derive(Copy)]
    "vision_msgs/msg/BoundingBox3D" BoundingBox3D {
        /// Centre and orientation.
        center: Pose,
        /// Full lengths along its axes, m.
        size: Vector3,
    }

    /// An object that was detected.
    "vision_msgs/msg/Detection3D" [ros2] Detection3D<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// What it may be.
        results: Vec<ObjectHypothesisWithPose<'a>>,
        /// What it takes up.
        bbox: BoundingBox3D,
        /// Identity through time; may be empty.
        id: &'a str,
    }

    /// Objects that were detected.
    "vision_msgs/msg/Detection3DArray" [ros2] Detection3DArray<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// The objects.
        detections: Vec<Detection3D<'a>>,
    }
}
