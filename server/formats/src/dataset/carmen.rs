//! CARMEN logs: scans with the odometry of the log, and truth from a corrected log.
//!
//! Of a folder, the first raw log is replayed (`.clf` before others), or the first corrected one if there is no
//! raw one. Rows stay in the order of the file (see `stamps`). A raw log gives odometry: its `ODOM` rows and
//! the odometry pose of each scan. A corrected log gives its poses as truth and no odometry, for its odometry
//! has been overwritten. A corrected log beside a raw one gives truth where its scans are found among the raw
//! ones, reading by reading: its stamps may be rounded to uselessness.

use super::files::{self, Folder, extension};
use super::frames::Load;
use super::{Dataset, DatasetKind, OpenOptions, stamps};
use crate::carmen::{CarmenLog, CarmenRow, CarmenScan, Relation, parse, parse_relations};
use crate::{FormatError, Limits};
use percept_geometry::sensor::OdometrySample;
use percept_geometry::{Pose, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Stamped, Timestamp};
use rustc_hash::FxHashMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const LASER: &str = "laser";
const ODOMETRY: &str = "odometry";

/// How far into a file a first message is looked for.
const SNIFFED_BYTES: u64 = 1 << 18;

#[derive(Debug)]
struct ScanLoader {
    log: CarmenLog,
    /// Row of each scan.
    rows: Vec<usize>,
}

impl Load for ScanLoader {
    fn sensor(&self) -> SensorId {
        LASER.into()
    }

    fn load(&self, index: usize) -> Result<SensorData, FormatError> {
        match &self.log.rows[self.rows[index]].value {
            CarmenRow::Scan(scan) => Ok(SensorData::Scan(self.log.laser_scan(scan))),
            CarmenRow::Odometry(_) => Err(FormatError::Missing { format: "CARMEN", field: "FLASER" }),
        }
    }
}

/// Whether a file looks like a log: by its extension and a message within its first 256 KiB.
pub(super) fn is_log(path: &Path) -> Result<bool, FormatError> {
    if !matches!(extension(path).as_str(), "clf" | "log" | "txt" | "carmen") {
        return Ok(false);
    }
    let mut head = vec![];
    let file = std::fs::File::open(path).map_err(|e| FormatError::io(path, &e))?;
    file.take(SNIFFED_BYTES).read_to_end(&mut head).map_err(|e| FormatError::io(path, &e))?;
    let messages: [&[u8]; 4] = [b"FLASER ", b"ROBOTLASER1 ", b"ODOM ", b"# message_name"];
    Ok(head.split(|&b| b == b'\n').any(|line| messages.iter().any(|m| line.starts_with(m))))
}

pub(super) fn open_folder(folder: &Folder, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    let mut candidates = folder.with_extension(&["clf"]);
    candidates.extend(folder.with_extension(&["log", "carmen", "txt"]));
    let mut logs = vec![];
    for path in candidates {
        if is_log(&path)? {
            logs.push(path);
        }
    }
    let Some(main) = logs.iter().find(|p| !is_corrected(p)).or(logs.first()) else {
        return Ok(None);
    };
    let companion = logs.iter().find(|p| *p != main && is_corrected(p));
    let companion = companion.filter(|_| !is_corrected(main)).cloned();
    let mut dataset = open(main, companion, options)?;
    dataset.name = folder.name();
    Ok(Some(dataset))
}

fn is_corrected(path: &Path) -> bool {
    let name = files::name(path).to_lowercase();
    ["correct", "gfs"].iter().any(|word| name.contains(word))
}

/// A log, with a corrected log of the same drive if there is one.
pub(super) fn open(path: &Path, companion: Option<PathBuf>, options: &OpenOptions) -> Result<Dataset, FormatError> {
    let limits = &options.limits;
    let read = |path: &Path| parse(&crate::read_file(path, limits)?, limits).map_err(|e| e.in_file(path));
    let mut log = read(path)?;
    let corrected = log.corrected || is_corrected(path);
    if corrected {
        log.rows.retain(|row| matches!(row.value, CarmenRow::Scan(_)));
    }
    let raw: Vec<Timestamp> = log.rows.iter().map(|r| r.stamp).collect();
    let row_stamps = stamps::strictly_increasing(&raw);
    let rows: Vec<usize> = log.scans().map(|(row, _)| row).collect();
    let odometry = if corrected { vec![] } else { odometry(&log, &row_stamps) };
    let (reference, reference_source) = if corrected {
        let poses = log.scans().map(|(row, scan)| Stamped { stamp: row_stamps[row], value: scan.t_world_laser });
        (Some(poses.collect()), Some(files::name(path)))
    } else if let Some(companion) = companion {
        let found = matched(&log, &row_stamps, &read(&companion)?);
        ((!found.is_empty()).then_some(found), Some(files::name(&companion)))
    } else {
        (None, None)
    };
    let relations = relations(path, &raw, &row_stamps, &rows, limits)?;
    Ok(Dataset {
        name: files::name(path),
        kind: DatasetKind::Carmen,
        sensors: sensors(&log, corrected),
        reference_source: reference_source.filter(|_| reference.is_some()),
        reference,
        relations,
        notes: vec![],
        topics: vec![],
        about: vec![],
        is_timed: !stamps::are_useless(&raw),
        restamped: stamps::restamped(&raw, &row_stamps),
        stamps: rows.iter().map(|&row| row_stamps[row]).collect(),
        beside: odometry.into(),
        source: Arc::new(ScanLoader { log, rows }),
    })
}

