//! Geometry to messages.

use super::ConvertError;
use crate::Message;
use crate::messages::{
    Header, Image, MapMetaData, OccupancyGrid, Path, Point, PointCloud2, PointField, Pose as PoseMessage, PoseStamped,
    Quaternion, Transform, Vector3,
};
use percept_geometry::{Covariance6, DepthImage, GridGeometry, PointCloud, Pose, RgbImage, Stamped, se3};
use std::borrow::Cow;

/// A size as 32 bits have it.
pub(super) fn size(message: &'static str, field: &'static str, value: usize) -> Result<u32, ConvertError> {
    let limit = u64::from(u32::MAX);
    u32::try_from(value).map_err(|_| ConvertError::TooLarge { message, field, value: value as u64, limit })
}

fn orientation(t: &Pose) -> Quaternion {
    let [x, y, z, w] = se3::quaternion_xyzw(t);
    Quaternion { x, y, z, w }
}

/// A transform as a pose.
pub fn pose_message(t_a_b: &Pose) -> PoseMessage {
    let p = t_a_b.translation;
    PoseMessage { position: Point { x: p.x, y: p.y, z: p.z }, orientation: orientation(t_a_b) }
}

/// A transform, `t_parent_child`.
pub fn transform_message(t_parent_child: &Pose) -> Transform {
    let t = t_parent_child.translation;
    Transform { translation: Vector3 { x: t.x, y: t.y, z: t.z }, rotation: orientation(t_parent_child) }
}

/// The covariance of a pose `t_a_b` as ROS has it, row by row: about the axes of frame a. Ours is of a perturbation in frame b.
pub fn pose_covariance(t_a_b: &Pose, covariance: &Covariance6) -> [f64; 36] {
    let turn = t_a_b.rotation.to_rotation_matrix();
    let mut axes = Covariance6::zeros();
    for block in [0, 3] {
        axes.fixed_view_mut::<3, 3>(block, block).copy_from(turn.matrix());
    }
    let about_a = axes * covariance * axes.transpose();
    std::array::from_fn(|i| about_a[(i / 6, i % 6)])
}

/// Poses to go along, in the header's frame.
pub fn path_message<'a>(poses: &[Stamped<Pose>], header: Header<'a>) -> Path<'a> {
    let stamped =
        |p: &Stamped<Pose>| PoseStamped { header: Header::new(p.stamp, header.frame_id), pose: pose_message(&p.value) };
    Path { header, poses: poses.iter().map(stamped).collect() }
}

/// A cloud that is not organised: `x y z`, and `intensity`, `rgb`, `normal_x normal_y normal_z` and `time` (s after the
/// stamp) of the channels that it has, all f32, little endian.
///
/// # Errors
/// `Geometry` for channels of another length, `TooLarge` beyond 32 bits.
pub fn cloud_message<'a>(cloud: &PointCloud, header: Header<'a>) -> Result<PointCloud2<'a>, ConvertError> {
    const MESSAGE: &str = PointCloud2::TYPE_NAME;
    const FLOAT32: u8 = 7;
    cloud.validate().map_err(ConvertError::geometry(MESSAGE))?;
    let channels: [(bool, &[&str]); 5] = [
        (true, &["x", "y", "z"]),
        (cloud.intensities.is_some(), &["intensity"]),
        (cloud.colors.is_some(), &["rgb"]),
        (cloud.normals.is_some(), &["normal_x", "normal_y", "normal_z"]),
        (cloud.time_offsets_s.is_some(), &["time"]),
    ];
    let names = channels.iter().filter(|(is_there, _)| *is_there).flat_map(|(_, names)| *names);
    let fields: Vec<PointField<'a>> =
        (0..).zip(names).map(|(i, name)| PointField { name, offset: i * 4, datatype: FLOAT32, count: 1 }).collect();
    let width = size(MESSAGE, "width", cloud.len())?;
    let point_step = fields.len() * 4;
    let row_step = size(MESSAGE, "row_step", cloud.len().saturating_mul(point_step))?;
    let mut data = Vec::with_capacity(cloud.len() * point_step);
    for (i, p) in cloud.positions.iter().enumerate() {
        data.extend([p.x, p.y, p.z].iter().flat_map(|v| v.to_le_bytes()));
        let intensity = cloud.intensities.as_ref().and_then(|c| c.get(i));
        data.extend(intensity.iter().flat_map(|v| v.to_le_bytes()));
        let color = cloud.colors.as_ref().and_then(|c| c.get(i));
        data.extend(color.iter().flat_map(|[r, g, b]| [*b, *g, *r, 0]));
        let normal = cloud.normals.as_ref().and_then(|c| c.get(i));
        data.extend(normal.iter().flat_map(|n| n.iter()).flat_map(|v| v.to_le_bytes()));
        let time = cloud.time_offsets_s.as_ref().and_then(|c| c.get(i));
        data.extend(time.iter().flat_map(|v| v.to_le_bytes()));
    }
    let is_dense = cloud.positions.iter().all(percept_geometry::cloud::is_finite);
    let point_step = point_step as u32;
    let data = Cow::Owned(data);
    Ok(PointCloud2 { header, height: 1, width, fields, is_bigendian: false, point_step, row_step, data, is_dense })
}

