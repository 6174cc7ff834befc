//! A simulated session through a pipeline in this process, frame by frame beside its truth.

use super::Failure;
use nalgebra::UnitQuaternion;
use percept_evaluation::{Alignment, PosePair, align};
use percept_geometry::{KeyframeId, Pose, SensorKind, Timestamp};
use percept_pipeline::{Loop, LoopId, LoopState, Pipeline, PipelineParams, Snapshot};
use percept_sim::Simulation;
use percept_slam::TrackingState;
use std::collections::{BTreeMap, HashMap};
use std::time::Instant;

/// A pose in a known map, or a loop, is right if it is this near to the true position, metres.
pub(crate) const RIGHT_M: f64 = 0.5;
/// And to the true rotation, radians.
pub(crate) const RIGHT_RAD: f64 = 0.35;

/// A registered frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrameRecord {
    pub(crate) stamp: Timestamp,
    /// When it was measured, seconds after the start.
    pub(crate) second: f64,
    /// Base at the time to base at the start, exact.
    pub(crate) truth: Pose,
    /// Base to map, as was said at the time.
    pub(crate) online: Pose,
    pub(crate) tracked: bool,
    /// Whether lengths are metres.
    pub(crate) is_metric: bool,
    /// Time in the pipeline, milliseconds.
    pub(crate) ms: f32,
    /// Resident memory of this process after it, megabytes.
    pub(crate) rss_mb: f32,
}

/// What a session came to.
pub(crate) struct SlamRun {
    pub(crate) frames: Vec<FrameRecord>,
    /// Frames of the sensor that finds the poses, refused ones included, lost ones too.
    pub(crate) num_sent: usize,
    pub(crate) num_refused: usize,
    pub(crate) num_keyframes: usize,
    /// Times that poses of old keyframes moved.
    pub(crate) num_corrections: usize,
    /// Loops that were found, those that were believed, and believed ones that contradict the truth.
    pub(crate) num_loops: [usize; 3],
    /// Sensors that the session says are mounted otherwise than declared, and by how many degrees.
    pub(crate) mounts_off_deg: BTreeMap<String, f64>,
    /// Frames in which the scene left each axis of base open: x, y, z, rotation x, y, z.
    pub(crate) num_degenerate: [usize; 6],
    /// Whether lengths are metres; if not, truth is that of the camera, whose mount counts only in metres.
    pub(crate) is_metric: bool,
    /// Frames by what was said of tracking.
    pub(crate) states: BTreeMap<String, usize>,
    /// Base to map by stamp, with all corrections, of frames that were tracked.
    corrected: HashMap<Timestamp, Pose>,
    /// The same of the keyframes that hold the map, those of a stretch in which the robot was lost included.
    keyframes: HashMap<Timestamp, Pose>,
}

impl SlamRun {
    pub(crate) fn num_tracked(&self) -> usize {
        self.frames.iter().filter(|f| f.tracked).count()
    }

    /// Truth and estimate, the latter with all corrections, of tracked frames.
    pub(crate) fn final_pairs(&self) -> Vec<PosePair> {
        self.paired(&self.corrected)
    }

    /// The same of the keyframes that hold the map: what was seen while lost may have joined it since.
    pub(crate) fn keyframe_pairs(&self) -> Vec<PosePair> {
        self.paired(&self.keyframes)
    }

    fn paired(&self, estimates: &HashMap<Timestamp, Pose>) -> Vec<PosePair> {
        let pair = |f: &FrameRecord| {
            let estimate = *estimates.get(&f.stamp)?;
            Some(PosePair { stamp: f.stamp, reference: f.truth, estimate })
        };
        self.frames.iter().filter_map(pair).collect()
    }

    /// Truth and estimate as it was said at the time, of tracked frames.
    pub(crate) fn online_pairs(&self) -> Vec<PosePair> {
        self.online_pairs_until(f64::INFINITY)
    }

    /// As [`Self::online_pairs`], of frames before a time.
    pub(crate) fn online_pairs_until(&self, end_s: f64) -> Vec<PosePair> {
        let tracked = self.frames.iter().filter(|f| f.tracked && f.is_metric == self.is_metric && f.second < end_s);
        tracked.map(|f| PosePair { stamp: f.stamp, reference: f.truth, estimate: f.online }).collect()
    }

    /// Distance of each frame's pose, as it was said, from the truth, metres; aligned over the tracked ones.
    pub(crate) fn online_errors(&self) -> Vec<f64> {
        let alignment = if self.is_metric { Alignment::Se3 } else { Alignment::Sim3 };
        let Ok(similarity) = align(&self.online_pairs(), alignment) else {
            return vec![f64::NAN; self.frames.len()];
        };
        let away =
            |f: &FrameRecord| (similarity.apply(&f.online).translation.vector - f.truth.translation.vector).norm();
        self.frames.iter().map(away).collect()
    }

    /// Length of the true path over the frames, metres.
    pub(crate) fn path_length_m(&self) -> f64 {
        let step = |f: &[FrameRecord]| (f[1].truth.translation.vector - f[0].truth.translation.vector).norm();
        self.frames.windows(2).map(step).sum()
    }
}

