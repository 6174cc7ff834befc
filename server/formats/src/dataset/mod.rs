//! Recordings for replay: a path in, sensor frames in time order and the truth that is known out.
//!
//! Start with [`open`]. What is recognised:
//! - 7-Scenes: `frame-XXXXXX.depth.png`, `.color.(png|jpg)`, `.pose.txt`, perhaps `camera-intrinsics.txt`;
//! - TUM RGB-D: `depth.txt`, `rgb.txt`, `groundtruth.txt`;
//! - EuRoC MAV: `mav0` with `cam0`, perhaps `imu0` and `state_groundtruth_estimate0`;
//! - Open3D, Redwood, slambook2: folders `color` and `depth` of images, perhaps `camera_intrinsic.json`, a `.log` or a `pose.txt`;
//! - KITTI: a folder `velodyne` of `.bin` or `.pcd`, perhaps `times*.txt`, `poses*.txt`, `calib*.txt`;
//! - CARMEN: a `.clf` or `.log`, or a folder with one, perhaps with a corrected log and a `.relations` beside it;
//! - PCD and PLY: a file, or a folder of them, perhaps with `times*.txt` or `groundtruth*.tum`;
//! - ROS: MCAP, rosbag2 (a `.db3`), bags of ROS 1, or a folder of what one of them was split into, with `metadata.yaml` or without.
//!
//! The base of a recording looks along x: a camera's base is its optical frame turned by
//! [`SensorSpec::optical_rotation`], a lidar's is the lidar itself.

mod breezy;
mod carmen;
mod clouds;
mod euroc;
mod files;
mod frames;
mod image_folders;
mod kitti;
mod rgbd;
mod ros;
mod seven_scenes;
mod stamps;
mod tum;

pub use frames::Frames;

use crate::carmen::Relation;
use crate::{FormatError, Limits};
use files::Folder;
use frames::Load;
use percept_geometry::{Pose, SensorFrame, SensorKind, SensorSpec, Stamped, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// What kind of recording it is; serialised as in the report of a replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum DatasetKind {
    /// 7-Scenes RGB-D.
    #[serde(rename = "7scenes")]
    SevenScenes,
    /// TUM RGB-D.
    #[serde(rename = "tum")]
    Tum,
    /// RGB-D images in folders `color` and `depth`: Open3D, Redwood, slambook2.
    #[serde(rename = "rgbd_folders")]
    RgbdFolders,
    /// EuRoC MAV: a camera and an inertial sensor.
    #[serde(rename = "euroc")]
    Euroc,
    /// KITTI velodyne.
    #[serde(rename = "kitti")]
    Kitti,
    /// CARMEN log of a planar laser.
    #[serde(rename = "carmen")]
    Carmen,
    /// BreezySLAM's log of a planar laser and wheels.
    #[serde(rename = "breezyslam")]
    Breezy,
    /// PCD or PLY clouds.
    #[serde(rename = "clouds")]
    Clouds,
    /// Messages of ROS: MCAP, rosbag2, bags of ROS 1.
    #[serde(rename = "ros")]
    Ros,
}

impl DatasetKind {
    /// The name as it is serialised.
    pub fn name(self) -> &'static str {
        match self {
            Self::SevenScenes => "7scenes",
            Self::Tum => "tum",
            Self::RgbdFolders => "rgbd_folders",
            Self::Euroc => "euroc",
            Self::Kitti => "kitti",
            Self::Carmen => "carmen",
            Self::Breezy => "breezyslam",
            Self::Clouds => "clouds",
            Self::Ros => "ros",
        }
    }
}

impl std::fmt::Display for DatasetKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// How to open a recording.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct OpenOptions {
    /// Leave colour out: frames are `Depth`, and colour is neither read nor decoded.
    pub depth_only: bool,
    /// Of a recording of ROS messages, the topic that poses are found by; none: it is found.
    pub topic: Option<String>,
    /// Of a recording of ROS messages, the robot's own frame; none: `base_link`, `base_footprint`, or what odometry moves.
    pub base_frame: Option<String>,
    /// Largest sizes of single files.
    pub limits: Limits,
}

/// A recording, its frames still on disk.
#[derive(Debug, Clone)]
pub struct Dataset {
    /// The file's or folder's name.
    pub name: String,
    /// What kind it is.
    pub kind: DatasetKind,
    /// The sensors, the primary one first.
    pub sensors: Vec<SensorSpec>,
    /// t_world_base at stamps of the recording, if it is known, in order. The world is the file's own.
    pub reference: Option<Vec<Stamped<Pose>>>,
    /// Where the reference comes from: a file's name.
    pub reference_source: Option<String>,
    /// Relative poses that were checked by hand (CARMEN), at stamps of the frames.
    pub relations: Option<Vec<Relation>>,
    /// What a person who replays it should know: what was taken, what was left, what had to be supposed.
    pub notes: Vec<String>,
    /// Topics of a recording of ROS messages, those that are replayed first: name, type and number of messages, and what comes of it.
    pub topics: Vec<String>,
    /// What percept's own recordings say of the session, names and values, in the order in which it was so.
    pub about: Vec<BTreeMap<String, String>>,
    /// Whether the recording, or its format, says when the frames were taken. If not, they are a second apart.
    pub is_timed: bool,
    /// Stamps of the primary sensor's frames, strictly increasing.
    stamps: Arc<[Timestamp]>,
    /// What the file says instead, where that does not rise.
    restamped: BTreeMap<Timestamp, Timestamp>,
    /// What wheels and inertial sensors say beside the primary sensor, in order.
    beside: Arc<[SensorFrame]>,
    source: Arc<dyn Load>,
}

