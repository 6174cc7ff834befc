//! Logs of BreezySLAM: the scans, and the odometry of their wheels. There is no truth. Of a folder the first log is replayed.

use super::files::{self, Folder, extension};
use super::frames::Load;
use super::{Dataset, DatasetKind, OpenOptions, stamps};
use crate::FormatError;
use crate::breezy::{self, BreezyRow, LASER_AHEAD_M};
use percept_geometry::sensor::OdometrySample;
use percept_geometry::{Pose, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Stamped, Timestamp};
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

const LASER: &str = "laser";
const ODOMETRY: &str = "odometry";

/// A row is at most so long: 707 numbers of a few digits.
const SNIFFED_BYTES: u64 = 1 << 14;

#[derive(Debug)]
struct ScanLoader(Vec<Stamped<BreezyRow>>);

impl Load for ScanLoader {
    fn sensor(&self) -> SensorId {
        LASER.into()
    }

    fn load(&self, index: usize) -> Result<SensorData, FormatError> {
        Ok(SensorData::Scan(self.0[index].value.laser_scan()))
    }
}

/// Whether a file looks like a log: by its extension and its first line.
pub(super) fn is_log(path: &Path) -> Result<bool, FormatError> {
    if !matches!(extension(path).as_str(), "dat" | "log" | "txt") {
        return Ok(false);
    }
    let mut head = vec![];
    let file = std::fs::File::open(path).map_err(|e| FormatError::io(path, &e))?;
    file.take(SNIFFED_BYTES).read_to_end(&mut head).map_err(|e| FormatError::io(path, &e))?;
    Ok(head.split(|&b| b == b'\n').next().is_some_and(breezy::is_row))
}

pub(super) fn open_folder(folder: &Folder, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    for path in folder.with_extension(&["dat"]) {
        if is_log(&path)? {
            let mut dataset = open(&path, options)?;
            dataset.name = folder.name();
            return Ok(Some(dataset));
        }
    }
    Ok(None)
}

/// A log.
pub(super) fn open(path: &Path, options: &OpenOptions) -> Result<Dataset, FormatError> {
    let limits = &options.limits;
    let rows = breezy::parse(&crate::read_file(path, limits)?, limits).map_err(|e| e.in_file(path))?;
    let raw: Vec<Timestamp> = rows.iter().map(|row| row.stamp).collect();
    let row_stamps = stamps::strictly_increasing(&raw);
    let odometry = rows.iter().zip(&row_stamps).map(|(row, stamp)| SensorFrame {
        sensor: ODOMETRY.into(),
        stamp: *stamp,
        data: SensorData::Odometry(OdometrySample { t_odom_base: row.value.t_odom_base, covariance: None }),
    });
    let odometry: Vec<SensorFrame> = odometry.collect();
    let spec = |id: &str, kind, t_base_sensor| SensorSpec {
        id: id.into(),
        kind,
        t_base_sensor,
        intrinsics: None,
        time_offset_s: 0.0,
        range_max_m: None,
    };
    Ok(Dataset {
        name: files::name(path),
        kind: DatasetKind::Breezy,
        sensors: vec![
            spec(LASER, SensorKind::Lidar2d, Pose::translation(LASER_AHEAD_M, 0.0, 0.0)),
            spec(ODOMETRY, SensorKind::Odometry, Pose::identity()),
        ],
        reference_source: None,
        reference: None,
        relations: None,
        notes: vec![],
        topics: vec![],
        about: vec![],
        is_timed: !stamps::are_useless(&raw),
        restamped: stamps::restamped(&raw, &row_stamps),
        stamps: row_stamps.into(),
        beside: odometry.into(),
        source: Arc::new(ScanLoader(rows)),
    })
}
