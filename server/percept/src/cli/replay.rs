//! `percept replay`: a recorded data set through percept, in this process or into a server.

use super::client::{AccessArgs, RemoteSession, connect};
use super::recorded::RecordedSession;
use super::report::{Report, peak_rss_mb};
use super::streams::{Chosen, Stream};
use super::{Failure, files, input, local};
use percept_formats::dataset::{self, Dataset, OpenOptions};
use percept_formats::{Limits as FileLimits, read_file, trajectory};
use percept_geometry::{SensorFrame, SensorKind, Timestamp};
use percept_pipeline::{LoopState, PipelineParams, Snapshot};
use percept_scene::{Object, ObjectState, RelationFilter};
use percept_service::reason;
use percept_service::{Limits, MapFormat, map_files};
use percept_wire::{convert, json, v1};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub(crate) struct ReplayArgs {
    /// A 7-Scenes, TUM RGB-D, EuRoC (mav0) or KITTI velodyne folder, RGB-D images in folders color and depth (Open3D, Redwood,
    /// slambook2), a CARMEN log, a PCD or PLY file or a folder of them, an MCAP file, a rosbag2 or a bag of ROS 1.
    path: PathBuf,
    #[command(flatten)]
    ros: RosArgs,
    /// Stream into the server at this gRPC address instead of running in this process.
    #[arg(long)]
    server: Option<String>,
    #[command(flatten)]
    access: AccessArgs,
    /// Id of the session on the server; none: one is chosen.
    #[arg(long, default_value = "", requires = "server")]
    session: String,
    /// Stream into this session, which exists: to go on with its map, or to be found in one that was imported.
    #[arg(long, value_name = "SESSION", requires = "server", conflicts_with = "session")]
    into: Option<String>,
    /// Only a part of the recording, FIRST:LAST, LAST excluded.
    #[arg(long, value_parser = input::parse_range)]
    frames: Option<Range<usize>>,
    /// Begin so many seconds after the recording's first frame.
    #[arg(long, value_name = "SECONDS", value_parser = input::parse_seconds, conflicts_with = "frames")]
    start: Option<f64>,
    /// End so many seconds after the recording's first frame.
    #[arg(long, value_name = "SECONDS", value_parser = input::parse_seconds, conflicts_with = "frames")]
    end: Option<f64>,
    /// Play so many times as fast as it was recorded (1: as a robot would send it); none: as fast as frames are taken.
    #[arg(long, value_name = "FACTOR", value_parser = input::parse_rate)]
    rate: Option<f64>,
    /// Write trajectory, map, cloud, objects and scene graph into this folder.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    json: bool,
    /// Threads for computing; 0 takes all cores.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Stream only these sensors; of a depth camera with colour, `camera` is its colour images, `depth` its depth.
    #[arg(long, value_enum, value_delimiter = ',')]
    sensors: Vec<Stream>,
    /// Leave colour out.
    #[arg(long)]
    depth_only: bool,
    /// Leave wheel odometry out.
    #[arg(long)]
    no_odometry: bool,
    /// Configuration file whose session parameters are used (in this process); none: those of the session that was recorded, if the
    /// recording is percept's own and says them.
    #[arg(long, conflicts_with = "server")]
    config: Option<PathBuf>,
    /// Use the default parameters, whatever the session was recorded with.
    #[arg(long, conflicts_with_all = ["config", "into"])]
    default_params: bool,
}

/// How a recording of ROS messages is read.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct RosArgs {
    /// Of a recording of ROS messages: the topic that poses are found by; none: a lidar's, else a depth camera's, else a camera's.
    #[arg(long)]
    topic: Option<String>,
    /// Of a recording of ROS messages: the robot's own frame; none: base_link, base_footprint, or what odometry moves.
    #[arg(long)]
    base_frame: Option<String>,
}

