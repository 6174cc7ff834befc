//! RGB-D images in folders `color` and `depth`, as Open3D, the Redwood sets and slambook2 lay them out.
//!
//! Source: Open3D 0.18, its reconstruction system; Choi, Zhou, Koltun, "Robust reconstruction of indoor scenes", 2015, for
//! Redwood's `.log`; Gao and Zhang, "Introduction to visual SLAM", 2021, chapter 5, for slambook2.
//! Depth and colour of a frame have the same number, or, where names are no numbers, the same rank. Colour is registered to depth.
//! `camera_intrinsic.json` tells the camera, depth's scale and the rate; what it leaves open is supposed as the sources do, and
//! told in the notes. When images were taken says a `times*.txt` (seconds, a row each); else nobody knows, and they are a second
//! apart, as clouds are. Poses are the camera's: a `pose.txt` with a row each, or a Redwood `.log`, in the order of the images.

use super::clouds::{self, UNTIMED_NS};
use super::files::{self, Folder, name, stem_number};
use super::rgbd::{self, Images, RgbdLoader};
use super::{Dataset, DatasetKind, OpenOptions, stamps};
use crate::open3d::{Open3dCamera, parse_intrinsics};
use crate::text::{Lines, parse};
use crate::{FormatError, Limits, trajectory};
use percept_geometry::{CameraIntrinsics, Pose, Stamped, Timestamp};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

const FORMAT: &str = "RGB-D folders";
/// Depth in millimetres, as both sources have it.
const UNITS_PER_METRE: f64 = 1000.0;
/// More than any calibration takes.
const MAX_JSON_BYTES: u64 = 1 << 20;

pub(super) fn open(folder: &Folder, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    let inner = |names: &[&str]| folder.folders().iter().find(|path| names.contains(&name(path).as_str()));
    let (Some(depth), Some(color)) = (inner(&["depth"]), inner(&["color", "rgb", "image"])) else {
        return Ok(None);
    };
    let depths = Folder::list(depth)?.with_extension(&["png", "pgm"]);
    if depths.is_empty() {
        return Err(FormatError::Missing { format: FORMAT, field: ".png or .pgm of depth" }.in_file(depth));
    }
    refuse_tum(folder, &depths)?;
    let mut images = if options.depth_only {
        depths.into_iter().map(|depth| Images { depth, color: None }).collect()
    } else {
        let colors = Folder::list(color)?.with_extension(&["png", "jpg", "jpeg"]);
        paired(depths, colors).map_err(|e| e.in_file(&folder.path))?
    };
    let mut notes = vec![];
    let truth = truth(folder, &images, &options.limits, &mut notes)?;
    let told = told_camera(folder, &options.limits)?;
    let intrinsics = match &told {
        Some((_, told)) => Some(told.intrinsics),
        None => rgbd::read_intrinsics(folder, &options.limits)?,
    };
    let has_pose_rows = folder.named("pose.txt", "pose.txt").is_some();
    let supposed = if has_pose_rows { slambook2() } else { CameraIntrinsics::primesense() };
    let camera = rgbd::camera(&mut images, intrinsics.unwrap_or(supposed), options)?;
    let size = camera.intrinsics.map(|i| (i.width, i.height)).unwrap_or_default();
    if let Some((path, told)) = &told {
        check_size(&told.intrinsics, size).map_err(|e| e.in_file(path))?;
    }
    if intrinsics.is_none() {
        // Calibrations of other sizes say nothing about these images.
        check_size(&supposed, size).map_err(|_| {
            let field = "camera_intrinsic.json, or camera-intrinsics.txt (fx 0 cx, 0 fy cy, 0 0 1),";
            FormatError::Missing { format: FORMAT, field }.in_file(&folder.path)
        })?;
        notes.push(supposed_camera(&supposed, has_pose_rows));
    }
    let scale = told.as_ref().and_then(|(_, told)| told.depth_scale);
    if scale.is_none() {
        notes.push(
            "nothing tells the unit of depth: millimetres are supposed; depth_scale in camera_intrinsic.json tells it"
                .into(),
        );
    }
    let rate_hz = told.as_ref().and_then(|(_, told)| told.rate_hz);
    let (raw, is_timed) = clock(folder, images.len(), rate_hz, &options.limits, &mut notes)?;
    let rising = stamps::strictly_increasing(&raw);
    let (source, poses) = truth.unzip();
    let at = |(i, t_world_camera): (usize, Pose)| {
        let stamp = rising.get(i).copied()?;
        Some(Stamped { stamp, value: t_world_camera * rgbd::t_base_camera().inverse() })
    };
    Ok(Some(Dataset {
        name: folder.name(),
        kind: DatasetKind::RgbdFolders,
        sensors: vec![camera],
        reference: poses.map(|poses| poses.into_iter().filter_map(at).collect()),
        reference_source: source,
        relations: None,
        notes,
        topics: vec![],
        about: vec![],
        is_timed,
        restamped: stamps::restamped(&raw, &rising),
        stamps: rising.into(),
        beside: Arc::default(),
        source: Arc::new(RgbdLoader {
            images,
            metres_per_unit: 1.0 / scale.unwrap_or(UNITS_PER_METRE),
            limits: options.limits,
        }),
    }))
}

