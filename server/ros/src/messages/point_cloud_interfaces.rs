//! Clouds that a point_cloud_transport plugin has compressed.

use super::{Header, PointField};
use std::borrow::Cow;

message! {
    /// A compressed cloud; all but `compressed_data` and `format` describes the cloud that comes out.
    "point_cloud_interfaces/msg/CompressedPointCloud2" CompressedPointCloud2<'a> {
        /// When, and the frame.
        header: Header<'a>,
        /// Rows.
        height: u32,
        /// Points in a row.
        width: u32,
        /// What a point is made of.
        fields: Vec<PointField<'a>>,
        /// Whether the points' numbers have the highest byte first.
        is_bigendian: bool,
        /// Bytes from a point to the next.
        point_step: u32,
        /// Bytes from a row to the next.
        row_step: u32,
        /// As the plugin wrote it.
        compressed_data: Cow<'a, [u8]>,
        /// Whether all points are finite.
        is_dense: bool,
        /// The plugin: `draco`, `zlib`, `zstd`, `cloudini`.
        format: &'a str,
    }
}
