//! What topics are for: which can be a sensor's, and what belongs together.
//!
//! One set of rules for recordings and for robots that are listened to. Comes in: names, types and messages of topics. Goes out:
//! what each is for ([`Content`]), calibration of images, colour beside depth, mounts on the robot.

use crate::messages::{CameraInfo, CompressedImage, Header, Image, Imu, LaserScan, Odometry, PointCloud2, TFMessage};
use crate::{FrameTree, Message, TypeHash, convert};
use percept_geometry::{CameraIntrinsics, Pose, SensorId, SensorKind, SensorSpec};

/// Colour and depth whose stamps differ by no more belong together, nanoseconds: half of the time between frames at 30 Hz.
pub const PAIR_APART_NS: u64 = 17_000_000;

/// What one topic is for.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// A planar lidar's.
    Scan,
    /// A lidar's, or a depth camera's if its frame is one.
    Cloud,
    /// Depth images.
    Depth {
        /// Whether they come as `CompressedImage`.
        compressed: bool,
        /// Width and height, pixels, where the message tells.
        size: Option<(usize, usize)>,
    },
    /// Colour images, or grey ones; of images, what is supposed until the first message tells.
    Color {
        /// Whether they come as `CompressedImage`.
        compressed: bool,
        /// Width and height, pixels, where the message tells.
        size: Option<(usize, usize)>,
    },
    /// Calibration of the images beside it.
    Calibration {
        /// Of the image as it is taken.
        raw: Option<CameraIntrinsics>,
        /// Of the rectified image.
        rectified: Option<CameraIntrinsics>,
    },
    /// Inertial samples.
    Imu,
    /// Wheels, or what a robot made of them.
    Odometry,
    /// Transforms.
    Transforms,
    /// Nothing that is used.
    Other,
}

/// The hash of our definition of a type that topics are read as; none of others.
pub fn type_hash(type_name: &str) -> Option<TypeHash> {
    Some(match type_name {
        LaserScan::TYPE_NAME => LaserScan::type_hash(),
        PointCloud2::TYPE_NAME => PointCloud2::type_hash(),
        Image::TYPE_NAME => Image::type_hash(),
        CompressedImage::TYPE_NAME => CompressedImage::type_hash(),
        CameraInfo::TYPE_NAME => CameraInfo::type_hash(),
        Imu::TYPE_NAME => Imu::type_hash(),
        Odometry::TYPE_NAME => Odometry::type_hash(),
        TFMessage::TYPE_NAME => TFMessage::type_hash(),
        _ => return None,
    })
}

impl Content {
    /// By the name of the type, of either generation of ROS.
    pub fn of(type_name: &str) -> Self {
        let name = type_name.rsplit('/').next().unwrap_or_default();
        match (type_name.split('/').next().unwrap_or_default(), name) {
            ("sensor_msgs", "LaserScan") => Self::Scan,
            ("sensor_msgs", "PointCloud2") => Self::Cloud,
            ("sensor_msgs", "Image") => Self::Color { compressed: false, size: None },
            ("sensor_msgs", "CompressedImage") => Self::Color { compressed: true, size: None },
            ("sensor_msgs", "CameraInfo") => Self::Calibration { raw: None, rectified: None },
            ("sensor_msgs", "Imu") => Self::Imu,
            ("nav_msgs", "Odometry") => Self::Odometry,
            ("tf2_msgs" | "tf", "TFMessage" | "tfMessage") => Self::Transforms,
            _ => Self::Other,
        }
    }

    /// Whether its messages can be frames that poses are found by.
    pub fn is_sensing(&self) -> bool {
        matches!(self, Self::Scan | Self::Cloud | Self::Depth { .. } | Self::Color { .. })
    }

    /// Whether they are images.
    pub fn is_image(&self) -> bool {
        matches!(self, Self::Depth { .. } | Self::Color { .. })
    }

    /// What is taken rather than others: lidars, then cameras that know distance, then cameras.
    pub fn rank(&self) -> u8 {
        match self {
            Self::Cloud => 0,
            Self::Scan => 1,
            Self::Depth { .. } => 2,
            _ => 3,
        }
    }

    /// The kind of sensor that such messages are of.
    pub fn kind(&self, has_color: bool) -> SensorKind {
        match self {
            Self::Scan => SensorKind::Lidar2d,
            Self::Depth { .. } if has_color => SensorKind::Rgbd,
            Self::Depth { .. } => SensorKind::Depth,
            Self::Color { .. } => SensorKind::Camera,
            Self::Imu => SensorKind::Imu,
            Self::Odometry => SensorKind::Odometry,
            _ => SensorKind::Lidar3d,
        }
    }
}

/// A topic, and what its messages have told so far.
#[derive(Debug, Clone, PartialEq)]
pub struct Topic {
    /// `/robot/scan`.
    pub name: String,
    /// `sensor_msgs/msg/LaserScan`.
    pub type_name: String,
    /// What it is for.
    pub content: Content,
    /// Of the first message's header; empty before it.
    pub frame_id: String,
    /// Of odometry: the frame that moves.
    pub child_frame_id: String,
}