/// TUM's images without TUM's lists: they look alike, but their depth has another unit.
fn refuse_tum(folder: &Folder, depths: &[PathBuf]) -> Result<(), FormatError> {
    let is_stamp = |stem: &str| stem.contains('.') && stem.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    let is_stamped = depths.iter().all(|p| p.file_stem().and_then(|s| s.to_str()).is_some_and(is_stamp));
    if is_stamped || folder.named("associat", ".txt").is_some() {
        let field = "depth.txt, with rgb.txt the list of its images,";
        return Err(FormatError::Missing { format: "TUM RGB-D", field }.in_file(&folder.path));
    }
    Ok(())
}

/// Depth and colour by number if every name is one, else by rank.
fn paired(depths: Vec<PathBuf>, colors: Vec<PathBuf>) -> Result<Vec<Images>, FormatError> {
    let numbers = |files: &[PathBuf]| files.iter().map(|f| stem_number(f)).collect::<Option<Vec<u64>>>();
    let lone = match (numbers(&depths), numbers(&colors)) {
        (Some(of_depth), Some(of_color)) => {
            let alone = |files: &[PathBuf], mine: &[u64], others: &[u64]| {
                let at = mine.iter().position(|number| others.binary_search(number).is_err())?;
                files.get(at).cloned()
            };
            alone(&depths, &of_depth, &of_color).or_else(|| alone(&colors, &of_color, &of_depth))
        }
        _ => None,
    };
    let beyond = || if depths.len() > colors.len() { depths.get(colors.len()) } else { colors.get(depths.len()) };
    if let Some(lone) = lone.as_ref().or_else(beyond) {
        let parent = lone.parent().map(name).unwrap_or_default();
        let (num_color, num_depth, lone) = (colors.len(), depths.len(), format!("{parent}/{}", name(lone)));
        return Err(FormatError::UnpairedImages { num_color, num_depth, lone });
    }
    Ok(depths.into_iter().zip(colors).map(|(depth, color)| Images { depth, color: Some(color) }).collect())
}

/// What a `camera_intrinsic.json` says, under any name that begins with camera or holds intrinsic.
fn told_camera(folder: &Folder, limits: &Limits) -> Result<Option<(PathBuf, Open3dCamera)>, FormatError> {
    let is_it = |path: &&PathBuf| name(path).starts_with("camera") || name(path).contains("intrinsic");
    let Some(path) = folder.with_extension(&["json"]).iter().find(is_it).cloned() else {
        return Ok(None);
    };
    let limits = Limits { max_bytes: limits.max_bytes.min(MAX_JSON_BYTES), ..*limits };
    let told = parse_intrinsics(&crate::read_file(&path, &limits)?).map_err(|e| e.in_file(&path))?;
    Ok(Some((path, told)))
}

/// The camera of slambook2's `joinMap.cpp`.
fn slambook2() -> CameraIntrinsics {
    CameraIntrinsics::pinhole(640, 480, 518.0, 519.0, 325.5, 253.5)
}

