//! A recording is mapped; its cloud (or grid) begins another session, in which the same robot looks for itself:
//! `given RECORDING [--sensor-height M] [--voxel M] [--range M] [--from N] [--outdoor]
//! [--only] [--other RECORDING]`.
//!
//! Frames are sent to and fro from the N-th on, and up to three times more until the robot is found. Told is after how many seconds that
//! is, and it is certain; how far off it is then from where the first session had it at the same frames; and how often it is lost
//! again. With `--only` it only localises. With `--other RECORDING` the frames are those of
//! another place, where nothing is to be found.

use percept_formats::dataset;
use percept_geometry::{Pose, SensorFrame, SensorKind, Timestamp};
use percept_mapping::Occupancy;
use percept_mapping::given::{GivenOptions, GivenSpace, views_of_grid, views_of_space};
use percept_pipeline::{Pipeline, PipelineParams, PoseEstimate, Preset};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

type Failure = Box<dyn Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let path = args
        .first()
        .ok_or("usage: given RECORDING [--sensor-height M] [--voxel M] [--range M] [--from N] [--outdoor]")?;
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let number = |name: &str, usual: f64| value(name).map_or(Ok(usual), |v| v.parse());
    let (sensor_height_m, voxel_m) = (number("--sensor-height", 1.73)?, number("--voxel", 0.2)?);
    let (range_max_m, from) = (number("--range", 30.0)?, number("--from", 0.0)? as usize);
    let mut params = PipelineParams::default();
    if args.iter().any(|a| a == "--outdoor") {
        params = params.for_preset(Preset::Outdoor);
    }
    params.detection.enabled = false;

    let recording = dataset::open(Path::new(path.as_str()))?;
    let mut first = Pipeline::new(params.clone())?;
    let is_planar = recording.sensors.iter().all(|s| s.kind != SensorKind::Lidar3d);
    let mut sensors = recording.sensors.clone();
    for sensor in sensors.iter_mut().filter(|s| s.kind == SensorKind::Lidar3d) {
        sensor.t_base_sensor.translation.vector.z = sensor_height_m;
    }
    sensors.iter().for_each(|s| first.declare_sensor(s.clone()));
    let (mut frames, mut truth): (Vec<SensorFrame>, BTreeMap<Timestamp, Pose>) = (vec![], BTreeMap::new());
    for frame in recording.frames(None) {
        let frame = frame?;
        first.process(&frame)?;
        frames.push(frame);
    }
    first.settle();
    truth.extend(first.snapshot().trajectory().filter(|(_, e)| e.tracked).map(|(t, e)| (e.stamp, t)));
    let layers = first.snapshot().layers;

    let begun = Instant::now();
    let options = GivenOptions { range_max_m, sensor_height_m };
    let given = if is_planar {
        views_of_grid(&layers.occupancy.dense(usize::MAX)?, &options)?
    } else {
        views_of_space(&GivenSpace::of_points(layers.cloud.to_cloud(), voxel_m)?, &options)?
    };
    let (num_views, looked_s) = (given.views.len(), begun.elapsed().as_secs_f64());
    let points: usize = given.views.iter().map(|v| v.scan.hits.len() + v.scan.misses.len()).sum();
    let begun = Instant::now();
    params.slam.localisation_only = args.iter().any(|a| a == "--only");
    let mut second = Pipeline::new(params)?;
    sensors.iter().for_each(|s| second.declare_sensor(s.clone()));
    second.take_given(given.views, None)?;
    println!(
        "{path}: {num_views} views of {points} ends in {looked_s:.1} s, entered in {:.1} s; seen {:.3} of what is occupied",
        begun.elapsed().as_secs_f64(),
        given.occupied_share
    );

    if let Some(other) = value("--other") {
        frames = dataset::open(Path::new(other.as_str()))?.frames(None).collect::<Result<_, _>>()?;
        truth.clear();
    }
    let own: Vec<&SensorFrame> = frames.iter().skip(from).collect();
    let mut order: Vec<&SensorFrame> = own.clone();
    order.extend(own.iter().rev().skip(1));
    let begun = frames.first().map_or(Timestamp(0), |f| f.stamp);
    let (mut passed_s, mut last) = (0.0, order.first().map_or(begun, |f| f.stamp));
    let mut told = Told::default();
    for (i, frame) in order.iter().cycle().take(4 * order.len()).enumerate() {
        if i >= order.len() && told.found_s.is_some() {
            break;
        }
        passed_s += frame.stamp.seconds_since(last).abs();
        last = frame.stamp;
        let stamp = begun.plus_seconds(passed_s);
        let pose = second.process(&SensorFrame { stamp, ..(*frame).clone() })?.pose;
        let there = truth.get(&frame.stamp);
        if let Some(pose) = pose {
            told.add(&pose, there, passed_s);
        }
    }
    if told.found_s.is_some() {
        println!("{told}");
        return Ok(());
    }
    println!("not found in {:.1} s", passed_s);
    Ok(())
}

/// What is said of a robot in a map that was given.
#[derive(Debug, Default)]
struct Told {
    found_s: Option<f64>,
    certain_s: Option<f64>,
    /// Frames since it was found, and those of them that were placed.
    frames: usize,
    /// Metres from where the first session had the robot; none where it is not to be found.
    off_m: Vec<f64>,
    /// Times that it was lost again, and of these before it was certain.
    lost: usize,
    withdrawn: usize,
    is_tentative: bool,
    is_tracking: bool,
}

impl Told {
    fn add(&mut self, pose: &PoseEstimate, there: Option<&Pose>, now_s: f64) {
        let is_tracking = pose.state.is_tracking();
        if is_tracking {
            self.found_s.get_or_insert(now_s);
            if !pose.is_tentative {
                self.certain_s.get_or_insert(now_s);
            }
            let off = there.map(|t| t.inv_mul(&pose.t_map_base).translation.vector.norm());
            self.off_m.push(off.unwrap_or(f64::INFINITY));
        } else if self.is_tracking {
            self.lost += 1;
            self.withdrawn += usize::from(self.is_tentative);
            let off = self.off_m.last().copied().unwrap_or(f64::NAN);
            println!("lost again after {now_s:.1} s, {off:.3} m off: {:?}", pose.state);
        }
        self.frames += usize::from(self.found_s.is_some());
        (self.is_tracking, self.is_tentative) = (is_tracking, pose.is_tentative);
    }
}

impl std::fmt::Display for Told {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut off = self.off_m.clone();
        off.sort_by(f64::total_cmp);
        let at = |share: f64| off.get(((off.len() as f64 - 1.0) * share) as usize).copied().unwrap_or(f64::NAN);
        write!(
            f,
            "found after {:.1} s, certain after {:.1} s; of {} frames since, {} placed, {:.3} m off in the median, {:.3} at 95 %, {:.3} \
             at most; lost again {} times, {} of them before it was certain",
            self.found_s.unwrap_or(f64::NAN),
            self.certain_s.unwrap_or(f64::NAN),
            self.frames,
            off.len(),
            at(0.5),
            at(0.95),
            at(1.0),
            self.lost,
            self.withdrawn
        )
    }
}
