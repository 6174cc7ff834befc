//! 7-Scenes: numbered triples of depth, colour and pose.
//!
//! Source: Shotton et al., "Scene coordinate regression forests for camera relocalization in RGB-D images",
//! 2013. Depth is millimetres; frames were taken at 30 Hz, so that frame `n` has the stamp `n / 30` s, and a
//! thinned-out copy keeps its times. Depth and colour come from two cameras and are not registered by the
//! source; they are delivered as `Rgbd` all the same, a few pixels apart. The poses are the depth camera's.

use super::files::{Folder, name};
use super::rgbd::{self, Images, RgbdLoader};
use super::{Dataset, DatasetKind, OpenOptions};
use crate::{FormatError, trajectory};
use percept_geometry::{CameraIntrinsics, Stamped, Timestamp};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[derive(Debug, Default)]
struct Triple {
    depth: Option<PathBuf>,
    color: Option<PathBuf>,
    pose: Option<PathBuf>,
}

pub(super) fn open(folder: &Folder, options: &OpenOptions) -> Result<Option<Dataset>, FormatError> {
    let mut triples: BTreeMap<u64, Triple> = BTreeMap::new();
    for path in folder.files() {
        let Some((number, part)) = parse_name(path) else { continue };
        let triple = triples.entry(number).or_default();
        match part.as_str() {
            "depth.png" => triple.depth = Some(path.clone()),
            "color.png" | "color.jpg" | "color.jpeg" => triple.color = Some(path.clone()),
            "pose.txt" => triple.pose = Some(path.clone()),
            _ => {}
        }
    }
    triples.retain(|_, triple| triple.depth.is_some());
    if triples.is_empty() {
        return Ok(None);
    }
    let (mut images, mut stamps, mut reference) = (vec![], vec![], vec![]);
    for (number, Triple { depth, color, pose }) in triples {
        let stamp = stamp(number);
        stamps.push(stamp);
        images.extend(depth.map(|depth| Images { depth, color }));
        if let Some(path) = pose {
            let t_world_camera = trajectory::parse_matrix(&crate::read_file(&path, &options.limits)?);
            let t_world_camera = t_world_camera.map_err(|e| e.in_file(&path))?;
            let value = t_world_camera.map(|t| t * rgbd::t_base_camera().inverse());
            reference.extend(value.map(|value| Stamped { stamp, value }));
        }
    }
    // Microsoft's own figures for the Kinect's depth camera.
    let default = CameraIntrinsics::pinhole(640, 480, 585.0, 585.0, 320.0, 240.0);
    let intrinsics = rgbd::read_intrinsics(folder, &options.limits)?.unwrap_or(default);
    let camera = rgbd::camera(&mut images, intrinsics, options)?;
    let has_reference = !reference.is_empty();
    Ok(Some(Dataset {
        name: folder.name(),
        kind: DatasetKind::SevenScenes,
        sensors: vec![camera],
        reference: has_reference.then_some(reference),
        reference_source: has_reference.then(|| "pose.txt".to_owned()),
        relations: None,
        notes: vec![],
        topics: vec![],
        about: vec![],
        is_timed: true,
        restamped: BTreeMap::new(),
        stamps: stamps.into(),
        beside: Arc::default(),
        source: Arc::new(RgbdLoader { images, metres_per_unit: 0.001, limits: options.limits }),
    }))
}

/// `frame-000012.depth.png` is 12 and `depth.png`.
fn parse_name(path: &Path) -> Option<(u64, String)> {
    let name = name(path).to_lowercase();
    let (number, part) = name.strip_prefix("frame-")?.split_once('.')?;
    Some((number.parse().ok().filter(|&n: &u64| n < 1 << 40)?, part.to_owned()))
}

/// Frame `n` of 30 Hz, rounded to the nanosecond.
fn stamp(number: u64) -> Timestamp {
    let nanos = (u128::from(number) * 1_000_000_000 + 15) / 30;
    Timestamp(i64::try_from(nanos).unwrap_or(i64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_stamps() {
        assert_eq!(parse_name(Path::new("a/frame-000012.depth.png")), Some((12, "depth.png".to_owned())));
        assert_eq!(parse_name(Path::new("frame-x.depth.png")), None);
        assert_eq!(stamp(30), Timestamp(1_000_000_000));
        assert_eq!(stamp(2), Timestamp(66_666_667));
    }
}
