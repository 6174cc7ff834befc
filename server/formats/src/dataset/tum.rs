//! TUM RGB-D: lists of stamped files, associated by time.
//!
//! Source: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", 2012, and its tools: depth in
//! 1/5000 m registered to colour, depth and colour paired if at most 0.02 s apart, default intrinsics 525, 525,
//! 319.5, 239.5. A frame's stamp is that of its depth; the truth keeps its own stamps.

use super::files::{Folder, name};
use super::rgbd::{self, Images, RgbdLoader};
use super::{Dataset, DatasetKind, OpenOptions};
use crate::text::Lines;
use crate::{FormatError, trajectory};
use percept_geometry::{CameraIntrinsics, Stamped, Timestamp};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Most that depth and colour of a frame may lie apart.
const MAX_DIFFERENCE_NS: u64 = 20_000_000;

pub(super) fn open(folder: &Folder, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    let read = |path: &Path| crate::read_file(path, &options.limits);
    let list = |path: &Path| parse_list(&read(path)?, &folder.path).map_err(|e| e.in_file(path));
    let Some(depth_path) = folder.named("depth", ".txt").filter(|p| name(p) == "depth.txt") else {
        return Ok(None);
    };
    let depths = list(depth_path)?;
    let colors = folder.named("rgb", ".txt").filter(|_| !options.depth_only).map(list).transpose()?;
    let frames = associate(depths, colors);
    let stamps: Vec<Timestamp> = frames.iter().map(|f| f.stamp).collect();
    let mut images: Vec<Images> = frames.into_iter().map(|f| f.value).collect();
    let known = rgbd::read_intrinsics(folder, &options.limits)?;
    let camera = rgbd::camera(&mut images, known.unwrap_or_else(|| default_intrinsics(&folder.name())), options)?;
    let truth_path = folder.named("groundtruth", ".txt");
    let reference = truth_path.map(|path| trajectory::parse_tum(&read(path)?).map_err(|e| e.in_file(path)));
    let reference = reference.transpose()?.map(|mut poses| {
        poses.iter_mut().for_each(|p| p.value *= rgbd::t_base_camera().inverse());
        poses.sort_by_key(|p| p.stamp);
        poses
    });
    Ok(Some(Dataset {
        name: folder.name(),
        kind: DatasetKind::Tum,
        sensors: vec![camera],
        reference,
        reference_source: truth_path.map(name),
        relations: None,
        notes: vec![],
        topics: vec![],
        about: vec![],
        is_timed: true,
        restamped: BTreeMap::new(),
        stamps: stamps.into(),
        beside: Arc::default(),
        source: Arc::new(RgbdLoader { images, metres_per_unit: 1.0 / 5000.0, limits: options.limits }),
    }))
}

/// freiburg3's images are rectified to a calibration of their own; the others' defaults are the benchmark's.
fn default_intrinsics(name: &str) -> CameraIntrinsics {
    if name.contains("freiburg3") {
        CameraIntrinsics::pinhole(640, 480, 535.4, 539.2, 320.1, 247.6)
    } else {
        CameraIntrinsics::primesense()
    }
}

/// Rows `stamp file`, sorted by stamp, one for each stamp.
fn parse_list(bytes: &[u8], folder: &Path) -> Result<Vec<Stamped<PathBuf>>, FormatError> {
    let mut out = vec![];
    for line in Lines::new("TUM list", bytes).contents() {
        let mut fields = line.fields();
        let stamp = fields.stamp("stamp")?;
        let file = fields.required("file")?;
        let file = std::str::from_utf8(file).map_err(|_| line.malformed("file", file, "a path in UTF-8"))?;
        out.push(Stamped { stamp, value: folder.join(file) });
    }
    out.sort_by_key(|s| s.stamp);
    out.dedup_by_key(|s| s.stamp);
    Ok(out)
}

/// Each depth with the colour nearest in time; without a list of colours, depth alone. Depths that have no
/// colour near are left out, as the benchmark's tools do.
fn associate(depths: Vec<Stamped<PathBuf>>, colors: Option<Vec<Stamped<PathBuf>>>) -> Vec<Stamped<Images>> {
    let mut out = vec![];
    for Stamped { stamp, value: depth } in depths {
        let color = match &colors {
            None => None,
            Some(colors) => {
                let at = colors.partition_point(|c| c.stamp < stamp);
                let near = &colors[at.saturating_sub(1)..colors.len().min(at + 1)];
                let difference = |c: &&Stamped<PathBuf>| c.stamp.0.abs_diff(stamp.0);
                match near.iter().min_by_key(difference).filter(|c| difference(c) <= MAX_DIFFERENCE_NS) {
                    None => continue,
                    Some(color) => Some(color.value.clone()),
                }
            }
        };
        out.push(Stamped { stamp, value: Images { depth, color } });
    }
    out
}
