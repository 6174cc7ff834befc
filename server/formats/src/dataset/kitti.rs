//! KITTI velodyne folders: numbered scans, perhaps with gaps, and what may lie beside them.
//!
//! Source: Geiger, Lenz, Urtasun, "Are we ready for autonomous driving?", 2012. Stamps are row `n` of
//! `times*.txt` for file number `n`, or `n / 10` s. Truth is row `n` of `poses*.txt`: with a calibration that
//! has the odometry benchmark's line `Tr:`, the poses are camera 0's and turned to the lidar's by
//! `inv(Tr) * P * Tr`; otherwise, or if the file's name says gicp, lidar or velo, they are the lidar's already.
//!
//! Scans in a folder of that car's (`velodyne`) are its lidar's: 1.73 m above the road, which is base's height, and of
//! 120 m (Geiger, Lenz, Stiller, Urtasun, "Vision meets robotics: The KITTI dataset", 2013, section II and figure 3). Of
//! `*.bin` in any folder nobody knows where it stood: the lidar is base.

use super::clouds::CloudLoader;
use super::files::{Folder, name, stem_number};
use super::{Dataset, DatasetKind, OpenOptions};
use crate::{FormatError, Limits, kitti, trajectory};
use nalgebra::Vector3;
use percept_geometry::{Pose, Stamped, Timestamp};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The scanner's rate.
const PERIOD_NS: i64 = 100_000_000;
/// Height of the car's lidar above the road, and how far it sees, metres.
const CAR_LIDAR_M: f64 = 1.73;
const CAR_RANGE_M: f64 = 120.0;

pub(super) fn open(folder: &Folder, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    let Some((files, is_of_the_car)) = scans(folder)? else {
        return Ok(None);
    };
    let mut lidar = CloudLoader::spec();
    if is_of_the_car {
        lidar.t_base_sensor = Pose::from(Vector3::z() * CAR_LIDAR_M);
        lidar.range_max_m = Some(CAR_RANGE_M);
    }
    let numbers: Vec<usize> = files
        .iter()
        .enumerate()
        .map(|(rank, path)| stem_number(path).and_then(|n| usize::try_from(n).ok()).unwrap_or(rank))
        .collect();
    // Truth and times lie beside the scans' folder, or among the scans.
    let stamps = stamps(folder, &numbers, &options.limits)?;
    let poses_path = poses_path(folder);
    let reference = match &poses_path {
        Some(path) => {
            let to_base = |lidar_moved: Pose| lidar.t_base_sensor * lidar_moved * lidar.t_base_sensor.inverse();
            let moved = reference(folder, path, &numbers, &stamps, &options.limits)?;
            Some(moved.into_iter().map(|m| Stamped { stamp: m.stamp, value: to_base(m.value) }).collect())
        }
        None => None,
    };
    Ok(Some(Dataset {
        name: folder.name(),
        kind: DatasetKind::Kitti,
        sensors: vec![lidar],
        reference_source: poses_path.filter(|_| reference.is_some()).map(|p| name(&p)),
        reference,
        relations: None,
        notes: vec![],
        topics: vec![],
        about: vec![],
        is_timed: true,
        restamped: BTreeMap::new(),
        stamps: stamps.into(),
        beside: Arc::default(),
        source: Arc::new(CloudLoader { files, limits: options.limits }),
    }))
}

/// `velodyne/*`, `velodyne_points/data/*`, which are the car's, or `*.bin` in the folder itself.
fn scans(folder: &Folder) -> Result<Option<(Vec<PathBuf>, bool)>, FormatError> {
    let inner = ["velodyne", "velodyne_points/data"].map(|inner| folder.path.join(inner));
    let inner = inner.iter().find(|path| path.is_dir());
    let files = match inner {
        Some(path) => {
            let inner = Folder::list(path)?;
            let bins = inner.with_extension(&["bin"]);
            if bins.is_empty() { inner.with_extension(&["pcd", "ply"]) } else { bins }
        }
        None => folder.with_extension(&["bin"]),
    };
    Ok((!files.is_empty()).then_some((files, inner.is_some())))
}

fn stamps(folder: &Folder, numbers: &[usize], limits: &Limits) -> Result<Vec<Timestamp>, FormatError> {
    let by_rate =
        || -> Vec<Timestamp> { numbers.iter().map(|&n| Timestamp((n as i64).saturating_mul(PERIOD_NS))).collect() };
    let Some(path) = folder.named("times", ".txt") else {
        return Ok(super::stamps::strictly_increasing(&by_rate()));
    };
    let times = super::clouds::times(path, limits)?;
    let raw = picked(&times, numbers).into_iter().collect::<Option<Vec<_>>>().unwrap_or_else(by_rate);
    Ok(super::stamps::strictly_increasing(&raw))
}

/// Rows by file number; by rank if there are exactly as many rows as files, and numbers go beyond them.
fn picked<T: Copy>(rows: &[T], numbers: &[usize]) -> Vec<Option<T>> {
    let by_rank = rows.len() == numbers.len() && numbers.iter().any(|&n| n >= rows.len());
    numbers.iter().enumerate().map(|(rank, &n)| rows.get(if by_rank { rank } else { n }).copied()).collect()
}

fn poses_path(folder: &Folder) -> Option<PathBuf> {
    folder.named("poses", ".txt").map(Path::to_owned)
}

/// Poses of the lidar in its first frame.
fn reference(
    folder: &Folder,
    path: &Path,
    numbers: &[usize],
    stamps: &[Timestamp],
    limits: &Limits,
) -> Result<Vec<Stamped<Pose>>, FormatError> {
    let poses = trajectory::parse_kitti(&crate::read_file(path, limits)?).map_err(|e| e.in_file(path))?;
    let t_cam0_lidar = if in_lidar_frame(path) { None } else { calibration(folder, limits)? };
    let to_lidar = |pose: Pose| t_cam0_lidar.map_or(pose, |t| t.inverse() * pose * t);
    let rows = picked(&poses, numbers).into_iter().zip(stamps);
    Ok(rows.filter_map(|(pose, &stamp)| pose.map(|pose| Stamped { stamp, value: to_lidar(pose) })).collect())
}

fn in_lidar_frame(path: &Path) -> bool {
    let name = name(path).to_lowercase();
    ["gicp", "lidar", "velo"].iter().any(|word| name.contains(word))
}

fn calibration(folder: &Folder, limits: &Limits) -> Result<Option<Pose>, FormatError> {
    for path in folder.files().iter().filter(|p| name(p).starts_with("calib") && name(p).ends_with(".txt")) {
        let found = kitti::parse_calibration(&crate::read_file(path, limits)?).map_err(|e| e.in_file(path))?;
        if found.is_some() {
            return Ok(found);
        }
    }
    Ok(None)
}
