//! Tiny readers of the recorded sets: just enough for these figures.

use nalgebra::{Matrix4, Point3};
use percept_geometry::{DepthImage, LaserScan, PointCloud, Pose, RgbImage, Timestamp, se3};
use std::path::Path;

pub(crate) type Failure = Box<dyn std::error::Error>;

pub(crate) fn numbers(path: &Path) -> Result<Vec<f64>, Failure> {
    Ok(std::fs::read_to_string(path)?.split_whitespace().filter_map(|w| w.parse().ok()).collect())
}

pub(crate) fn poses_3x4(path: &Path) -> Result<Vec<Pose>, Failure> {
    numbers(path)?.chunks_exact(12).map(pose_3x4).collect()
}

pub(crate) fn pose_3x4(row: &[f64]) -> Result<Pose, Failure> {
    let mut m = Matrix4::identity();
    for (i, v) in row.iter().take(12).enumerate() {
        m[(i / 4, i % 4)] = *v;
    }
    Ok(se3::pose_from_matrix("pose", &m)?)
}

pub(crate) fn depth_png(path: &Path, metres_per_unit: f64) -> Result<DepthImage, Failure> {
    let image = image::open(path)?.into_luma16();
    let (w, h) = (image.width() as usize, image.height() as usize);
    Ok(DepthImage::from_u16(w, h, image.as_raw(), metres_per_unit)?)
}

pub(crate) fn color(path: &Path) -> Result<RgbImage, Failure> {
    let image = image::open(path)?.into_rgb8();
    Ok(RgbImage::new(image.width() as usize, image.height() as usize, image.into_raw())?)
}

fn float(b: &[u8]) -> f32 {
    f32::from_le_bytes([b[0], b[1], b[2], b[3]])
}

/// x y z intensity, 16 bytes a point.
pub(crate) fn kitti_bin(bytes: &[u8]) -> PointCloud {
    PointCloud::from_positions(
        bytes.chunks_exact(16).map(|c| Point3::new(float(c), float(&c[4..]), float(&c[8..]))).collect(),
    )
}

/// A binary PCD of four floats a point; what follows the declared points is padding.
pub(crate) fn pcd_xyzi(path: &Path) -> Result<PointCloud, Failure> {
    let bytes = std::fs::read(path)?;
    let marker = b"DATA binary\n";
    let at = bytes.windows(marker.len()).position(|w| w == marker).ok_or("no DATA line")? + marker.len();
    let header = String::from_utf8_lossy(&bytes[..at]).into_owned();
    let points = header.lines().find_map(|l| l.strip_prefix("POINTS ")).ok_or("no POINTS line")?;
    Ok(kitti_bin(&bytes[at..at + points.trim().parse::<usize>()? * 16]))
}

/// A FLASER row: scan, wheel odometry, stamp.
pub(crate) struct Laser {
    /// Rising in the order of the rows.
    pub(crate) stamp: Timestamp,
    /// As logged: may jump back.
    pub(crate) logged_s: f64,
    pub(crate) scan: LaserScan,
    pub(crate) t_odom_base: Pose,
}

pub(crate) fn carmen(path: &Path, range_max_m: f64) -> Result<Vec<Laser>, Failure> {
    let text = std::fs::read_to_string(path)?;
    let mut out = vec![];
    for line in text.lines().filter(|l| l.starts_with("FLASER")) {
        let f: Vec<f64> = line.split_whitespace().skip(1).map(|w| w.parse().unwrap_or(0.0)).collect();
        let n = f[0] as usize;
        let increment = if n <= 181 { 1f64 } else { 0.5 }.to_radians();
        let scan = LaserScan {
            angle_min_rad: -std::f64::consts::FRAC_PI_2,
            angle_increment_rad: increment,
            range_min_m: 0.05,
            range_max_m,
            time_increment_s: 0.0,
            ranges_m: f[1..=n].iter().map(|&r| r as f32).collect(),
            intensities: None,
            later_echoes_m: vec![],
        };
        let o = &f[n + 4..n + 8];
        out.push(Laser {
            stamp: Timestamp::from_secs_f64(o[3]),
            logged_s: o[3],
            scan,
            t_odom_base: se3::from_xy_yaw(o[0], o[1], o[2]),
        });
    }
    // Rows follow the motion; their stamps are dealt out again in rising order, as a replay does.
    let mut stamps: Vec<Timestamp> = out.iter().map(|r| r.stamp).collect();
    stamps.sort_unstable();
    out.iter_mut().zip(stamps).for_each(|(r, s)| r.stamp = s);
    Ok(out)
}
