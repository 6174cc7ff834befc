//! What runs beside the frames gives the same whenever it runs.

use crate::drive::{empty, feed, simulation};
use percept_geometry::{Correction, SensorFrame, se3};
use percept_pipeline::{Executor, Pipeline, PipelineParams, Snapshot};
use percept_scene::{Object, ObjectChangeKind};
use percept_sim::{SensorSuite, Simulation};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, mpsc};

/// Runs work on a thread of its own, at once, or not at all, in turns.
#[derive(Default)]
struct Fickle {
    spawned: AtomicUsize,
    threads: Mutex<Vec<std::thread::JoinHandle<()>>>,
}

impl Executor for Fickle {
    fn spawn(&self, work: Box<dyn FnOnce() + Send>) {
        match self.spawned.fetch_add(1, Ordering::Relaxed) % 3 {
            0 => self.threads.lock().unwrap().push(std::thread::spawn(work)),
            1 => work(),
            _ => drop(work),
        }
    }
}

/// What is left of a drive.
fn run(frames: &[SensorFrame], executor: Option<Arc<dyn Executor>>) -> Snapshot {
    let home = simulation(SensorSuite::only_lidar2d(), 60.0);
    let mut pipeline = empty(&home, PipelineParams::default());
    if let Some(executor) = executor {
        pipeline.work_beside_frames(executor);
    }
    feed(&mut pipeline, frames.iter().cloned());
    pipeline.settle();
    pipeline.snapshot()
}

#[test]
fn the_same_frames_give_the_same_map_whoever_does_the_work_and_when() {
    let home = simulation(SensorSuite::only_lidar2d(), 60.0);
    let frames: Vec<_> = home.frames().map(|f| f.frame).collect();
    let fickle = Arc::new(Fickle::default());
    let (alone, beside) = (run(&frames, None), run(&frames, Some(fickle.clone())));
    assert!(!alone.loops.is_empty(), "there is something to be worked on");
    assert!(fickle.spawned.load(Ordering::Relaxed) > 10);
    assert_eq!(alone.keyframes, beside.keyframes);
    assert_eq!(alone.loops, beside.loops);
    assert!(alone.trajectory().eq(beside.trajectory()));
    assert_eq!(alone.layers.occupancy, beside.layers.occupancy);
}

/// Keeps all work until it is let go.
struct Stuck(Mutex<mpsc::Sender<Box<dyn FnOnce() + Send>>>);

impl Executor for Stuck {
    fn spawn(&self, work: Box<dyn FnOnce() + Send>) {
        self.0.lock().unwrap().send(work).unwrap();
    }
}

#[test]
fn frames_go_on_though_the_threads_beside_them_do_nothing() {
    let home = simulation(SensorSuite::only_lidar2d(), 12.0);
    let frames: Vec<_> = home.frames().map(|f| f.frame).collect();
    let (kept, work) = mpsc::channel();
    let stuck = run(&frames, Some(Arc::new(Stuck(Mutex::new(kept)))));
    // Work that comes too late finds that it was done.
    work.try_iter().for_each(|work| work());
    assert_eq!(stuck.keyframes, run(&frames, None).keyframes);
}

/// A lap of one room with a 3D lidar.
fn furnished() -> (Simulation, Vec<SensorFrame>) {
    let home = simulation(SensorSuite::only_lidar3d(), 14.0);
    let frames = home.frames().map(|f| f.frame).collect();
    (home, frames)
}

#[test]
fn the_same_frames_give_the_same_objects_whoever_looks_and_when() {
    let (home, frames) = furnished();
    let told = |executor: Option<Arc<dyn Executor>>| {
        let mut pipeline = empty(&home, PipelineParams::default());
        if let Some(executor) = executor {
            pipeline.work_beside_frames(executor);
        }
        let mut told = vec![];
        for frame in &frames {
            let changes = pipeline.process(frame).unwrap().map.objects;
            told.extend(changes.into_iter().map(|c| (frame.stamp, c)));
        }
        let last = pipeline.settle().objects;
        (told, last, pipeline.snapshot().objects)
    };
    let alone = told(None);
    assert!(alone.2.len() > 2, "there is something to be found: {}", alone.2.len());
    assert_eq!(alone, told(Some(Arc::new(Fickle::default()))));
}

#[test]
fn what_is_found_around_a_keyframe_is_told_half_a_second_later_and_all_of_it_at_the_end() {
    let (home, frames) = furnished();
    let mut pipeline = empty(&home, PipelineParams::default());
    let (mut keyframes, mut told) = (vec![], vec![]);
    for frame in &frames {
        let report = pipeline.process(frame).unwrap();
        keyframes.extend(report.keyframe.map(|k| k.info.stamp));
        let appeared = report.map.objects.iter().filter(|c| c.kind == ObjectChangeKind::Appeared).count();
        told.extend((appeared > 0).then_some(frame.stamp));
    }
    // Scans come each 0.1 s, so that the frame that is half a second younger comes no later than that.
    for stamp in &told {
        let due = |k: &&percept_geometry::Timestamp| (0.499..0.6).contains(&stamp.seconds_since(**k));
        assert!(keyframes.iter().any(|k| due(&k)), "{stamp:?}");
    }
    assert!(!told.is_empty());
    // The newest keyframe's surroundings are still being looked at.
    let is_looking = pipeline.is_revising();
    let seen_until = |p: &Pipeline| p.snapshot().objects.iter().map(|o| o.last_seen).max();
    let before = seen_until(&pipeline);
    pipeline.settle();
    assert!(!pipeline.is_revising());
    assert!(is_looking && seen_until(&pipeline) == keyframes.last().copied() && before < seen_until(&pipeline));
}

#[test]
fn what_is_found_moves_with_the_keyframe_that_it_was_looked_for_around() {
    let (home, frames) = furnished();
    let t_new_old = se3::from_xy_yaw(3.0, -2.0, 0.4);
    // Moved while the newest search was under way, and after it.
    let run = |moves_first: bool| {
        let mut params = PipelineParams::default();
        // Corrections come from here alone.
        params.slam.back_end.enabled = false;
        let mut pipeline = empty(&home, params);
        frames.iter().for_each(|f| drop(pipeline.process(f).unwrap()));
        assert!(pipeline.is_revising());
        if !moves_first {
            pipeline.settle();
        }
        let keyframes = pipeline.snapshot().keyframes;
        let moved = keyframes.iter().map(|k| (k.id, t_new_old * k.t_map_base)).collect();
        pipeline.apply(&Correction { t_map_base: moved });
        pipeline.settle();
        pipeline.snapshot().objects
    };
    let (while_looking, after) = (run(true), run(false));
    assert_eq!(while_looking.len(), after.len());
    let off = |(a, b): (&Object, &Object)| (a.bbox.center() - b.bbox.center()).norm();
    let worst = while_looking.iter().zip(after.iter()).map(off).fold(0.0, f64::max);
    assert!(worst < 0.05, "{worst}");
}