fn supposed_camera(camera: &CameraIntrinsics, is_slambook2: bool) -> String {
    let whose = if is_slambook2 { "those of slambook2" } else { "PrimeSense's defaults" };
    let CameraIntrinsics { fx, fy, cx, cy, .. } = camera;
    format!(
        "nothing tells the intrinsics: {whose} are supposed, fx {fx} fy {fy} cx {cx} cy {cy}; a camera_intrinsic.json tells them"
    )
}

fn check_size(told: &CameraIntrinsics, (width, height): (usize, usize)) -> Result<(), FormatError> {
    if (told.width, told.height) == (width, height) {
        return Ok(());
    }
    let (declared_width, declared_height) = (told.width, told.height);
    Err(FormatError::ImageSize { field: "width x height", declared_width, declared_height, width, height })
}

/// Stamps as the folder tells them, and whether it does.
fn clock(
    folder: &Folder,
    num_images: usize,
    rate_hz: Option<f64>,
    limits: &Limits,
    notes: &mut Vec<String>,
) -> Result<(Vec<Timestamp>, bool), FormatError> {
    if let Some(path) = folder.named("times", ".txt") {
        let raw = clouds::times(path, limits)?;
        if raw.len() != num_images {
            let (num_rows, num_expected) = (raw.len(), num_images);
            return Err(FormatError::RowsMismatch { num_rows, num_expected, of: "depth images" }.in_file(path));
        }
        return Ok((raw, true));
    }
    let each = |period_ns: f64| (0..num_images).map(|i| Timestamp((i as f64 * period_ns).round() as i64)).collect();
    match rate_hz {
        Some(rate_hz) => {
            notes
                .push(format!("images are taken for {rate_hz} a second, none left out, as camera_intrinsic.json says"));
            Ok((each(1e9 / rate_hz), true))
        }
        None => Ok((each(UNTIMED_NS as f64), false)),
    }
}

/// A file's name, and t_world_camera of images by their ranks.
type Truth = (String, Vec<(usize, Pose)>);

fn truth(
    folder: &Folder,
    images: &[Images],
    limits: &Limits,
    notes: &mut Vec<String>,
) -> Result<Option<Truth>, FormatError> {
    if let Some(path) = folder.named("pose.txt", "pose.txt") {
        let poses = trajectory::parse_pose_rows(&crate::read_file(path, limits)?).map_err(|e| e.in_file(path))?;
        if poses.len() != images.len() {
            let (num_rows, num_expected) = (poses.len(), images.len());
            return Err(FormatError::RowsMismatch { num_rows, num_expected, of: "depth images" }.in_file(path));
        }
        return Ok(Some((name(path), poses.into_iter().enumerate().collect())));
    }
    let mut logs = vec![];
    for path in folder.with_extension(&["log", "txt"]) {
        let is_trajectory = files::extension(&path) == "log" || name(&path).contains("traj");
        if is_trajectory && is_redwood(&crate::read_file(&path, limits)?) {
            logs.push(path);
        }
    }
    // Odometry drifts: whatever lies beside it is better.
    logs.sort_by_key(|path| name(path).contains("odometry"));
    let Some((path, others)) = logs.split_first() else { return Ok(None) };
    for other in others {
        notes.push(format!("{} is left: the reference is {}", name(other), name(path)));
    }
    let rows = trajectory::parse_redwood(&crate::read_file(path, limits)?).map_err(|e| e.in_file(path))?;
    Ok(Some((name(path), by_image(rows, images).map_err(|e| e.in_file(path))?)))
}

/// Whether a text begins as Redwood's `.log` does: with three whole numbers.
fn is_redwood(bytes: &[u8]) -> bool {
    let Some(line) = Lines::new(FORMAT, bytes).contents().next() else { return false };
    let mut fields = line.fields();
    let tokens: Vec<&[u8]> = std::iter::from_fn(|| fields.token()).take(4).collect();
    tokens.len() == 3 && tokens.iter().all(|token| parse::<i64>(token).is_some())
}