/// An occupancy grid of `width` columns: 0 free to 100 occupied, -1 unknown, the row of the smallest y first.
///
/// # Errors
/// `Invalid` for cells that are no whole rows, `TooLarge` beyond 32 bits.
pub fn grid_message<'a>(
    geometry: &GridGeometry,
    width: usize,
    cells: &[i8],
    header: Header<'a>,
) -> Result<OccupancyGrid<'a>, ConvertError> {
    const MESSAGE: &str = OccupancyGrid::TYPE_NAME;
    if !cells.is_empty() && !cells.len().is_multiple_of(width.max(1)) || width == 0 && !cells.is_empty() {
        let found = format!("{} cells in rows of {width}", cells.len());
        return Err(ConvertError::invalid(MESSAGE, "data", found, "whole rows"));
    }
    let height = cells.len().checked_div(width).unwrap_or(0);
    let position = Point { x: geometry.origin.x, y: geometry.origin.y, z: 0.0 };
    let info = MapMetaData {
        map_load_time: header.stamp,
        resolution: geometry.resolution_m as f32,
        width: size(MESSAGE, "info.width", width)?,
        height: size(MESSAGE, "info.height", height)?,
        origin: PoseMessage { position, orientation: Quaternion::default() },
    };
    Ok(OccupancyGrid { header, info, data: cells.iter().copied().collect() })
}

/// A colour image, `rgb8`.
///
/// # Errors
/// `TooLarge` beyond 32 bits.
pub fn color_message<'a>(image: &'a RgbImage, header: Header<'a>) -> Result<Image<'a>, ConvertError> {
    image_message(header, "rgb8", [image.width(), image.height()], 3, Cow::Borrowed(image.data()))
}

/// A depth image, `32FC1`, metres; no return is 0.
///
/// # Errors
/// `TooLarge` beyond 32 bits.
pub fn depth_message<'a>(image: &DepthImage, header: Header<'a>) -> Result<Image<'a>, ConvertError> {
    let data = image.data().iter().flat_map(|d| d.to_le_bytes()).collect();
    image_message(header, "32FC1", [image.width(), image.height()], 4, Cow::Owned(data))
}

fn image_message<'a>(
    header: Header<'a>,
    encoding: &'a str,
    [width, height]: [usize; 2],
    bytes: usize,
    data: Cow<'a, [u8]>,
) -> Result<Image<'a>, ConvertError> {
    let step = size(Image::TYPE_NAME, "step", width.saturating_mul(bytes))?;
    let width = size(Image::TYPE_NAME, "width", width)?;
    let height = size(Image::TYPE_NAME, "height", height)?;
    Ok(Image { header, height, width, encoding, is_bigendian: 0, step, data })
}