impl Dataset {
    /// Frames of the primary sensor.
    pub fn len(&self) -> usize {
        self.stamps.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.stamps.is_empty()
    }

    /// Odometry samples beside the primary sensor.
    pub fn num_odometry_samples(&self) -> usize {
        self.beside.iter().filter(|f| f.data.kind() == SensorKind::Odometry).count()
    }

    /// Stamps of the primary sensor's frames, strictly increasing.
    pub fn stamps(&self) -> &[Timestamp] {
        &self.stamps
    }

    /// The file's own stamp of a frame that is delivered with `stamp`: another one where the file's do not rise.
    pub fn recorded_stamp(&self, stamp: Timestamp) -> Timestamp {
        self.restamped.get(&stamp).copied().unwrap_or(stamp)
    }

    /// Whether frames are delivered with other stamps than the file's.
    pub fn is_restamped(&self) -> bool {
        !self.restamped.is_empty()
    }

    /// Seconds from the first to the last frame of the primary sensor.
    pub fn duration_s(&self) -> f64 {
        match (self.stamps.first(), self.stamps.last()) {
            (Some(first), Some(last)) => last.seconds_since(*first),
            _ => 0.0,
        }
    }

    /// The frames in order of their stamps, each read and decoded when it is asked for.
    ///
    /// `range` counts frames of the primary sensor and is cut to those that are there; what is beside it comes along
    /// from after the frame before the range to the range's last frame, and precedes a frame of the same
    /// stamp. A frame that cannot be read is an `Err`, and the next call goes on after it.
    pub fn frames(&self, range: Option<Range<usize>>) -> Frames {
        Frames::new(self.source.clone(), self.stamps.clone(), self.beside.clone(), range)
    }
}

/// Opens a recording with default options; see [`open_with`].
///
/// # Errors
/// As [`open_with`].
pub fn open(path: &Path) -> Result<Dataset, FormatError> {
    open_with(path, &OpenOptions::default())
}

/// Opens a recording: recognises it and reads what is small (stamps, truth, calibration; of CARMEN all).
///
/// A folder that is none itself, but holds folders, stands for the first of them that is one.
///
/// # Errors
/// `Unrecognised`; `Io`; errors of the small files. Each begins with the path of the file or folder that it is about.
pub fn open_with(path: &Path, options: &OpenOptions) -> Result<Dataset, FormatError> {
    let metadata = std::fs::metadata(path).map_err(|e| FormatError::io(path, &e))?;
    let found = if metadata.is_dir() { open_folder(path, options) } else { open_file(path, options) };
    found.map_err(|e| e.in_file(path))?.ok_or_else(|| FormatError::Unrecognised { path: path.to_owned() })
}

fn open_file(path: &Path, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    match files::extension(path).as_str() {
        "pcd" | "ply" | "bin" => clouds::open_file(path, options).map(Some),
        "mcap" | "db3" | "bag" | "zst" | "zstd" => ros::open(path, options).map(Some),
        // What rosbag2 writes beside its files, named for the folder.
        "yaml" if path.file_name().is_some_and(|name| name == "metadata.yaml") => {
            ros::open(path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new(".")), options)
                .map(Some)
        }
        _ if carmen::is_log(path)? => carmen::open(path, None, options).map(Some),
        _ if breezy::is_log(path)? => breezy::open(path, options).map(Some),
        _ => Ok(None),
    }
}

fn open_folder(path: &Path, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    if path.join("metadata.yaml").is_file() {
        return ros::open(path, options).map(Some);
    }
    let folder = Folder::list(path)?;
    if let Some(dataset) = open_listed(&folder, options)? {
        return Ok(Some(dataset));
    }
    // Last: recordings of other kinds come with bags of the same beside them.
    if !folder.with_extension(&["mcap", "db3", "bag", "zstd"]).is_empty() {
        return ros::open(path, options).map(Some);
    }
    for child in folder.folders() {
        if let Some(dataset) = open_listed(&Folder::list(child)?, options)? {
            return Ok(Some(dataset));
        }
    }
    Ok(None)
}

fn open_listed(folder: &Folder, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    let readers = [
        seven_scenes::open,
        tum::open,
        kitti::open,
        euroc::open,
        image_folders::open,
        carmen::open_folder,
        breezy::open_folder,
        clouds::open_folder,
    ];
    for reader in readers {
        if let Some(dataset) = reader(folder, options)? {
            return Ok(Some(dataset));
        }
    }
    Ok(None)
}
