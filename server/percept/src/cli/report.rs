//! What a replay prints: figures as a table or one JSON object.

use percept_evaluation::{Alignment, Trajectory, TrajectoryParams, score_trajectory};
use percept_geometry::{Pose, Stamped};
use serde::Serialize;

/// Figures of a replay; null where there is no truth.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct Report {
    /// Name of the recording.
    pub(crate) dataset: String,
    /// Its kind.
    pub(crate) kind: String,
    /// Sensor that moves the pose.
    pub(crate) sensor: String,
    /// Frames of that sensor.
    pub(crate) frames: usize,
    /// Whether the recording says when they were taken; if not, they are a second apart.
    pub(crate) timed: bool,
    /// Of those, placed.
    pub(crate) tracked: usize,
    /// Frames that could not be read or were refused.
    pub(crate) refused: usize,
    /// Whether the estimate's lengths are metres: if not, it is scaled onto the reference before it is judged.
    pub(crate) metric: bool,
    pub(crate) ate_rmse_m: Option<f64>,
    pub(crate) rpe_trans_rmse_m: Option<f64>,
    pub(crate) rpe_rot_rmse_deg: Option<f64>,
    /// End error, first poses laid over each other, over the path's length, percent.
    pub(crate) drift_percent: Option<f64>,
    /// The same end error in metres.
    pub(crate) end_error_m: Option<f64>,
    /// Length of the true path, metres.
    pub(crate) path_length_m: Option<f64>,
    pub(crate) frames_per_s: f64,
    /// Recorded seconds over seconds taken.
    pub(crate) realtime_factor: Option<f64>,
    /// Time of a frame in the pipeline, milliseconds (null through a server).
    pub(crate) frame_ms_p50: Option<f64>,
    pub(crate) frame_ms_p99: Option<f64>,
    /// Largest resident memory of this process so far, megabytes.
    pub(crate) peak_rss_mb: Option<f64>,
    pub(crate) keyframes: usize,
    pub(crate) objects: usize,
    /// Loops closed.
    pub(crate) loops: usize,
}

impl Report {
    /// Adds the errors against a reference, if there is one that shares stamps.
    pub(crate) fn judge(&mut self, reference: Option<&[Stamped<Pose>]>, estimate: &[Stamped<Pose>], is_metric: bool) {
        self.metric = is_metric;
        let Some(reference) = reference else { return };
        let (Ok(reference), Ok(estimate)) = (Trajectory::new(reference.to_vec()), Trajectory::new(estimate.to_vec()))
        else {
            return;
        };
        let alignment = if is_metric { Alignment::Se3 } else { Alignment::Sim3 };
        match score_trajectory(&reference, &estimate, &TrajectoryParams { alignment, ..TrajectoryParams::default() }) {
            Ok(score) => {
                self.ate_rmse_m = Some(score.absolute.translation_m.rmse);
                self.rpe_trans_rmse_m = score.relative.as_ref().map(|r| r.translation_m.rmse);
                self.rpe_rot_rmse_deg = score.relative.as_ref().map(|r| r.rotation_deg.rmse);
                self.drift_percent = score.end_drift_percent;
                self.path_length_m = Some(score.reference_length_m);
                self.end_error_m = score.end_drift_percent.map(|d| d / 100.0 * score.reference_length_m);
            }
            Err(e) => eprintln!("percept: not judged against the reference: {e}"),
        }
    }

    /// Percentiles of the time of a frame.
    pub(crate) fn set_frame_times(&mut self, mut seconds: Vec<f64>) {
        seconds.sort_by(f64::total_cmp);
        let at = |share: f64| seconds.get(((seconds.len() as f64 - 1.0) * share).round() as usize).map(|s| s * 1e3);
        self.frame_ms_p50 = at(0.5);
        self.frame_ms_p99 = at(0.99);
    }

    /// As JSON, or as a table for people.
    pub(crate) fn print(&self, json: bool) -> Result<(), super::Failure> {
        if json {
            println!("{}", serde_json::to_string(self)?);
            return Ok(());
        }
        if let serde_json::Value::Object(fields) = serde_json::to_value(self)? {
            for (name, value) in fields.iter().filter(|(_, v)| !v.is_null()) {
                match value.as_f64().filter(|_| value.is_f64()) {
                    Some(number) => println!("{name:>18}  {number:.4}"),
                    None => println!("{name:>18}  {}", value.to_string().trim_matches('"')),
                }
            }
        }
        Ok(())
    }
}

/// Largest resident memory of this process so far, megabytes (Linux).
pub(crate) fn peak_rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kb| kb / 1024.0)
}
