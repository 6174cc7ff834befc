//! What runs beside the frames gives the same whenever it runs.

use crate::drive::{empty, feed, simulation};
use percept_geometry::SensorFrame;
use percept_pipeline::{Executor, PipelineParams, Snapshot};
use percept_sim::SensorSuite;
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
