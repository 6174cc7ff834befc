//! One view of a planar log, looked for in the other half of the log: `relocalisation LOG [--way M] [--max-range M] [--every N]`.
//!
//! The keyframes of the whole log are placed by the pipeline. Then one half of them is the map, and every N-th of the other
//! half is looked for in it without a guess, with the views of the last M metres if a way is given; and the other way round.
//! Right is what lies within 0.5 m and 0.2 rad of where the pipeline has put it. Where no keyframe of the map lies within
//! 1.5 m, nothing should be found.

use percept_formats::dataset;
use percept_geometry::{Covariance6, KeptScan, KeyframeId, KeyframeScan, Pose, SensorData};
use percept_pipeline::{Pipeline, PipelineParams};
use percept_slam::loops::{KeyframePoses, PlaceLimits, PlaceRecognition, place_recognition};
use percept_slam::{OdometryKind, OdometryParams};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::sync::Arc;

type Failure = Box<dyn Error + Send + Sync>;
type Scans = BTreeMap<KeyframeId, Arc<KeyframeScan>>;

/// Farther from where it should be is wrong, metres and radians.
const RIGHT: (f64, f64) = (0.5, 0.2);
/// The map knows places that are so near to one of its keyframes, metres.
const KNOWN_M: f64 = 1.5;

/// Views by what came of them, of places that the map knows and of others.
#[derive(Default)]
struct Score {
    known: usize,
    unknown: usize,
    right: usize,
    wrong: Vec<KeyframeId>,
    questions: Vec<usize>,
}

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let path = args.first().ok_or("usage: relocalisation LOG [--way M] [--max-range M] [--every N]")?;
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let way_m: f64 = value("--way").map_or(Ok(0.0), |v| v.parse())?;
    let max_range_m: f32 = value("--max-range").map_or(Ok(f32::INFINITY), |v| v.parse())?;
    let every: usize = value("--every").map_or(Ok(3), |v| v.parse::<usize>())?.max(1);
    let (scans, poses) = keyframes(Path::new(path.as_str()), max_range_m)?;
    let ids: Vec<KeyframeId> = poses.keys().copied().collect();
    let (first, second) = ids.split_at(ids.len() / 2);
    let mut score = Score::default();
    for (map, views) in [(first, second), (second, first)] {
        let known: KeyframePoses = map.iter().map(|id| (*id, poses[id])).collect();
        let limits = PlaceLimits { keyframes: usize::MAX, submaps: usize::MAX };
        let places = place_recognition(OdometryKind::Lidar2d, &OdometryParams::default(), limits);
        let mut places = places.ok_or("planar lidars have no place recognition")?;
        for id in map {
            places.restore(*id, &KeptScan::from(&scans[id]), &Covariance6::zeros(), &known, &[]);
        }
        for at in (0..views.len()).step_by(every) {
            look(&mut *places, (&known, &poses), &views[..=at], &scans, way_m, &mut score);
        }
    }
    score.questions.sort_unstable();
    println!("{path} {}", args[1..].join(" "));
    println!(
        "  views of known places {}  found {}  wrong {} {:?}  of {} views of unknown places; questions p50 {} max {}",
        score.known,
        score.right,
        score.wrong.len(),
        score.wrong.iter().map(|id| id.0).collect::<Vec<_>>(),
        score.unknown,
        score.questions.get(score.questions.len() / 2).copied().unwrap_or(0),
        score.questions.last().copied().unwrap_or(0),
    );
    Ok(())
}

/// Looks for the last of some views.
fn look(
    places: &mut dyn PlaceRecognition,
    (known, truth): (&KeyframePoses, &KeyframePoses),
    views: &[KeyframeId],
    scans: &Scans,
    way_m: f64,
    score: &mut Score,
) {
    let Some((id, earlier)) = views.split_last() else { return };
    let (here, mut last, mut way) = (truth[id], truth[id], 0.0);
    let mut before = vec![];
    for then in earlier.iter().rev() {
        if way >= way_m {
            break;
        }
        way += (last.translation.vector - truth[then].translation.vector).norm();
        last = truth[then];
        before.push((here.inv_mul(&last), Arc::clone(&scans[then])));
    }
    before.reverse();
    let distance = |t: &Pose| (t.translation.vector - here.translation.vector).norm();
    let is_known = known.values().any(|t| distance(t) < KNOWN_M);
    score.known += usize::from(is_known);
    score.unknown += usize::from(!is_known);
    let mut questions = 0;
    let found = loop {
        questions += 1;
        let found = places.relocalise_driven(&before, &scans[id], known);
        if found.is_some() || !places.is_unfinished() {
            break found;
        }
    };
    score.questions.push(questions);
    let Some(found) = found else { return };
    let off = here.inv_mul(&(known[&found.keyframe] * found.t_keyframe_base));
    match off.translation.vector.norm() < RIGHT.0 && off.rotation.angle() < RIGHT.1 {
        true => score.right += 1,
        false => score.wrong.push(*id),
    }
}

/// All keyframes of a log, where the pipeline has put them in the end.
fn keyframes(path: &Path, max_range_m: f32) -> Result<(Scans, KeyframePoses), Failure> {
    let recording = dataset::open(path)?;
    let mut pipeline = Pipeline::new(PipelineParams::default())?;
    recording.sensors.iter().for_each(|s| pipeline.declare_sensor(s.clone()));
    let mut scans = Scans::new();
    for frame in recording.frames(None) {
        let mut frame = frame?;
        if let SensorData::Scan(scan) = &mut frame.data {
            scan.ranges_m.iter_mut().filter(|r| **r > max_range_m).for_each(|r| *r = f32::INFINITY);
        }
        let report = pipeline.process(&frame)?;
        let new = report.keyframe.iter().chain(&report.joined);
        scans.extend(new.map(|k| (k.info.id, Arc::clone(&k.scan))));
    }
    pipeline.settle();
    let snapshot = pipeline.snapshot();
    let pose = |id: &KeyframeId| Some((*id, snapshot.keyframes.get(usize::try_from(id.0).ok()?)?.t_map_base));
    let poses: KeyframePoses = scans.keys().filter_map(pose).collect();
    scans.retain(|id, _| poses.contains_key(id));
    Ok((scans, poses))
}
