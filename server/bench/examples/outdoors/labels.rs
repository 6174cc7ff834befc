//! KITTI's labels, and which of the labelled things that stand a grid shows.

use crate::{Failure, OCCUPIED};
use nalgebra::{Point2, Point3, Vector2};
use percept_geometry::{Cell, Pose};
use percept_mapping::DenseGrid;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Labelled things farther than this from the way are not asked for, metres, and those that move farther than this are not there.
const NEAR_M: f64 = 30.0;
const STANDS_M: f64 = 0.7;

/// Slower than anybody walks; labels of a parked car far off wander by so much.
const SLOW_M_PER_S: f64 = 0.4;
/// From one label to the next, seconds.
const FRAME_S: f64 = 0.1;

/// A labelled thing in the lidar's frame: the middle of its foot, its heading, length and width.
pub(crate) struct Label {
    pub(crate) frame: usize,
    pub(crate) track: i64,
    pub(crate) class: String,
    pub(crate) at: Point3<f64>,
    pub(crate) yaw: f64,
    pub(crate) size: (f64, f64),
}

/// A label, and where its foot is in the map and how it is turned there.
pub(crate) type Placed<'a> = (&'a Label, Point3<f64>, f64);

/// Tracks of things that do not move, wherever they are: from the first third of their labels to the last they went on by less than
/// [`SLOW_M_PER_S`] on average.
pub(crate) fn stands(labels: &[Label], t_map_frames: &BTreeMap<usize, Pose>) -> BTreeSet<i64> {
    let middle = |seen: &[Placed<'_>]| {
        let num = seen.len() as f64;
        let at = seen.iter().fold(Vector2::zeros(), |sum, s| sum + s.1.xy().coords / num);
        (at, seen.iter().map(|s| s.0.frame as f64 / num).sum::<f64>())
    };
    let is_slow = |seen: &[Placed<'_>]| {
        let third = seen.len().div_ceil(3);
        let ((first, began), (last, ended)) = (middle(&seen[..third]), middle(&seen[seen.len() - third..]));
        (last - first).norm() <= SLOW_M_PER_S * FRAME_S * (ended - began).max(1.0)
    };
    tracks(labels, t_map_frames).into_iter().filter(|(_, seen)| is_slow(seen)).map(|(track, _)| track).collect()
}

fn tracks<'a>(labels: &'a [Label], t_map_frames: &BTreeMap<usize, Pose>) -> BTreeMap<i64, Vec<Placed<'a>>> {
    let mut tracks: BTreeMap<i64, Vec<Placed<'_>>> = BTreeMap::new();
    for label in labels {
        if let Some(t) = t_map_frames.get(&label.frame) {
            let yaw = label.yaw + percept_geometry::se3::yaw(t);
            tracks.entry(label.track).or_default().push((label, t * label.at, yaw));
        }
    }
    tracks
}

