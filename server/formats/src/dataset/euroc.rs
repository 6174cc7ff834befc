//! EuRoC MAV recordings: `mav0` with a folder for each sensor.
//!
//! Of several cameras `cam0` is replayed, alone: without another one, lengths are not in its images. `imu0` comes beside it.
//! The base lies in the camera and looks along its optical axis; the body of the files is found by `T_BS`. Truth is
//! `state_groundtruth_estimate0`, or what a motion capture saw. Rows of images that are not there are left out.

use super::files::{Folder, name};
use super::frames::Load;
use super::{Dataset, DatasetKind, OpenOptions, rgbd};
use crate::euroc::{EurocCamera, parse_camera, parse_extrinsics, parse_images, parse_imu, parse_poses};
use crate::{FormatError, Limits, images};
use percept_geometry::{Pose, SensorData, SensorFrame, SensorId, SensorKind, SensorSpec, Stamped, Timestamp};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const CAMERA: &str = "cam0";
const IMU: &str = "imu0";
/// Where poses may lie, the best first: `leica0` has positions alone.
const TRUTH: [&str; 3] = ["state_groundtruth_estimate0", "vicon0", "mocap0"];
/// More than any description of a sensor takes.
const MAX_YAML_BYTES: u64 = 1 << 20;

/// Reads and decodes the camera's images.
#[derive(Debug)]
struct ImageLoader {
    files: Vec<PathBuf>,
    limits: Limits,
}

impl Load for ImageLoader {
    fn sensor(&self) -> SensorId {
        CAMERA.into()
    }

    fn load(&self, index: usize) -> Result<SensorData, FormatError> {
        let path = &self.files[index];
        let bytes = crate::read_file(path, &self.limits)?;
        images::decode_color(&bytes, &self.limits).map(SensorData::Camera).map_err(|e| e.in_file(path))
    }
}

pub(super) fn open(folder: &Folder, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    let inner = folder.path.join("mav0");
    let mav = if inner.is_dir() {
        Folder::list(&inner)?
    } else if folder.path.join("cam0/data.csv").is_file() {
        folder.clone()
    } else {
        return Ok(None);
    };
    let limits = &options.limits;
    let mut notes = vec![];
    let camera = camera(&mav.path.join(CAMERA), limits)?;
    let (stamps, files) = listed(&mav.path.join(CAMERA), limits, &mut notes)?;
    check_size(&mav.path.join(CAMERA), &camera, &files[0], limits)?;
    let t_base_camera = rgbd::t_base_camera();
    let t_base_body = t_base_camera * camera.t_body_camera.inverse();
    let spec = |id: &str, kind, t_base_sensor| SensorSpec {
        id: id.into(),
        kind,
        t_base_sensor,
        intrinsics: (kind == SensorKind::Camera).then_some(camera.intrinsics),
        time_offset_s: 0.0,
        range_max_m: None,
    };
    let mut sensors = vec![spec(CAMERA, SensorKind::Camera, t_base_camera)];
    let mut taken = vec![CAMERA];
    let mut beside = vec![];
    if let Some((t_body_imu, samples)) = inertial(&mav.path.join(IMU), limits, &mut notes)? {
        sensors.push(spec(IMU, SensorKind::Imu, t_base_body * t_body_imu));
        taken.push(IMU);
        beside = samples;
    }
    for sensor in &sensors {
        sensor.validate()?;
    }
    let (source, reference) = truth(&mav.path, t_base_body, limits)?.unzip();
    taken.extend(source);
    for other in mav.folders().iter().map(|path| name(path)).filter(|other| !taken.contains(&other.as_str())) {
        notes.push(if other.starts_with("cam") {
            format!("{other} is not replayed: of several cameras {CAMERA} is")
        } else {
            format!("{other} is not replayed")
        });
    }
    Ok(Some(Dataset {
        name: recording_name(folder),
        kind: DatasetKind::Euroc,
        sensors,
        reference,
        reference_source: source.map(|folder| format!("{folder}/data.csv")),
        relations: None,
        notes,
        topics: vec![],
        about: vec![],
        is_timed: true,
        restamped: BTreeMap::new(),
        stamps: stamps.into(),
        beside: beside.into(),
        source: Arc::new(ImageLoader { files, limits: options.limits }),
    }))
}

/// The recording is called as what `mav0` lies in.
fn recording_name(folder: &Folder) -> String {
    let own = folder.name();
    let parent = folder.path.canonicalize().ok().and_then(|path| path.parent().map(name));
    if own == "mav0" { parent.filter(|name| !name.is_empty()).unwrap_or(own) } else { own }
}