impl RosArgs {
    /// Opens a recording.
    pub(crate) fn open(&self, path: &Path, depth_only: bool) -> Result<Dataset, Failure> {
        let (topic, base_frame) = (self.topic.clone(), self.base_frame.clone());
        let options = OpenOptions { depth_only, topic, base_frame, ..OpenOptions::default() };
        Ok(dataset::open_with(path, &options)?)
    }
}

pub(crate) fn run(args: ReplayArgs) -> Result<(), Failure> {
    let mut recording = args.ros.open(&args.path, args.depth_only)?;
    recording.notes.iter().for_each(|note| eprintln!("percept: {note}"));
    let chosen = Chosen::new(&args.sensors, !args.no_odometry);
    recording.sensors = chosen.specs(&recording.sensors);
    if recording.sensors.is_empty() {
        let kinds = "the recording has none of the sensors asked for; leave --sensors out to see what it has";
        return Err(kinds.into());
    }
    if !recording.is_timed && recording.len() > 1 {
        eprintln!(
            "percept: nothing says when these frames were taken; they are played a second apart. A times.txt beside them, a row \
             of seconds for each, would tell how fast they come"
        );
    }
    if !recording.is_timed && (args.rate.is_some() || args.start.is_some() || args.end.is_some()) {
        return Err(
            "nothing says when these frames were taken; leave --rate, --start and --end out, or use --frames".into()
        );
    }
    let recorded = RecordedSession::of(&recording).filter(|_| args.config.is_none() && args.into.is_none());
    recorded.iter().flat_map(|r| &r.notes).for_each(|note| eprintln!("percept: {note}"));
    let recorded = recorded.map(|r| r.params).filter(|_| !args.default_params);
    if part(&args, &recording).is_empty() && !recording.is_empty() {
        let words = format!(
            "no frame is in the part asked for; the recording has {} frames in {:.1} s",
            recording.len(),
            recording.duration_s()
        );
        return Err(words.into());
    }
    match &args.server {
        None => in_process(&args, &recording, recorded),
        Some(server) => {
            let runtime = super::serve::runtime()?;
            runtime.block_on(into_server(&args, &recording, recorded, server))
        }
    }
}

/// The part asked for, cut to what is there.
fn part(args: &ReplayArgs, recording: &Dataset) -> Range<usize> {
    let stamps = recording.stamps();
    let at = |seconds: f64| stamps.partition_point(|s| s.seconds_since(stamps[0]) < seconds);
    let range = match (&args.frames, args.start, args.end) {
        (Some(frames), ..) => frames.clone(),
        (None, start, end) => start.map_or(0, at)..end.map_or(usize::MAX, at),
    };
    let (first, last) = (range.start.min(recording.len()), range.end.min(recording.len()));
    first..last.max(first)
}

type Frames = Box<dyn Iterator<Item = Result<SensorFrame, percept_formats::FormatError>> + Send>;

fn frames(args: &ReplayArgs, recording: &Dataset) -> Frames {
    let chosen = Chosen::new(&args.sensors, !args.no_odometry);
    let frames = recording.frames(Some(part(args, recording)));
    let frames = frames.flat_map(move |frame| match frame {
        Ok(frame) => chosen.frames(frame).into_iter().map(Ok).collect::<Vec<_>>(),
        Err(e) => vec![Err(e)],
    });
    match args.rate {
        Some(rate) => Box::new(input::paced(frames, rate)),
        None => Box::new(frames),
    }
}

/// The sensor whose frames are counted.
fn primary(recording: &Dataset) -> Option<&percept_geometry::SensorSpec> {
    let sees = |s: &&percept_geometry::SensorSpec| !matches!(s.kind, SensorKind::Odometry | SensorKind::Imu);
    recording.sensors.iter().find(sees).or(recording.sensors.first())
}