/// Poses by the ranks of images: a row for each, or fewer that name the images by rank, or more that name them by number.
fn by_image(rows: Vec<(u64, Pose)>, images: &[Images]) -> Result<Vec<(usize, Pose)>, FormatError> {
    let mismatch = FormatError::RowsMismatch { num_rows: rows.len(), num_expected: images.len(), of: "depth images" };
    if rows.len() == images.len() {
        return Ok(rows.into_iter().map(|row| row.1).enumerate().collect());
    }
    let ranks: BTreeMap<u64, usize> = if rows.len() < images.len() {
        (0..images.len()).map(|rank| (rank as u64, rank)).collect()
    } else {
        images.iter().enumerate().filter_map(|(rank, i)| Some((stem_number(&i.depth)?, rank))).collect()
    };
    let num_named = rows.len().min(images.len());
    let named: Vec<(usize, Pose)> =
        rows.into_iter().filter_map(|(frame, pose)| Some((*ranks.get(&frame)?, pose))).collect();
    // Each row has an image, or each image a row, and no image has two.
    let found: BTreeMap<usize, Pose> = named.iter().copied().collect();
    let is_told = found.len() == num_named && named.len() == num_named;
    if is_told { Ok(found.into_iter().collect()) } else { Err(mismatch) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn files(names: &[&str]) -> Vec<PathBuf> {
        names.iter().map(|n| Path::new("x").join(n)).collect()
    }

    #[test]
    fn rows_are_for_images_by_rank_or_by_number() {
        let images = |names: &[&str]| -> Vec<Images> {
            files(names).into_iter().map(|depth| Images { depth, color: None }).collect()
        };
        let rows = |frames: &[u64]| frames.iter().map(|&f| (f, Pose::translation(f as f64, 0.0, 0.0))).collect();
        let found = |frames: &[u64], names: &[&str]| {
            let found = by_image(rows(frames), &images(names)).ok()?;
            Some(found.into_iter().map(|(rank, pose)| (rank, pose.translation.x)).collect::<Vec<_>>())
        };
        // A row each, whatever numbers begin with.
        assert_eq!(found(&[0, 1], &["1.png", "2.png"]), Some(vec![(0, 0.0), (1, 1.0)]));
        // Frames that odometry lost.
        assert_eq!(found(&[0, 2], &["5.png", "6.png", "7.png"]), Some(vec![(0, 0.0), (2, 2.0)]));
        // A copy that was thinned out.
        assert_eq!(found(&[0, 1, 2, 3], &["0.png", "3.png"]), Some(vec![(0, 0.0), (1, 3.0)]));
        assert_eq!(found(&[0, 1, 2], &["0.png", "9.png"]), None);
        assert_eq!(found(&[0, 1, 2], &["a.png", "b.png"]), None);
        assert_eq!(found(&[0, 7], &["0.png", "1.png", "2.png"]), None);
        assert_eq!(found(&[0, 1, 0, 1], &["0.png", "1.png"]), None);
        assert_eq!(found(&[1, 1], &["0.png", "1.png", "2.png"]), None);
    }

    #[test]
    fn images_go_together_by_number_or_by_rank() {
        let pairs = |depths: &[&str], colors: &[&str]| paired(files(depths), files(colors));
        assert_eq!(pairs(&["1.png", "02.png"], &["0001.jpg", "2.jpg"]).map(|p| p.len()), Ok(2));
        assert_eq!(pairs(&["a.png", "b.png"], &["x.jpg", "y.jpg"]).map(|p| p.len()), Ok(2));
        let alone = |depths: &[&str], colors: &[&str]| pairs(depths, colors).map(|p| p.len()).unwrap_err().to_string();
        assert!(alone(&["1.png", "2.png"], &["1.jpg", "3.jpg"]).contains("x/2.png has no other"));
        assert!(alone(&["1.png"], &["1.jpg", "3.jpg"]).starts_with("2 colour images for 1 depth images, and x/3.jpg"));
        assert!(alone(&["a.png", "b.png"], &["x.jpg"]).contains("x/b.png"));
    }

    #[test]
    fn a_redwood_log_begins_with_three_whole_numbers() {
        assert!(is_redwood(b"0\t0\t1\n1 0 0 2\n") && is_redwood(b"\n0 -1 5 \r\n"));
        for other in [b"".as_slice(), b"0 0\n", b"0 0 1 2\n", b"0 0.5 1\n", b"FLASER 2 1 2\n"] {
            assert!(!is_redwood(other));
        }
    }
}
