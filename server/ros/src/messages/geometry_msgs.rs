//! Points, poses, transforms and velocities; metres, radians, seconds (REP-103).
//!
//! Covariances are 6 x 6, row-major, in the order x, y, z, rotation about x, y, z.

use super::Header;

message! {
    /// A position, metres.
    #[derive(Copy)]
    "geometry_msgs/msg/Point" Point {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }

    /// A position in a frame.
    #[derive(Copy)]
    "geometry_msgs/msg/PointStamped" PointStamped<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// The position.
        point: Point,
    }

    /// A direction or an amount along three axes.
    #[derive(Copy)]
    "geometry_msgs/msg/Vector3" Vector3 {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }

    /// A rotation.
    #[derive(Copy)]
    "geometry_msgs/msg/Quaternion" Quaternion {
        /// Of i.
        x: f64,
        /// Of j.
        y: f64,
        /// Of k.
        z: f64,
        /// The real part.
        w: f64 = 1.0,
    }

    /// Position and orientation.
    #[derive(Copy)]
    "geometry_msgs/msg/Pose" Pose {
        /// Position.
        position: Point,
        /// Orientation.
        orientation: Quaternion,
    }

    /// A pose in a frame.
    #[derive(Copy)]
    "geometry_msgs/msg/PoseStamped" PoseStamped<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// The pose.
        pose: Pose,
    }

    /// Poses in a frame.
    "geometry_msgs/msg/PoseArray" PoseArray<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// The poses.
        poses: Vec<Pose>,
    }

    /// A pose and how sure it is.
    #[derive(Copy)]
    "geometry_msgs/msg/PoseWithCovariance" PoseWithCovariance {
        /// The pose.
        pose: Pose,
        /// 6 x 6, about the axes of the frame that the pose is in.
        covariance: [f64; 36],
    }

    /// A pose in a frame and how sure it is.
    #[derive(Copy)]
    "geometry_msgs/msg/PoseWithCovarianceStamped" PoseWithCovarianceStamped<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// The pose.
        pose: PoseWithCovariance,
    }

    /// Translation and rotation: child coordinates to parent coordinates.
    #[derive(Copy)]
    "geometry_msgs/msg/Transform" Transform {
        /// Translation, metres.
        translation: Vector3,
        /// Rotation.
        rotation: Quaternion,
    }

    /// Where a child frame lies in the header's frame: `t_parent_child`.
    #[derive(Copy)]
    "geometry_msgs/msg/TransformStamped" TransformStamped<'a> {
        /// When, and the parent frame.
        header: Header<'a>,
        /// The child frame.
        child_frame_id: &'a str,
        /// Child coordinates to parent coordinates.
        transform: Transform,
    }

    /// A velocity.
    #[derive(Copy)]
    "geometry_msgs/msg/Twist" Twist {
        /// m/s.
        linear: Vector3,
        /// rad/s.
        angular: Vector3,
    }

    /// A velocity in a frame.
    #[derive(Copy)]
    "geometry_msgs/msg/TwistStamped" TwistStamped<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// The velocity.
        twist: Twist,
    }

    /// A velocity and how sure it is.
    #[derive(Copy)]
    "geometry_msgs/msg/TwistWithCovariance" TwistWithCovariance {
        /// The velocity.
        twist: Twist,
        /// 6 x 6.
        covariance: [f64; 36],
    }

    /// A velocity in a frame and how sure it is.
    #[derive(Copy)]
    "geometry_msgs/msg/TwistWithCovarianceStamped" TwistWithCovarianceStamped<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// The velocity.
        twist: TwistWithCovariance,
    }

    /// An acceleration.
    #[derive(Copy)]
    "geometry_msgs/msg/Accel" Accel {
        /// m/s^2.
        linear: Vector3,
        /// rad/s^2.
        angular: Vector3,
    }
}
