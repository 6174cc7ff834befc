//! Odometry, paths and occupancy grids.

use super::{Header, Pose, PoseStamped, PoseWithCovariance, Time, TwistWithCovariance};
use crate::cdr::Int8s;

message! {
    /// Where a robot is and how it moves, as it has counted.
    #[derive(Copy)]
    "nav_msgs/msg/Odometry" Odometry<'a> {
        /// When, and the frame of the pose.
        header: Header<'a>,
        /// The frame whose pose it is, and of the velocity.
        child_frame_id: &'a str,
        /// Child in the header's frame.
        pose: PoseWithCovariance,
        /// In the child's frame.
        twist: TwistWithCovariance,
    }

    /// Poses to go along.
    "nav_msgs/msg/Path" Path<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// The poses.
        poses: Vec<PoseStamped<'a>>,
    }

    /// Where an occupancy grid lies.
    #[derive(Copy)]
    "nav_msgs/msg/MapMetaData" MapMetaData {
        /// When the map was loaded.
        map_load_time: Time,
        /// Edge of a cell, m.
        resolution: f32,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// The lower-left corner of cell (0, 0) in the map's frame.
        origin: Pose,
    }

    /// An occupancy grid.
    "nav_msgs/msg/OccupancyGrid" OccupancyGrid<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// Where it lies.
        info: MapMetaData,
        /// H x W, the row of the smallest y first: 0 free to 100 occupied, -1 unknown.
        data: Int8s<'a>,
    }
}
