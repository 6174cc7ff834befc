//! PCD and PLY clouds in the natural order of their names, 10 a second.
//!
//! The clouds' frame is taken for a lidar's and the base's: x forward, z up; a file does not say otherwise.

use super::files::{self, Folder, extension};
use super::frames::Load;
use super::{Dataset, DatasetKind, OpenOptions};
use crate::{FormatError, Limits};
use percept_geometry::{Pose, SensorData, SensorId, SensorKind, SensorSpec, Timestamp};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const LIDAR: &str = "lidar";
const PERIOD_NS: i64 = 100_000_000;

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
    Ok(dataset(files::name(path), kind, vec![path.to_owned()], options))
}

pub(super) fn open_folder(folder: &Folder, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    let files = folder.with_extension(&["pcd", "ply"]);
    Ok((!files.is_empty()).then(|| dataset(folder.name(), DatasetKind::Clouds, files, options)))
}

fn dataset(name: String, kind: DatasetKind, files: Vec<PathBuf>, options: &OpenOptions) -> Dataset {
    Dataset {
        name,
        kind,
        sensors: vec![CloudLoader::spec()],
        reference: None,
        reference_source: None,
        relations: None,
        restamped: BTreeMap::new(),
        stamps: (0..files.len() as i64).map(|i| Timestamp(i * PERIOD_NS)).collect(),
        odometry: Arc::default(),
        source: Arc::new(CloudLoader { files, limits: options.limits }),
    }
}
