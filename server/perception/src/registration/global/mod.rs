//! Registration with no first guess: features, correspondences, consistency, verification, refinement.
//!
//! [`register_global`] goes through the files in this order: [`keypoints`] thins a cloud and describes it, [`matching`]
//! pairs what looks alike, [`consistency`] finds sets of pairs that a rigid motion allows, [`ransac`] is the older way to
//! do so, [`verify`] lays the clouds over each other and says whether that is right.

mod consistency;
mod keypoints;
mod matching;
mod params;
mod ransac;
mod rigid;
mod verify;

pub use params::{GlobalMethod, GlobalOutcome, GlobalParams, GlobalResult};

use super::RegistrationError;
use keypoints::Described;
use percept_geometry::{PointCloud, Pose};
use verify::{Judge, Verdict};

/// Fewer pairs than this are never believed.
const FEWEST_PAIRS: usize = 6;

/// Lays `source` over `target` from anywhere. Non-finite points are left out.
///
/// Hypotheses come from pairs of points with like features that agree with each other in their distances; each is
/// refined, and judged by how much of the clouds then coincides. The answer says whether the best is to be believed.
/// Same input, same seed, same answer.
///
/// # Errors
/// `BadParam`, `TooFewPoints`, `Cloud`. That nothing was found is an answer.
pub fn register_global(
    source: &PointCloud,
    target: &PointCloud,
    params: &GlobalParams,
) -> Result<GlobalResult, RegistrationError> {
    params.validate()?;
    let (source, target) =
        rayon::join(|| Described::new("source", source, params), || Described::new("target", target, params));
    let (source, target) = (source?, target?);
    let pairs = matching::pairs(&source, &target, params);
    let candidates = match params.method {
        GlobalMethod::Consistency => consistency::candidates(&source, &target, &pairs, params),
        GlobalMethod::Ransac => ransac::candidates(&source, &target, &pairs, params),
    };
    if candidates.is_empty() {
        return Ok(GlobalResult::nothing(pairs.len()));
    }
    let judge = Judge::new(&source, &target, params)?;
    let mut verdicts: Vec<Verdict> = candidates.iter().map(|c| judge.refined(c)).collect();
    // Stable: of equals, the earlier candidate stays first.
    verdicts.sort_by(|a, b| b.overlap.total_cmp(&a.overlap));
    let best = &verdicts[0];
    let rival = verdicts[1..].iter().filter(|v| !v.is_like(best, params)).map(|v| v.overlap).fold(0.0, f64::max);
    Ok(judge.result(best, rival, pairs.len()))
}

/// A rigid motion that some pairs agree on.
#[derive(Debug, Clone)]
struct Candidate {
    t_target_source: Pose,
    num_pairs: usize,
}
