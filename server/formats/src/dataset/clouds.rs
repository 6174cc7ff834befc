//! PCD and PLY clouds in the natural order of their names.
//!
//! The clouds' frame is taken for a lidar's and the base's: x forward, z up; a file does not say otherwise. When they were
//! taken says a `times*.txt` (seconds, a row each), or a `groundtruth.tum` with a row each, which is the reference then.
//! Both lie among the clouds or beside their folder. Without them nobody knows, and they are delivered a second apart: so
//! long that what a robot may do in between rules out no motion of a real one.

use super::files::{self, Folder, extension};
use super::frames::Load;
use super::{Dataset, DatasetKind, OpenOptions};
use crate::text::Lines;
use crate::{FormatError, Limits, trajectory};
use percept_geometry::{Pose, SensorData, SensorId, SensorKind, SensorSpec, Stamped, Timestamp};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const LIDAR: &str = "lidar";
/// Between clouds of which nobody knows when they were taken: as long as a gap that tracking goes on after. Any shorter and
/// slower scanners drive too fast: a handheld one of two scans a second is off by 0.28 m in 30 if they are 0.1 s apart, and
/// by 0.011 m at 0.2 to 1 s, as with its own stamps.
pub(super) const UNTIMED_NS: i64 = 1_000_000_000;

/// Reads and decodes clouds; points without return are dropped.
#[derive(Debug)]
pub(super) struct CloudLoader {
    pub(super) files: Vec<PathBuf>,
    pub(super) limits: Limits,
}

impl CloudLoader {
    pub(super) fn spec() -> SensorSpec {
        SensorSpec {
            id: LIDAR.into(),
            kind: SensorKind::Lidar3d,
            t_base_sensor: Pose::identity(),
            intrinsics: None,
            time_offset_s: 0.0,
            range_max_m: None,
        }
    }
}

impl Load for CloudLoader {
    fn sensor(&self) -> SensorId {
        LIDAR.into()
    }

    fn load(&self, index: usize) -> Result<SensorData, FormatError> {
        let path = &self.files[index];
        let cloud = crate::read_cloud_file(path, &self.limits)?.cloud;
        let finite = cloud.positions.iter().all(percept_geometry::cloud::is_finite);
        Ok(SensorData::Cloud(if finite { cloud } else { cloud.retain_finite() }))
    }
}

/// A single cloud.
pub(super) fn open_file(path: &Path, options: &OpenOptions) -> Result<Dataset, FormatError> {
    let kind = if extension(path) == "bin" { DatasetKind::Kitti } else { DatasetKind::Clouds };
    Ok(dataset(files::name(path), kind, vec![path.to_owned()], Clock::untimed(1), options))
}

pub(super) fn open_folder(folder: &Folder, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    let files = folder.with_extension(&["pcd", "ply"]);
    if files.is_empty() {
        return Ok(None);
    }
    let clock = match Clock::read(folder, files.len(), &options.limits)? {
        Some(clock) => Some(clock),
        // Beside the folder of the clouds.
        None => match folder.path.canonicalize().ok().as_deref().and_then(Path::parent).map(Folder::list) {
            Some(Ok(parent)) => Clock::read(&parent, files.len(), &options.limits)?,
            _ => None,
        },
    };
    let clock = clock.unwrap_or_else(|| Clock::untimed(files.len()));
    Ok(Some(dataset(folder.name(), DatasetKind::Clouds, files, clock, options)))
}

/// When clouds were taken, and perhaps from where.
struct Clock {
    raw: Vec<Timestamp>,
    is_timed: bool,
    reference: Option<(PathBuf, Vec<Stamped<Pose>>)>,
}

impl Clock {
    fn untimed(num_clouds: usize) -> Self {
        let raw = (0..num_clouds as i64).map(|i| Timestamp(i.saturating_mul(UNTIMED_NS))).collect();
        Self { raw, is_timed: false, reference: None }
    }

    /// What a folder says of clouds that are in it or below it.
    fn read(folder: &Folder, num_clouds: usize, limits: &Limits) -> Result<Option<Self>, FormatError> {
        let truth = match folder.named("groundtruth", ".tum") {
            Some(path) => {
                Some((path, trajectory::parse_tum(&crate::read_file(path, limits)?).map_err(|e| e.in_file(path))?))
            }
            None => None,
        };
        if let Some(path) = folder.named("times", ".txt") {
            let raw = times(path, limits)?;
            if raw.len() != num_clouds {
                let (num_rows, num_expected) = (raw.len(), num_clouds);
                return Err(FormatError::RowsMismatch { num_rows, num_expected, of: "clouds" }.in_file(path));
            }
            let reference = truth.map(|(path, poses)| (path.to_owned(), poses));
            return Ok(Some(Self { raw, is_timed: true, reference }));
        }
        // Truth at other times says nothing of when the clouds were taken.
        Ok(truth.filter(|(_, poses)| poses.len() == num_clouds).map(|(path, poses)| Self {
            raw: poses.iter().map(|pose| pose.stamp).collect(),
            is_timed: true,
            reference: Some((path.to_owned(), poses)),
        }))
    }
}

/// A stamp a row, seconds.
pub(super) fn times(path: &Path, limits: &Limits) -> Result<Vec<Timestamp>, FormatError> {
    let bytes = crate::read_file(path, limits)?;
    let rows = Lines::new("times", &bytes).contents().map(|line| line.fields().stamp("time"));
    rows.collect::<Result<_, _>>().map_err(|e| e.in_file(path))
}

fn dataset(name: String, kind: DatasetKind, files: Vec<PathBuf>, clock: Clock, options: &OpenOptions) -> Dataset {
    let stamps = super::stamps::strictly_increasing(&clock.raw);
    let (path, reference) = clock.reference.unzip();
    Dataset {
        name,
        kind,
        sensors: vec![CloudLoader::spec()],
        reference_source: path.map(|path| files::name(&path)),
        reference,
        relations: None,
        notes: vec![],
        topics: vec![],
        about: vec![],
        is_timed: clock.is_timed,
        restamped: super::stamps::restamped(&clock.raw, &stamps),
        stamps: stamps.into(),
        beside: Arc::default(),
        source: Arc::new(CloudLoader { files, limits: options.limits }),
    }
}