/// Runs the session; messages are made one by one while it goes.
pub(crate) fn run_session(
    pool: &rayon::ThreadPool,
    simulation: &Simulation,
    params: PipelineParams,
    what: &'static str,
) -> Result<SlamRun, Failure> {
    let mut pipeline = Pipeline::new(params)?;
    pipeline.work_beside_frames(super::beside_frames(pool.current_num_threads())?);
    let sensors = simulation.sensors();
    sensors.iter().for_each(|s| pipeline.declare_sensor(s.clone()));
    let spec = sensors.iter().find(|s| moves_pose(s.kind)).ok_or("no sensor that finds poses")?;
    let (main, arm) = (spec.id.clone(), Pose::from_parts(spec.t_base_sensor.translation, UnitQuaternion::identity()));
    let mut frames = simulation.frames();
    let bar = super::progress(frames.total(), what);
    let t_start_world = simulation.t_world_start().inverse();
    let mut run = SlamRun {
        frames: touched(frames.total() as usize),
        num_sent: 0,
        num_refused: 0,
        num_keyframes: 0,
        num_corrections: 0,
        num_loops: [0; 3],
        mounts_off_deg: BTreeMap::new(),
        num_degenerate: [0; 6],
        is_metric: true,
        states: BTreeMap::new(),
        corrected: HashMap::new(),
        keyframes: HashMap::new(),
    };
    let mut oldest = None;
    let mut believed: BTreeMap<LoopId, Loop> = BTreeMap::new();
    while let Some(sim) = pool.install(|| frames.next()) {
        bar.inc(1);
        run.num_sent += usize::from(sim.frame.sensor == main);
        let begun = Instant::now();
        let outcome = pool.install(|| pipeline.process(&sim.frame));
        let ms = (begun.elapsed().as_secs_f64() * 1e3) as f32;
        let report = match outcome {
            Ok(report) => report,
            Err(_) => {
                run.num_refused += usize::from(sim.frame.sensor == main);
                continue;
            }
        };
        // A loop that was believed for a while and then no longer has bent the map all the same.
        believed.extend(report.map.loops.iter().filter(|l| l.state == LoopState::Active).map(|l| (l.id, l.clone())));
        let Some(pose) = report.pose.filter(|_| sim.frame.sensor == main) else { continue };
        run.num_degenerate.iter_mut().zip(pose.degenerate_axes).for_each(|(n, open)| *n += usize::from(open));
        *run.states.entry(state_name(pose.state)).or_default() += 1;
        run.frames.push(FrameRecord {
            stamp: sim.frame.stamp,
            second: sim.measured_s,
            truth: t_start_world * sim.t_world_base,
            online: pose.t_map_base,
            tracked: report.trajectory.is_some_and(|t| t.tracked),
            is_metric: pose.scale.is_metric(),
            ms,
            rss_mb: rss_mb().unwrap_or(0.0),
        });
        let first = pipeline.snapshot().keyframes.get(1).map(|k| k.t_map_base);
        run.num_corrections += usize::from(oldest.is_some() && first != oldest);
        oldest = first;
    }
    bar.finish_and_clear();
    pool.install(|| pipeline.settle());
    let snapshot = pipeline.snapshot();
    run.num_keyframes = snapshot.living_keyframes().count();
    run.num_loops = loops(&snapshot, &believed, &run.frames);
    let mounts = snapshot.mount_offsets.iter();
    run.mounts_off_deg = mounts.map(|(id, off)| (id.0.clone(), off.angle_rad.to_degrees())).collect();
    run.is_metric = snapshot.is_metric();
    if !run.is_metric {
        run.frames.iter_mut().for_each(|f| f.truth *= arm);
    }
    let kept = snapshot.keyframes.iter().filter(|k| k.merged.is_none() && run.is_metric);
    run.keyframes = kept.map(|k| (k.stamp, k.t_map_base)).collect();
    let tracked = snapshot.trajectory_in_one_unit().filter(|(_, e)| e.tracked);
    run.corrected = tracked.map(|(pose, e)| (e.stamp, pose)).collect();
    Ok(run)
}

/// Whether frames of this kind of sensor can move the pose.
fn moves_pose(kind: SensorKind) -> bool {
    !matches!(kind, SensorKind::Odometry | SensorKind::Imu)
}

/// Loops found, believed at the end, and those that contradict the truth of all that ever were believed.
fn loops(snapshot: &Snapshot, believed: &BTreeMap<LoopId, Loop>, frames: &[FrameRecord]) -> [usize; 3] {
    let by_stamp: HashMap<Timestamp, &Pose> = frames.iter().map(|f| (f.stamp, &f.truth)).collect();
    let truth = |id: KeyframeId| by_stamp.get(&snapshot.keyframes.get(usize::try_from(id.0).ok()?)?.stamp);
    let is_false = |l: &Loop| {
        let (Some(from), Some(to)) = (truth(l.closure.from), truth(l.closure.to)) else { return false };
        let error = l.closure.t_from_to.inverse() * (from.inverse() * **to);
        error.translation.vector.norm() > RIGHT_M || error.rotation.angle() > RIGHT_RAD
    };
    let at_end = snapshot.loops.iter().filter(|l| l.state == LoopState::Active).count();
    [snapshot.loops.len(), at_end, believed.values().filter(|l| is_false(l)).count()]
}

/// Room for so many records, its pages in memory from the start: growth is then the pipeline's.
fn touched(num_records: usize) -> Vec<FrameRecord> {
    let pose = Pose::identity();
    let record = FrameRecord {
        stamp: Timestamp(1),
        second: 1.0,
        truth: pose,
        online: pose,
        tracked: true,
        is_metric: true,
        ms: 1.0,
        rss_mb: 1.0,
    };
    let mut out = vec![record; num_records];
    out.clear();
    out
}

fn state_name(state: TrackingState) -> String {
    match state {
        TrackingState::Initialising => "initialising".to_owned(),
        TrackingState::Tracking => "tracking".to_owned(),
        TrackingState::Lost { reason } => format!("lost: {reason:?}"),
    }
}

/// Resident memory of this process, megabytes (Linux; pages of 4 KiB).
fn rss_mb() -> Option<f32> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: f32 = text.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * 4096.0 / 1e6)
}
