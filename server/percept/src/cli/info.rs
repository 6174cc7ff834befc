//! `percept info`: what a recording holds, and what a replay would take of it.

use super::Failure;
use super::recorded::RecordedSession;
use super::replay::RosArgs;
use percept_geometry::{SensorKind, SensorSpec};
use serde_json::json;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(crate) struct InfoArgs {
    /// A recording, as for `percept replay`.
    path: PathBuf,
    #[command(flatten)]
    ros: RosArgs,
    /// Print one JSON object instead of lines.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &InfoArgs) -> Result<(), Failure> {
    let mut recording = args.ros.open(&args.path, false)?;
    // Names tell little of what is in a file.
    let unread = recording.frames(Some(0..1)).find_map(Result::err);
    if let Some(error) = unread {
        if recording.len() == 1 {
            return Err(error.into());
        }
        recording.notes.push(format!("its first frame cannot be read: {error}"));
    }
    if let Some(session) = RecordedSession::of(&recording) {
        recording.notes.extend(session.notes);
    }
    if args.json {
        let sensors = recording.sensors.iter().map(|s| json!({ "id": s.id.0, "kind": kind(s), "at_m": at(s) }));
        let object = json!({
            "dataset": recording.name,
            "kind": recording.kind.name(),
            "frames": recording.len(),
            "duration_s": recording.duration_s(),
            "timed": recording.is_timed,
            "restamped": recording.is_restamped(),
            "odometry_samples": recording.num_odometry_samples(),
            "reference": recording.reference_source,
            "relations": recording.relations.as_ref().map(Vec::len),
            "sensors": sensors.collect::<Vec<_>>(),
            "notes": recording.notes,
            "topics": recording.topics,
        });
        println!("{object}");
        return Ok(());
    }
    println!("{}: {}", recording.name, recording.kind.name());
    let rate = (recording.len().saturating_sub(1)) as f64 / recording.duration_s().max(1e-9);
    let told = if recording.is_timed {
        format!("{:.1} s, {rate:.1} a second", recording.duration_s())
    } else {
        "not timed".to_owned()
    };
    println!("frames      {} ({told})", recording.len());
    for s in &recording.sensors {
        let [x, y, z] = at(s);
        println!("sensor      {} ({}), {x:.3} {y:.3} {z:.3} m from the base", s.id, kind(s));
    }
    println!("odometry    {} samples", recording.num_odometry_samples());
    println!("reference   {}", recording.reference_source.as_deref().unwrap_or("none"));
    if recording.is_restamped() {
        println!("stamps      do not rise in the order of the frames; they are sorted");
    }
    recording.topics.iter().for_each(|topic| println!("topic       {topic}"));
    recording.notes.iter().for_each(|note| println!("note        {note}"));
    Ok(())
}

fn at(spec: &SensorSpec) -> [f64; 3] {
    spec.t_base_sensor.translation.vector.into()
}

fn kind(spec: &SensorSpec) -> &'static str {
    match spec.kind {
        SensorKind::Lidar2d => "planar lidar",
        SensorKind::Lidar3d => "3D lidar",
        SensorKind::Rgbd => "depth camera with colour",
        SensorKind::Depth => "depth camera",
        SensorKind::Camera => "camera",
        SensorKind::Odometry => "odometry",
        SensorKind::Imu => "inertial",
    }
}