fn yaml(path: &Path, limits: &Limits) -> Result<Vec<u8>, FormatError> {
    crate::read_file(path, &Limits { max_bytes: limits.max_bytes.min(MAX_YAML_BYTES), ..*limits })
}

fn camera(folder: &Path, limits: &Limits) -> Result<EurocCamera, FormatError> {
    let path = folder.join("sensor.yaml");
    parse_camera(&yaml(&path, limits)?).map_err(|e| e.in_file(&path))
}

/// Where a sensor sits on the body, if its folder says so.
fn extrinsics(folder: &Path, limits: &Limits) -> Result<Option<Pose>, FormatError> {
    let path = folder.join("sensor.yaml");
    if !path.exists() {
        return Ok(None);
    }
    parse_extrinsics(&yaml(&path, limits)?).map(Some).map_err(|e| e.in_file(&path))
}

/// Images of the list that are there.
fn listed(
    folder: &Path,
    limits: &Limits,
    notes: &mut Vec<String>,
) -> Result<(Vec<Timestamp>, Vec<PathBuf>), FormatError> {
    let path = folder.join("data.csv");
    let rows = parse_images(&crate::read_file(&path, limits)?, limits).map_err(|e| e.in_file(&path))?;
    let data = folder.join("data");
    let there: BTreeSet<String> = Folder::list(&data)?.files().iter().map(|file| name(file)).collect();
    let num_rows = rows.len();
    let found = rows.into_iter().filter(|row| there.contains(&row.value));
    let (stamps, files): (Vec<_>, Vec<_>) = found.map(|row| (row.stamp, data.join(row.value))).unzip();
    if files.is_empty() {
        return Err(FormatError::Missing { format: "EuRoC", field: "every image of the list" }.in_file(&path));
    }
    if files.len() < num_rows {
        notes.push(format!(
            "{} of {num_rows} images of {CAMERA}/data.csv are not there and left out",
            num_rows - files.len()
        ));
    }
    Ok((stamps, files))
}

/// Whether the description is of images of this size.
fn check_size(folder: &Path, camera: &EurocCamera, first: &Path, limits: &Limits) -> Result<(), FormatError> {
    let bytes = crate::read_file(first, limits)?;
    let image = images::decode_color(&bytes, limits).map_err(|e| e.in_file(first))?;
    let (declared_width, declared_height) = (camera.intrinsics.width, camera.intrinsics.height);
    let (width, height) = (image.width(), image.height());
    if (declared_width, declared_height) == (width, height) {
        return Ok(());
    }
    let error = FormatError::ImageSize { field: "resolution", declared_width, declared_height, width, height };
    Err(error.in_file(&folder.join("sensor.yaml")))
}

/// t_body_imu and the samples, if there is an inertial sensor.
fn inertial(
    folder: &Path,
    limits: &Limits,
    notes: &mut Vec<String>,
) -> Result<Option<(Pose, Vec<SensorFrame>)>, FormatError> {
    if !folder.is_dir() {
        return Ok(None);
    }
    let path = folder.join("data.csv");
    let samples = parse_imu(&crate::read_file(&path, limits)?, limits).map_err(|e| e.in_file(&path))?;
    let t_body_imu = extrinsics(folder, limits)?.unwrap_or_else(|| {
        notes.push(format!("{IMU} has no sensor.yaml: it is supposed to be the body, as EuRoC's is"));
        Pose::identity()
    });
    let frame = |s: Stamped<_>| SensorFrame { sensor: IMU.into(), stamp: s.stamp, data: SensorData::Imu(s.value) };
    Ok(Some((t_body_imu, samples.into_iter().map(frame).collect())))
}

/// A folder's name, and t_world_base.
type Truth = (&'static str, Vec<Stamped<Pose>>);

fn truth(mav: &Path, t_base_body: Pose, limits: &Limits) -> Result<Option<Truth>, FormatError> {
    let Some(source) = TRUTH.into_iter().find(|folder| mav.join(folder).join("data.csv").is_file()) else {
        return Ok(None);
    };
    let folder = mav.join(source);
    let path = folder.join("data.csv");
    let mut poses = parse_poses(&crate::read_file(&path, limits)?, limits).map_err(|e| e.in_file(&path))?;
    let t_body_marker = extrinsics(&folder, limits)?.unwrap_or_else(Pose::identity);
    let t_marker_base = (t_base_body * t_body_marker).inverse();
    poses.iter_mut().for_each(|pose| pose.value *= t_marker_base);
    Ok((!poses.is_empty()).then_some((source, poses)))
}