fn report(args: &ReplayArgs, recording: &Dataset) -> Report {
    let n = part(args, recording).len();
    Report {
        dataset: recording.name.clone(),
        kind: recording.kind.name().to_owned(),
        sensor: primary(recording).map(|s| format!("{:?}", s.kind).to_lowercase()).unwrap_or_default(),
        frames: n,
        timed: recording.is_timed,
        ..Report::default()
    }
}

/// Recorded seconds of the part that was played; 0 if nothing tells them.
fn recorded_s(args: &ReplayArgs, recording: &Dataset) -> f64 {
    let stamps = &recording.stamps()[part(args, recording)];
    if !recording.is_timed {
        return 0.0;
    }
    match (stamps.first(), stamps.last()) {
        (Some(first), Some(last)) => last.seconds_since(*first),
        _ => 0.0,
    }
}

fn finish(mut report: Report, wall_s: f64, recorded_s: f64, json: bool) -> Result<(), Failure> {
    report.frames_per_s = report.frames as f64 / wall_s.max(1e-9);
    report.realtime_factor = (recorded_s > 0.0).then(|| recorded_s / wall_s.max(1e-9));
    report.peak_rss_mb = peak_rss_mb();
    report.print(json)?;
    if report.tracked == 0 && report.frames > 1 {
        let why = match report.sensor.as_str() {
            "camera" => {
                "a camera alone finds its way once it has moved sideways; if these are depth images, their encoding has to say so \
                 (16UC1 or 32FC1)"
            }
            _ => "see what is in it by percept info, and what is wrong with a stream by percept doctor on a server",
        };
        return Err(format!("none of {} frames was placed: {why}", report.frames).into());
    }
    // What a robot sees on its way lies on what it saw before, even if nothing tells how fast it went.
    if report.kind == "clouds" && !report.timed && report.frames > 1 && 2 * report.tracked < report.frames {
        return Err(format!(
            "only {} of {} clouds lie on those before them: they are hardly of one drive. Tell when they were taken by a \
             times.txt beside them; single clouds are laid over each other by register_clouds_globally",
            report.tracked, report.frames
        )
        .into());
    }
    Ok(())
}

fn in_process(args: &ReplayArgs, recording: &Dataset, recorded: Option<PipelineParams>) -> Result<(), Failure> {
    let params = match &args.config {
        Some(file) => crate::config::Config::load(Some(file))?.params,
        None => recorded.unwrap_or_default(),
    };
    let preset = params.preset.chosen(&recording.sensors);
    let params = params.for_preset(preset);
    let pool = super::compute_pool(args.threads, 0)?;
    let bar = super::progress(part(args, recording).len() as u64, "replay");
    let primary = primary(recording).map(|s| s.id.clone());
    let read = input::read_ahead(frames(args, recording));
    let run = local::run(&pool, params, &recording.sensors, read.into_iter(), |frame, _| {
        bar.inc(u64::from(Some(&frame.sensor) == primary.as_ref()));
    })?;
    bar.finish_and_clear();
    let mut report = report(args, recording);
    report.tracked = run.tracked;
    report.refused = run.refused;
    report.keyframes = run.snapshot.living_keyframes().count();
    report.objects = there(&run.snapshot).count();
    report.loops = run.snapshot.loops.iter().filter(|l| l.state == LoopState::Active).count();
    report.judge(recording.reference.as_deref(), &run.trajectory(), run.snapshot.is_metric());
    report.set_frame_times(run.frame_s.clone());
    if let Some(dir) = &args.out {
        write_results(dir, &run.snapshot)?;
        restamp(dir, recording)?;
    }
    finish(report, run.wall_s, recorded_s(args, recording), args.json)
}

