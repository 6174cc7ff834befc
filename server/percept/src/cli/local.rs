//! A pipeline in this process, fed frame by frame.

use super::Failure;
use percept_geometry::{Pose, SensorFrame, SensorSpec, Stamped};
use percept_pipeline::{Pipeline, PipelineParams, Snapshot};
use std::time::Instant;

/// What a run over a recording found.
pub(crate) struct LocalRun {
    pub(crate) snapshot: Snapshot,
    /// Of those, placed.
    pub(crate) tracked: usize,
    /// Frames that could not be read or were refused.
    pub(crate) refused: usize,
    /// Seconds of each registered frame in the pipeline.
    pub(crate) frame_s: Vec<f64>,
    pub(crate) wall_s: f64,
}

impl LocalRun {
    /// Base to map at every registered frame; where some are in metres, those.
    pub(crate) fn trajectory(&self) -> Vec<Stamped<Pose>> {
        self.snapshot.trajectory_in_one_unit().map(|(value, e)| Stamped { stamp: e.stamp, value }).collect()
    }
}

/// Runs frames through a new pipeline on `pool`.
pub(crate) fn run(
    pool: &rayon::ThreadPool,
    params: PipelineParams,
    sensors: &[SensorSpec],
    frames: impl Iterator<Item = Result<SensorFrame, Failure>>,
    mut on_frame: impl FnMut(&SensorFrame, &Snapshot),
) -> Result<LocalRun, Failure> {
    if !params.detection.learned.is_empty() {
        return Err("detection.learned: learned detectors are a server's; replay to one with --server".into());
    }
    let mut pipeline = Pipeline::new(params)?;
    pipeline.work_beside_frames(super::beside_frames(pool.current_num_threads())?);
    sensors.iter().for_each(|s| pipeline.declare_sensor(s.clone()));
    let (mut tracked, mut refused, mut frame_s) = (0, 0, Vec::new());
    let start = Instant::now();
    for frame in frames {
        let frame = match frame {
            Ok(frame) => frame,
            Err(e) => {
                eprintln!("percept: frame left out: {e}");
                refused += 1;
                continue;
            }
        };
        let begun = Instant::now();
        let outcome = pool.install(|| pipeline.process(&frame));
        match outcome {
            Ok(report) => {
                if report.pose.is_some() {
                    tracked += usize::from(report.trajectory.is_some_and(|t| t.tracked));
                    frame_s.push(begun.elapsed().as_secs_f64());
                }
            }
            Err(e) => {
                eprintln!("percept: frame refused: {e}");
                refused += 1;
            }
        }
        on_frame(&frame, &pipeline.snapshot());
    }
    pool.install(|| pipeline.settle());
    let wall_s = start.elapsed().as_secs_f64();
    Ok(LocalRun { snapshot: pipeline.snapshot(), tracked, refused, frame_s, wall_s })
}
