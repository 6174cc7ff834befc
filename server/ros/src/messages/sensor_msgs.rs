//! What sensors send.

use super::{Header, Quaternion, Vector3};
use std::borrow::Cow;

message! {
    /// One field of a cloud's points.
    #[derive(Copy, Eq)]
    "sensor_msgs/msg/PointField" PointField<'a> {
        /// Its name: `x`, `y`, `z`, `intensity`, `rgb`, …
        name: &'a str,
        /// Bytes from the beginning of a point.
        offset: u32,
        /// 1 to 8: i8, u8, i16, u16, i32, u32, f32, f64.
        datatype: u8,
        /// Number of values.
        count: u32,
    }

    /// Points of any layout.
    "sensor_msgs/msg/PointCloud2" PointCloud2<'a> {
        /// When the first point was taken (as a rule), and the frame.
        header: Header<'a>,
        /// Rows; 1 if the cloud is not organised.
        height: u32,
        /// Points in a row.
        width: u32,
        /// What a point is made of.
        fields: Vec<PointField<'a>>,
        /// Whether the points' numbers (not the message's) have the highest byte first.
        is_bigendian: bool,
        /// Bytes from a point to the next.
        point_step: u32,
        /// Bytes from a row to the next.
        row_step: u32,
        /// The points.
        data: Cow<'a, [u8]>,
        /// Whether all points are finite.
        is_dense: bool,
    }

    /// An image that is not compressed.
    "sensor_msgs/msg/Image" Image<'a> {
        /// When, and the optical frame.
        header: Header<'a>,
        /// Rows.
        height: u32,
        /// Columns.
        width: u32,
        /// `rgb8`, `bgr8`, `mono8`, `16UC1`, `32FC1`, `bayer_rggb8`, `yuv422_yuy2`, …
        encoding: &'a str,
        /// Not 0: the pixels' numbers have the highest byte first.
        is_bigendian: u8,
        /// Bytes from a row to the next.
        step: u32,
        /// The pixels.
        data: Cow<'a, [u8]>,
    }

    /// A compressed image.
    "sensor_msgs/msg/CompressedImage" CompressedImage<'a> {
        /// When, and the optical frame.
        header: Header<'a>,
        /// `jpeg`, `png`, `rgb8; jpeg compressed bgr8`, `16UC1; compressedDepth png`, …
        format: &'a str,
        /// The image file, behind 12 bytes of parameters if the format is `compressedDepth`.
        data: Cow<'a, [u8]>,
    }

    /// A part of an image.
    #[derive(Copy, Eq)]
    "sensor_msgs/msg/RegionOfInterest" RegionOfInterest {
        /// Leftmost column.
        x_offset: u32,
        /// Topmost row.
        y_offset: u32,
        /// Rows; 0 for all.
        height: u32,
        /// Columns; 0 for all.
        width: u32,
        /// Whether a rectified region has to be worked out from it.
        do_rectify: bool,
    }

    /// A camera's calibration. ROS 1 calls the matrices `D`, `K`, `R`, `P`.
    "sensor_msgs/msg/CameraInfo" CameraInfo<'a> {
        /// When, and the optical frame.
        header: Header<'a>,
        /// Rows of the full image.
        height: u32,
        /// Columns of the full image.
        width: u32,
        /// `plumb_bob`, `rational_polynomial`, `equidistant`.
        distortion_model: &'a str,
        /// Distortion by the model.
        d: Vec<f64>,
        /// 3 x 3 intrinsics of the raw image, pixels; all zero if not calibrated.
        k: [f64; 9],
        /// 3 x 3 rectification.
        r: [f64; 9],
        /// 3 x 4 projection of the rectified image, pixels.
        p: [f64; 12],
        /// Columns that are made one; 0 as 1.
        binning_x: u32,
        /// Rows that are made one; 0 as 1.
        binning_y: u32,
        /// What part of the full image the images are, before binning.
        roi: RegionOfInterest,
    }

    /// One sweep of a planar lidar, counter-clockwise about z from x.
    "sensor_msgs/msg/LaserScan" LaserScan<'a> {
        /// When the first beam was taken, and the frame.
        header: Header<'a>,
        /// Angle of the first beam, rad.
        angle_min: f32,
        /// Angle of the last beam, rad.
        angle_max: f32,
        /// Between beams, rad.
        angle_increment: f32,
        /// Between beams, s.
        time_increment: f32,
        /// Between scans, s.
        scan_time: f32,
        /// Least range, m.
        range_min: f32,
        /// Greatest range, m.
        range_max: f32,
        /// Ranges, m: +inf nothing hit, -inf too close, NaN no measurement (REP-117).
        ranges: Vec<f32>,
        /// Intensities, or none.
        intensities: Vec<f32>,
    }

    /// Inertial measurements. A covariance that begins with -1 says that the value before it was not measured; all zero, that
    /// it is unknown.
    #[derive(Copy)]
    "sensor_msgs/msg/Imu" Imu<'a> {
        /// When, and the sensor's frame.
        header: Header<'a>,
        /// Orientation in a world-fixed frame.
        orientation: Quaternion,
        /// 3 x 3, rad^2.
        orientation_covariance: [f64; 9],
        /// rad/s.
        angular_velocity: Vector3,
        /// 3 x 3.
        angular_velocity_covariance: [f64; 9],
        /// m/s^2, with gravity.
        linear_acceleration: Vector3,
        /// 3 x 3.
        linear_acceleration_covariance: [f64; 9],
    }

    /// Joints of a robot; each list has one value a name, or none at all.
    "sensor_msgs/msg/JointState" JointState<'a> {
        /// When.
        header: Header<'a>,
        /// The joints.
        name: Vec<&'a str>,
        /// rad or m.
        position: Vec<f64>,
        /// rad/s or m/s.
        velocity: Vec<f64>,
        /// N m or N.
        effort: Vec<f64>,
    }

    /// How a satellite fix came about.
    #[derive(Copy, Eq)]
    "sensor_msgs/msg/NavSatStatus" NavSatStatus {
        /// -2 unknown, -1 none, 0 fix, 1 with satellite-based, 2 with ground-based augmentation.
        status: i8,
        /// Bits: 1 GPS, 2 GLONASS, 4 Compass, 8 Galileo.
        service: u16,
    }

    /// A satellite fix, WGS 84.
    #[derive(Copy)]
    "sensor_msgs/msg/NavSatFix" NavSatFix<'a> {
        /// When, and the antenna's frame.
        header: Header<'a>,
        /// How it came about.
        status: NavSatStatus,
        /// Degrees, north positive.
        latitude: f64,
        /// Degrees, east positive.
        longitude: f64,
        /// m above the ellipsoid; NaN if there is none.
        altitude: f64,
        /// 3 x 3, m^2: east, north, up.
        position_covariance: [f64; 9],
        /// 0 unknown, 1 approximated, 2 diagonal known, 3 known.
        position_covariance_type: u8,
    }
}