/// The laser, and the odometry if it is delivered. A corrected log has one pose for laser and robot.
fn sensors(log: &CarmenLog, corrected: bool) -> Vec<SensorSpec> {
    let spec = |id: &str, kind, t_base_sensor| SensorSpec {
        id: id.into(),
        kind,
        t_base_sensor,
        intrinsics: None,
        time_offset_s: 0.0,
        range_max_m: None,
    };
    let offset = if corrected { 0.0 } else { log.front_laser_offset_m };
    let mut out = vec![spec(LASER, SensorKind::Lidar2d, Pose::translation(offset, 0.0, 0.0))];
    if !corrected {
        out.push(spec(ODOMETRY, SensorKind::Odometry, Pose::identity()));
    }
    out
}

fn odometry(log: &CarmenLog, row_stamps: &[Timestamp]) -> Vec<SensorFrame> {
    let pose = |row: &CarmenRow| match row {
        CarmenRow::Scan(scan) => scan.t_odom_base,
        CarmenRow::Odometry(t_odom_base) => *t_odom_base,
    };
    let sample = |row: &CarmenRow| OdometrySample { t_odom_base: pose(row), covariance: None };
    let frame = |(row, stamp): (&Stamped<CarmenRow>, &Timestamp)| SensorFrame {
        sensor: ODOMETRY.into(),
        stamp: *stamp,
        data: SensorData::Odometry(sample(&row.value)),
    };
    log.rows.iter().zip(row_stamps).map(frame).collect()
}

/// A scan's readings in millimetres: what survives rewriting with fewer digits.
fn readings(scan: &CarmenScan) -> Vec<i32> {
    scan.ranges_m.iter().map(|r| (r * 1000.0).round() as i32).collect()
}

/// The corrected poses at the stamps of the raw scans with the same readings; doubles are left out.
fn matched(log: &CarmenLog, row_stamps: &[Timestamp], corrected: &CarmenLog) -> Vec<Stamped<Pose>> {
    let mut rows: FxHashMap<Vec<i32>, Option<usize>> = FxHashMap::default();
    for (row, scan) in log.scans() {
        rows.entry(readings(scan)).and_modify(|row| *row = None).or_insert(Some(row));
    }
    let mut out: Vec<Stamped<Pose>> = corrected
        .scans()
        .filter_map(|(_, scan)| {
            let row = rows.get(&readings(scan)).copied().flatten()?;
            Some(Stamped { stamp: row_stamps[row], value: scan.t_world_laser })
        })
        .collect();
    out.sort_by_key(|p| p.stamp);
    out.dedup_by_key(|p| p.stamp);
    out
}

/// The `.relations` beside a log, at the stamps of the frames; rows whose stamps are no scan's are left out.
fn relations(
    path: &Path,
    raw: &[Timestamp],
    row_stamps: &[Timestamp],
    scan_rows: &[usize],
    limits: &Limits,
) -> Result<Option<Vec<Relation>>, FormatError> {
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let Some(path) = Folder::list(parent)?.with_extension(&["relations"]).into_iter().next() else {
        return Ok(None);
    };
    let found = parse_relations(&crate::read_file(&path, limits)?).map_err(|e| e.in_file(&path))?;
    let delivered: FxHashMap<Timestamp, Timestamp> = scan_rows.iter().map(|&r| (raw[r], row_stamps[r])).collect();
    let at_frames = found.into_iter().filter_map(|r| {
        let (stamp_1, stamp_2) = (*delivered.get(&r.stamp_1)?, *delivered.get(&r.stamp_2)?);
        Some(Relation { stamp_1, stamp_2, ..r })
    });
    let out: Vec<Relation> = at_frames.collect();
    Ok((!out.is_empty()).then_some(out))
}
