//! Registration with no first guess: features, correspondences, consistency, verification, refinement.
//!
//! [`register_global`] goes through the files in this order: [`keypoints`] thins a cloud and describes it, [`matching`]
//! pairs what looks alike, [`consistency`] finds sets of pairs that a rigid motion allows, [`ransac`] is the older way to
//! do so, [`verify`] lays the clouds over each other and says whether that is right,
//! [`finish`] aligns them closely.

mod consistency;
mod finish;
mod keypoints;
mod matching;
mod params;
mod ransac;
mod rigid;
mod verify;

#[cfg(test)]
mod tests;

pub use params::{GlobalMethod, GlobalOutcome, GlobalParams, GlobalResult};

use super::RegistrationError;
use keypoints::Described;
use matching::Pair;
use percept_geometry::{PointCloud, Pose};
use verify::Judge;

/// Fewer pairs than this are never believed.
const FEWEST_PAIRS: usize = 6;
/// Neighbourhoods of features, voxels; each is tried when those before it gave nothing to believe.
const FEATURE_RADII: [f64; 3] = [5.0, 8.0, 3.5];

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
    let described =
        rayon::join(|| Described::new("source", source, params), || Described::new("target", target, params));
    let (whole_source, whole_target) = (source, target);
    let (source, target) = (described.0?, described.1?);
    let judge = Judge::new(&source, &target, params)?;
    let mut pairs: Vec<Pair> = Vec::new();
    let mut answer = GlobalResult::nothing(0);
    // Wider neighbourhoods tell more apart but reach over the edges of what both clouds saw: only if need be.
    for radius in FEATURE_RADII {
        let (of_source, of_target) = rayon::join(|| source.keys(radius), || target.keys(radius));
        pairs.extend(matching::pairs(&of_source, &of_target));
        let candidates = match params.method {
            GlobalMethod::Consistency => consistency::candidates(&pairs, params),
            GlobalMethod::Ransac => ransac::candidates(&pairs, params),
        };
        let found = judge.best(&candidates, pairs.len());
        if found.overlap >= answer.overlap {
            answer = found;
        }
        if answer.outcome == GlobalOutcome::Found {
            break;
        }
    }
    Ok(match params.refine {
        true => finish::finish(answer, whole_source, whole_target, params.voxel_size_m),
        false => answer,
    })
}

/// A rigid motion that some pairs agree on.
#[derive(Debug, Clone)]
struct Candidate {
    t_target_source: Pose,
    num_pairs: usize,
}