impl Topic {
    /// One of which no message has come.
    pub fn new(name: &str, type_name: &str) -> Self {
        Self {
            name: name.to_owned(),
            type_name: type_name.to_owned(),
            content: Content::of(type_name),
            frame_id: String::new(),
            child_frame_id: String::new(),
        }
    }

    /// The topic as the id of a sensor: `/front/scan` is `front_scan`.
    pub fn sensor_id(&self) -> SensorId {
        sensor_id(&self.name)
    }

    /// Notes the frame of a message.
    pub fn note(&mut self, header: &Header<'_>) {
        if self.frame_id.is_empty() {
            header.frame_id.clone_into(&mut self.frame_id);
        }
    }

    /// Notes whether the images are of depth, and their size.
    pub fn note_image(&mut self, image: &Image<'_>) {
        let size = Some((image.width as usize, image.height as usize));
        let is_depth = matches!(image.encoding, "16UC1" | "32FC1" | "mono16");
        self.content = if is_depth {
            Content::Depth { compressed: false, size }
        } else {
            Content::Color { compressed: false, size }
        };
        self.note(&image.header);
    }

    /// The same of compressed ones, whose size is in the file that they hold.
    pub fn note_compressed(&mut self, image: &CompressedImage<'_>) {
        if image.format.contains("compressedDepth") {
            self.content = Content::Depth { compressed: true, size: None };
        }
        self.note(&image.header);
    }

    /// Notes a calibration, if there is none yet.
    pub fn note_calibration(&mut self, info: &CameraInfo<'_>) {
        if let Content::Calibration { raw, rectified } = &mut self.content
            && raw.is_none()
        {
            *raw = convert::intrinsics(info).ok();
            *rectified = convert::rectified_intrinsics(info).ok();
            info.header.frame_id.clone_into(&mut self.frame_id);
        }
    }

    /// The topic without the ending that image transports add, and without its own name: `/camera/depth` of
    /// `/camera/depth/image_raw/compressedDepth`.
    fn namespace(&self) -> &str {
        let endings = ["/compressedDepth", "/compressed"];
        let topic = endings.iter().find_map(|e| self.name.strip_suffix(e)).unwrap_or(&self.name);
        topic.rsplit_once('/').map_or("", |(space, _)| space)
    }
}

/// A topic as the id of a sensor: `/front/scan` is `front_scan`.
pub fn sensor_id(topic: &str) -> SensorId {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-';
    let name: String =
        topic.trim_start_matches('/').chars().map(|c| if is_plain(c) { c } else { '_' }).take(64).collect();
    SensorId(if name.is_empty() { "sensor".to_owned() } else { name })
}

/// Intrinsics of a topic of images: of the `camera_info` in its namespace, else of one in its frame.
pub fn calibration<'a>(topics: impl Iterator<Item = &'a Topic> + Clone, images: &Topic) -> Option<CameraIntrinsics> {
    let (Content::Depth { size, .. } | Content::Color { size, .. }) = &images.content else { return None };
    let is_rectified = images.name.contains("rect");
    let of = |t: &Topic| match &t.content {
        Content::Calibration { raw, rectified } => {
            let found = if is_rectified { *rectified } else { *raw };
            found.or(*raw).filter(|c| size.is_none_or(|s| s == (c.width, c.height)))
        }
        _ => None,
    };
    let beside = topics.clone().filter(|t| t.namespace() == images.namespace()).find_map(of);
    beside.or_else(|| topics.filter(|t| t.frame_id == images.frame_id).find_map(of))
}

/// Whether depth images are registered to these colour images: both are of one frame and one size.
pub fn is_partner<'a>(topics: impl Iterator<Item = &'a Topic> + Clone, depth: &Topic, color: &Topic) -> bool {
    if !matches!(depth.content, Content::Depth { .. }) || !matches!(color.content, Content::Color { .. }) {
        return false;
    }
    let size = |t| calibration(topics.clone(), t).map(|c| (c.width, c.height));
    color.frame_id == depth.frame_id && size(depth).is_some_and(|s| size(color) == Some(s))
}

/// Whether a cloud is made of a depth camera's images, which say the same in order.
pub fn is_of_depth_camera<'a>(mut topics: impl Iterator<Item = &'a Topic>, cloud: &Topic) -> bool {
    cloud.content == Content::Cloud
        && topics.any(|d| matches!(d.content, Content::Depth { .. }) && d.frame_id == cloud.frame_id)
}

/// Names that a robot's own frame has by REP-105, the usual one first.
const BASES: [&str; 2] = ["base_link", "base_footprint"];

/// The robot's own frame as REP-105 names it, if the transforms have one.
pub fn usual_base(frames: &FrameTree) -> Option<&'static str> {
    BASES.into_iter().find(|base| frames.contains(base))
}