/// Files of a map, and what each is called in an output folder.
pub(crate) const FILES: [(&str, MapFormat, v1::MapFormat); 9] = [
    ("trajectory.tum", MapFormat::TrajectoryTum, v1::MapFormat::TrajectoryTum),
    ("map.pgm", MapFormat::Nav2Pgm, v1::MapFormat::Nav2Pgm),
    ("map.yaml", MapFormat::Nav2Yaml, v1::MapFormat::Nav2Yaml),
    ("map.png", MapFormat::OccupancyPng, v1::MapFormat::OccupancyPng),
    ("overview.png", MapFormat::OverviewPng, v1::MapFormat::OverviewPng),
    ("cloud.ply", MapFormat::CloudPly, v1::MapFormat::CloudPly),
    ("cloud.png", MapFormat::CloudTopPng, v1::MapFormat::CloudTopPng),
    ("cloud-view.png", MapFormat::CloudViewPng, v1::MapFormat::CloudViewPng),
    ("cloud.pcd", MapFormat::CloudPcd, v1::MapFormat::CloudPcd),
];

/// Writes trajectory, maps, cloud, objects and scene graph of a snapshot.
pub(crate) fn write_results(dir: &Path, snapshot: &Snapshot) -> Result<(), Failure> {
    files::make_folder(dir)?;
    let of_layers = [
        ("voxels.bt", MapFormat::VoxelsBt, v1::MapFormat::VoxelsBt),
        ("voxels-view.png", MapFormat::VoxelsViewPng, v1::MapFormat::VoxelsViewPng),
        ("mesh.ply", MapFormat::MeshPly, v1::MapFormat::MeshPly),
        ("mesh-view.png", MapFormat::MeshViewPng, v1::MapFormat::MeshViewPng),
        ("heights.png", MapFormat::HeightsPng, v1::MapFormat::HeightsPng),
        ("traversability.png", MapFormat::TraversabilityPng, v1::MapFormat::TraversabilityPng),
    ];
    for (name, format, _) in FILES.iter().filter(|(name, ..)| *name != "cloud.pcd").chain(&of_layers) {
        match map_files::export(snapshot, "map", *format, &Limits::default()) {
            Ok(file) => files::write(&dir.join(name), file.bytes)?,
            // Who did not ask for a layer does not miss it.
            Err(e) if e.reason == reason::LAYER_OFF => {}
            Err(e) if e.reason == reason::MAP_EMPTY => eprintln!("percept: {name} not written: the map is empty"),
            Err(e) => return Err(e.into()),
        }
    }
    let objects = v1::ListObjectsResponse {
        objects: there(snapshot).map(convert::scene::object_to).collect(),
        next_page_token: String::new(),
        map_version: snapshot.map_version,
    };
    let objects = json::to_json("ListObjectsResponse", &objects)?;
    files::write(&dir.join("objects.json"), serde_json::to_vec_pretty(&objects)?)?;
    let max_cells = snapshot.params.planning.max_cells;
    let graph = snapshot.scene_graph(&BTreeMap::new(), None, None, None, &RelationFilter::default(), max_cells)?;
    let graph = json::to_json("SceneGraph", &convert::scene::graph_to(&graph))?;
    files::write(&dir.join("scene_graph.json"), serde_json::to_vec_pretty(&graph)?)?;
    Ok(())
}

/// Objects that are not gone, as a server lists them.
fn there(snapshot: &Snapshot) -> impl Iterator<Item = &Object> {
    snapshot.objects.iter().filter(|o| o.state != ObjectState::Gone)
}

