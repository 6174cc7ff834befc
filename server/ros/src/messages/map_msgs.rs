//! Changes of maps.

use super::Header;
use crate::cdr::Int8s;

message! {
    /// A rectangle of an occupancy grid that has changed.
    "map_msgs/msg/OccupancyGridUpdate" OccupancyGridUpdate<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// First column.
        x: i32,
        /// First row.
        y: i32,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// The cells, as the grid has them.
        data: Int8s<'a>,
    }
}