/// Where a sensor sits on the base, and a word where the transforms do not tell: then it is at the base, and a camera looks
/// ahead.
pub fn mount(frames: &FrameTree, base: Option<&str>, topic: &Topic, kind: SensorKind) -> (Pose, Option<String>) {
    if let Some(t_base_sensor) = base.and_then(|base| frames.t_a_b(base, &topic.frame_id)) {
        return (t_base_sensor, None);
    }
    let is_camera = matches!(kind, SensorKind::Depth | SensorKind::Rgbd | SensorKind::Camera);
    let base = base.unwrap_or(BASES[0]);
    let how = if is_camera { ", looking ahead" } else { "" };
    let words =
        format!("no transform from {base} to {}: {} is supposed to sit at the base{how}", topic.frame_id, topic.name);
    let turned = if is_camera { SensorSpec::optical_rotation() } else { nalgebra::UnitQuaternion::identity() };
    (Pose::from_parts(nalgebra::Translation3::identity(), turned), Some(words))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn calibrated(name: &str, frame: &str, [width, height]: [u32; 2]) -> Topic {
        let mut topic = Topic::new(name, "sensor_msgs/msg/CameraInfo");
        let k = [500.0, 0.0, f64::from(width) / 2.0, 0.0, 500.0, f64::from(height) / 2.0, 0.0, 0.0, 1.0];
        let header = Header { frame_id: frame, ..Header::default() };
        topic.note_calibration(&CameraInfo { header, width, height, k, ..CameraInfo::default() });
        topic
    }

    fn images(name: &str, frame: &str, encoding: &str, [width, height]: [u32; 2]) -> Topic {
        let mut topic = Topic::new(name, "sensor_msgs/msg/Image");
        let header = Header { frame_id: frame, ..Header::default() };
        topic.note_image(&Image { header, width, height, encoding, ..Image::default() });
        topic
    }

    #[test]
    fn depth_has_the_colour_of_its_frame_and_size() {
        let depth = images("/camera/aligned_depth/image_raw", "optical", "16UC1", [640, 480]);
        let color = images("/camera/color/image_raw", "optical", "rgb8", [640, 480]);
        let wide = images("/wide/color/image_raw", "optical", "rgb8", [1280, 720]);
        let other = images("/rear/color/image_raw", "rear_optical", "rgb8", [640, 480]);
        let infos = [
            calibrated("/camera/aligned_depth/camera_info", "optical", [640, 480]),
            calibrated("/camera/color/camera_info", "optical", [640, 480]),
            calibrated("/wide/color/camera_info", "optical", [1280, 720]),
            calibrated("/rear/color/camera_info", "rear_optical", [640, 480]),
        ];
        let topics = [&depth, &color, &wide, &other].into_iter().chain(&infos);
        assert_eq!(calibration(topics.clone(), &depth).map(|c| c.width), Some(640));
        assert_eq!(calibration(topics.clone(), &wide).map(|c| c.width), Some(1280));
        let fits: Vec<bool> = [&color, &wide, &other].map(|c| is_partner(topics.clone(), &depth, c)).to_vec();
        assert_eq!(fits, [true, false, false]);
        assert!(!is_partner(topics.clone(), &color, &depth));
        let mut cloud = Topic::new("/camera/points", "sensor_msgs/msg/PointCloud2");
        "optical".clone_into(&mut cloud.frame_id);
        assert!(is_of_depth_camera(topics.clone(), &cloud));
        "lidar".clone_into(&mut cloud.frame_id);
        assert!(!is_of_depth_camera(topics, &cloud));
    }

    #[test]
    fn compressed_images_are_calibrated_by_the_info_beside_them() {
        let mut depth = Topic::new("/camera/depth/image_raw/compressedDepth", "sensor_msgs/msg/CompressedImage");
        let format = "16UC1; compressedDepth png";
        depth.note_compressed(&CompressedImage { format, ..CompressedImage::default() });
        assert_eq!(depth.content, Content::Depth { compressed: true, size: None });
        let info = calibrated("/camera/depth/camera_info", "another", [640, 480]);
        assert!(calibration([&info].into_iter(), &depth).is_some());
        assert_eq!(depth.sensor_id().0, "camera_depth_image_raw_compressedDepth");
    }

    #[test]
    fn what_no_transform_tells_is_supposed_and_said() {
        let mut frames = FrameTree::default();
        frames.insert("base_link", "laser", Pose::translation(0.2, 0.0, 0.1));
        let mut scan = Topic::new("/scan", "sensor_msgs/msg/LaserScan");
        "laser".clone_into(&mut scan.frame_id);
        let base = usual_base(&frames);
        assert_eq!(base, Some("base_link"));
        let (t_base_sensor, words) = mount(&frames, base, &scan, SensorKind::Lidar2d);
        assert_eq!((t_base_sensor.translation.x, words), (0.2, None));
        "other".clone_into(&mut scan.frame_id);
        let (t_base_sensor, words) = mount(&frames, base, &scan, SensorKind::Lidar2d);
        assert_eq!(t_base_sensor, Pose::identity());
        assert_eq!(
            words.as_deref(),
            Some("no transform from base_link to other: /scan is supposed to sit at the base")
        );
    }
}