async fn into_server(
    args: &ReplayArgs,
    recording: &Dataset,
    recorded: Option<PipelineParams>,
    server: &str,
) -> Result<(), Failure> {
    let channel = connect(server, &args.access).await?;
    let session = match &args.into {
        Some(id) => RemoteSession::join(channel, id, &recording.sensors).await?,
        None => {
            let params = recorded.as_ref().map(percept_wire::params::pipeline_to).transpose()?;
            RemoteSession::create(channel, &args.session, &recording.name, &recording.sensors, params).await?
        }
    };
    // What the session has been through before is not this recording's.
    let before: BTreeSet<Timestamp> = match &args.into {
        Some(_) => session.trajectory().await?.iter().map(|p| p.t_map_base.stamp).collect(),
        None => BTreeSet::new(),
    };
    let bar = super::progress(part(args, recording).len() as u64, "replay");
    let primary = primary(recording).map(|s| s.id.0.clone()).unwrap_or_default();
    let start = std::time::Instant::now();
    let source = frames(args, recording);
    let outcome =
        session.stream(input::read_ahead_async(source), |ack| bar.inc(u64::from(ack.sensor_id == primary))).await?;
    let wall_s = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    for e in outcome.rejections.iter().take(5) {
        eprintln!("percept: frame refused: {} ({})", e.message, e.reason);
    }
    session.optimise().await?;
    let mut trajectory = session.trajectory().await?;
    trajectory.retain(|p| !before.contains(&p.t_map_base.stamp));
    let mut report = report(args, recording);
    report.tracked = trajectory.iter().filter(|p| p.tracked).count();
    report.refused = outcome.rejections.len();
    let is_metric = trajectory.iter().any(|p| p.is_metric) || trajectory.is_empty();
    let poses = trajectory.into_iter().filter(|p| p.is_metric == is_metric).map(|p| p.t_map_base).collect::<Vec<_>>();
    report.judge(recording.reference.as_deref(), &poses, is_metric);
    (report.keyframes, report.objects) = counts(&session).await?;
    report.loops = session.num_active_loops().await?;
    if let Some(dir) = &args.out {
        write_remote(dir, &session).await?;
        restamp(dir, recording)?;
    }
    if !args.json {
        println!("session {} on {server}; {} frames durable", session.id, outcome.durable);
    }
    finish(report, wall_s, recorded_s(args, recording), args.json)
}

/// Gives the poses of a written trajectory the recording's own stamps, by which others know its frames.
fn restamp(dir: &Path, recording: &Dataset) -> Result<(), Failure> {
    let path = dir.join("trajectory.tum");
    if !recording.is_restamped() || !path.exists() {
        return Ok(());
    }
    let mut poses = trajectory::parse_tum(&read_file(&path, &FileLimits::default())?)?;
    poses.iter_mut().for_each(|p| p.stamp = recording.recorded_stamp(p.stamp));
    poses.sort_by_key(|p| p.stamp);
    let mut text = Vec::new();
    trajectory::write_tum(&mut text, &poses)?;
    files::write(&path, text)
}

async fn counts(session: &RemoteSession) -> Result<(usize, usize), Failure> {
    let mut client = v1::sessions_service_client::SessionsServiceClient::new(session.channel.clone());
    let answer = client.get_session(v1::GetSessionRequest { session_id: session.id.clone() }).await?.into_inner();
    let s = answer.session.unwrap_or_default();
    Ok((s.num_keyframes as usize, s.num_objects as usize))
}

async fn write_remote(dir: &Path, session: &RemoteSession) -> Result<(), Failure> {
    files::make_folder(dir)?;
    for (name, _, format) in FILES.iter().filter(|(name, ..)| *name != "cloud.pcd") {
        match session.export(*format).await {
            Ok(bytes) => files::write(&dir.join(name), bytes)?,
            Err(e) => eprintln!("percept: {name} not written: {e}"),
        }
    }
    let mut scene = v1::scene_service_client::SceneServiceClient::new(session.channel.clone());
    let request = v1::ListObjectsRequest {
        session_id: session.id.clone(),
        page_size: 1000,
        include_gone: true,
        ..Default::default()
    };
    let objects = scene.list_objects(request).await?.into_inner();
    let objects = json::to_json("ListObjectsResponse", &objects)?;
    files::write(&dir.join("objects.json"), serde_json::to_vec_pretty(&objects)?)?;
    let graph = json::to_json("SceneGraph", &session.scene_graph(None).await?)?;
    files::write(&dir.join("scene_graph.json"), serde_json::to_vec_pretty(&graph)?)?;
    Ok(())
}
