//! Objects of single lidar scans against KITTI's labels: `objects PATH [--frames A..B] [--list] [--pictures FOLDER]
//! [--set KEY=VALUE]...`, and `objects train PATH [--frames A..B]`, which trains the detector's model.
//!
//! PATH is a folder of KITTI's tracking benchmark (`label_02.txt`) or of its object benchmark (`label_2/`). A labelled
//! thing with at least ten points is to be found: its box overlaps a found one by a quarter of the union in space, and
//! by half seen from above. Precision is that of what was given a class, within 40 m and where the camera sees it, but
//! for what is labelled `DontCare` or has too few points. Recall is told of everything found and of what was given a
//! class. Tracks are followed by the scene's tracker with the poses of the folder (`poses_reference_gicp.txt`), else
//! with those that a session estimates from the scans.

mod inserted;
mod picture;
mod score;
mod train;
mod truth;

use percept_formats::dataset;
use percept_geometry::{Pose, SensorData};
use percept_perception::detection::Detection;
use percept_perception::detection::outdoor::{OutdoorDetector, OutdoorParams};
use percept_pipeline::{Pipeline, PipelineParams, Preset};
use percept_scene::TrackerParams;
use std::error::Error;
use std::ops::Range;
use std::path::Path;

pub(crate) type Failure = Box<dyn Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let is_training = args.first().is_some_and(|a| a == "train");
    let usage = "usage: objects [train] PATH [--frames A..B] [--list] [--pictures FOLDER] [--set KEY=VALUE]...";
    let path = Path::new(args.get(usize::from(is_training)).ok_or(usage)?);
    let after = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let range = after("--frames").map_or(Ok(0..usize::MAX), |r| parse_range(r).ok_or("--frames: write A..B"))?;
    let frames = truth::frames(path, range)?;
    if is_training {
        return train::train(&frames);
    }
    let mut tree = serde_json::to_value(OutdoorParams::default())?;
    for (i, _) in args.iter().enumerate().filter(|(_, a)| *a == "--set") {
        let (key, value) = args.get(i + 1).and_then(|a| a.split_once('=')).ok_or("--set: write KEY=VALUE")?;
        let slot = tree.pointer_mut(&format!("/{}", key.replace('.', "/"))).ok_or("--set: no such parameter")?;
        *slot = serde_json::from_str(value)?;
    }
    let detector = OutdoorDetector::new(serde_json::from_value(tree)?)?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let (mut score, mut all, mut ms) = (score::Score::default(), vec![], vec![]);
    score.lists = args.iter().any(|a| a == "--list");
    for frame in &frames {
        let (found, taken) = pool.install(|| {
            let before = processor_ms();
            (detector.detect(&frame.scan), processor_ms() - before)
        });
        ms.push(taken);
        let found: Vec<Detection> = found?;
        score.add(frame, &found);
        if let Some(folder) = after("--pictures") {
            std::fs::create_dir_all(folder)?;
            picture::draw(frame, &found, &Path::new(folder).join(format!("{:06}.png", frame.number)))?;
        }
        all.push(found);
    }
    println!("{}:", path.display());
    score.print(ms);
    if path.join("label_02.txt").exists() {
        score::track(&frames, &all, &poses(path, &frames)?, &TrackerParams::default())?;
    }
    Ok(())
}

fn parse_range(text: &str) -> Option<Range<usize>> {
    let (from, to) = text.split_once("..")?;
    Some(from.parse().ok()?..to.parse().ok()?)
}

/// Lidar to map at each frame.
fn poses(path: &Path, frames: &[truth::Frame]) -> Result<Vec<Pose>, Failure> {
    if let Ok(text) = std::fs::read_to_string(path.join("poses_reference_gicp.txt")) {
        let rows: Vec<Vec<f64>> =
            text.lines().map(|l| l.split_whitespace().map(str::parse).collect()).collect::<Result<_, _>>()?;
        let pose = |row: &Vec<f64>| {
            let m = nalgebra::Matrix3x4::from_row_slice(row.get(..12)?);
            let turn = nalgebra::Rotation3::from_matrix(&m.fixed_view::<3, 3>(0, 0).into_owned());
            Some(Pose::from_parts(
                m.column(3).into_owned().into(),
                nalgebra::UnitQuaternion::from_rotation_matrix(&turn),
            ))
        };
        let of_frame = |f: &truth::Frame| rows.get(f.number).and_then(pose).ok_or_else(|| "poses: too few".into());
        return frames.iter().map(of_frame).collect();
    }
    let recording = dataset::open(path)?;
    let mut params = PipelineParams::default().for_preset(Preset::Outdoor);
    params.detection.enabled = false;
    let mut pipeline = Pipeline::new(params)?;
    recording.sensors.iter().for_each(|s| pipeline.declare_sensor(s.clone()));
    let t_base_lidar = recording.sensors.first().map_or_else(Pose::identity, |s| s.t_base_sensor);
    let mut out = vec![];
    for frame in recording.frames(None) {
        let frame = frame?;
        let is_scan = matches!(frame.data, SensorData::Cloud(_));
        let report = pipeline.process(&frame)?;
        if is_scan {
            out.push(report.pose.map(|p| p.t_map_base * t_base_lidar).ok_or("a scan without a pose")?);
        }
    }
    let first = frames.first().map_or(0, |f| f.number);
    let of_frame = |f: &truth::Frame| out.get(f.number - first).copied().ok_or_else(|| "too few poses".into());
    frames.iter().map(of_frame).collect()
}

/// Of this thread so far, milliseconds.
fn processor_ms() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 * 1e-6
}