/// How far a thing comes from where it was first seen, metres.
fn spread(seen: &[Placed<'_>]) -> f64 {
    seen.iter().map(|s| (s.1 - seen[0].1).xy().norm()).fold(0.0, f64::max)
}

/// A labelled thing counts as told if an object's middle lies so near to where it was labelled last, metres: half of a car's length.
const TOLD_M: f64 = 2.0;

/// By class how many tracks that came within [`NEAR_M`] of the way are among the objects, by whatever name, and how many by their own; of how
/// many. The same object does not count twice.
pub(crate) fn told(
    objects: &[(Point2<f64>, &str)],
    labels: &[Label],
    t_map_frames: &BTreeMap<usize, Pose>,
    way: &[Point2<f64>],
) -> BTreeMap<String, (usize, usize, usize)> {
    let mut out: BTreeMap<String, (usize, usize, usize)> = BTreeMap::new();
    let mut taken = BTreeSet::new();
    for (_, seen) in tracks(labels, t_map_frames) {
        let nearest = |p: &Point3<f64>| way.iter().map(|w| (p.xy() - w).norm()).fold(f64::INFINITY, f64::min);
        let Some((label, at, _)) = seen.iter().rfind(|s| nearest(&s.1) <= NEAR_M) else { continue };
        let off = |i: &usize| (objects[*i].0 - at.xy()).norm();
        let near = (0..objects.len()).filter(|i| !taken.contains(i) && off(i) <= TOLD_M);
        let found = near.min_by(|a, b| off(a).total_cmp(&off(b)));
        let entry = out.entry(label.class.clone()).or_default();
        entry.2 += 1;
        if let Some(i) = found {
            taken.insert(i);
            entry.0 += 1;
            entry.1 += usize::from(
                label.class.eq_ignore_ascii_case(objects[i].1)
                    || label.class == "Pedestrian" && objects[i].1 == "person",
            );
        }
    }
    out
}

/// By class how many tracks that stand the grid shows, of how many, and which not: those with three occupied cells in their box.
pub(crate) fn shown(
    grid: &DenseGrid,
    labels: &[Label],
    t_map_frames: &BTreeMap<usize, Pose>,
    way: &[Point2<f64>],
) -> BTreeMap<String, (usize, usize, Vec<i64>)> {
    let mut out: BTreeMap<String, (usize, usize, Vec<i64>)> = BTreeMap::new();
    for (track, seen) in tracks(labels, t_map_frames) {
        let nearest = |p: &Point3<f64>| way.iter().map(|w| (p.xy() - w).norm()).fold(f64::INFINITY, f64::min);
        let Some((label, at, yaw)) = seen.iter().min_by(|a, b| nearest(&a.1).total_cmp(&nearest(&b.1))) else {
            continue;
        };
        if spread(&seen) > STANDS_M || nearest(at) > NEAR_M {
            continue;
        }
        let (sin, cos) = yaw.sin_cos();
        let inside = |p: Point2<f64>| {
            let d = p - at.xy();
            let (along, across) = (d.x * cos + d.y * sin, d.y * cos - d.x * sin);
            along.abs() <= 0.5 * label.size.0 + 0.1 && across.abs() <= 0.5 * label.size.1 + 0.1
        };
        let occupied = grid.cells.iter().enumerate().filter(|(_, c)| **c >= OCCUPIED).filter(|(i, _)| {
            let cell = Cell::new((i % grid.width) as i32, (i / grid.width) as i32);
            inside(grid.geometry.center(cell))
        });
        let is_shown = occupied.count() >= 3;
        let entry = out.entry(label.class.clone()).or_default();
        entry.0 += usize::from(is_shown);
        entry.1 += 1;
        if !is_shown {
            entry.2.push(track);
        }
    }
    out
}

/// Labels of KITTI's tracking benchmark in the lidar's frame; none where there are none.
pub(crate) fn labels(folder: &Path) -> Result<Vec<Label>, Failure> {
    let (Ok(text), Ok(calibration)) =
        (std::fs::read_to_string(folder.join("label_02.txt")), std::fs::read_to_string(folder.join("calib.txt")))
    else {
        return Ok(vec![]);
    };
    let numbers = |names: [&str; 2]| -> Result<Vec<f64>, Failure> {
        let line =
            calibration.lines().find(|l| names.iter().any(|n| l.starts_with(n))).ok_or("calib.txt lacks a line")?;
        Ok(line.split_whitespace().skip(1).map(str::parse).collect::<Result<_, _>>()?)
    };
    let (r, t) = (numbers(["R_rect", "R0_rect"])?, numbers(["Tr_velo_cam", "Tr_velo_to_cam"])?);
    let rect = nalgebra::Matrix3::from_row_slice(&r[..9]);
    let turn = nalgebra::Matrix3::new(t[0], t[1], t[2], t[4], t[5], t[6], t[8], t[9], t[10]);
    let shift = nalgebra::Vector3::new(t[3], t[7], t[11]);
    let to_lidar = |p: nalgebra::Vector3<f64>| Point3::from(turn.transpose() * (rect.transpose() * p - shift));
    // Frames are counted from the first scan of the folder, labels from that of the drive.
    let mut first = usize::MAX;
    for entry in std::fs::read_dir(folder.join("velodyne"))? {
        let name = entry?.file_name();
        let number = Path::new(&name).file_stem().and_then(|s| s.to_str()?.parse().ok());
        first = first.min(number.unwrap_or(usize::MAX));
    }
    let mut out = vec![];
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        if words.len() < 17 || words[2] == "DontCare" {
            continue;
        }
        let number = |i: usize| words[i].parse::<f64>();
        let at = to_lidar(nalgebra::Vector3::new(number(13)?, number(14)?, number(15)?));
        let heading = number(16)?;
        let ahead =
            to_lidar(nalgebra::Vector3::new(number(13)? + heading.cos(), number(14)?, number(15)? - heading.sin()));
        let yaw = (ahead.y - at.y).atan2(ahead.x - at.x);
        let (width, length) = (number(11)?, number(12)?);
        let frame = words[0].parse::<usize>()?;
        let Some(frame) = frame.checked_sub(if first == usize::MAX { 0 } else { first }) else { continue };
        out.push(Label { frame, track: words[1].parse()?, class: words[2].into(), at, yaw, size: (length, width) });
    }
    Ok(out)
}
