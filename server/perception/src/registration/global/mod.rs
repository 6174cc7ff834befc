//! Registration with no first guess: features, correspondences, consistency, verification, refinement.
//!
//! [`register_global`] goes through the files in this order: [`keypoints`] thins a cloud and describes it, [`matching`]
//! pairs what looks alike, [`consistency`] finds sets of pairs that a rigid motion allows, [`ransac`] is the older way to
//! do so, [`verify`] lays the clouds over each other and says whether that is right by the [`evidence`] of their
//! [`patches`], [`finish`] aligns them closely, [`uncertainty`] says how far off that may be.

mod consistency;
mod evidence;
mod finish;
mod keypoints;
mod matching;
mod params;
mod patches;
mod ransac;
mod rigid;
mod uncertainty;
mod verify;

#[cfg(test)]
mod tests;

pub use params::{GlobalMethod, GlobalOutcome, GlobalParams, GlobalResult};

use super::RegistrationError;
use keypoints::{Described, Keys};
use matching::Pair;
use percept_geometry::{PointCloud, Pose};
use std::borrow::Cow;
use verify::Judge;

/// Fewer pairs than this are never believed.
const FEWEST_PAIRS: usize = 6;
/// Neighbourhoods of features, voxels; each is tried when those before it gave nothing to believe.
const FEATURE_RADII: [f64; 3] = [5.0, 8.0, 3.5];

/// Lays `source` over `target` from anywhere. Non-finite points are left out.
///
/// Hypotheses come from pairs of points with like features that agree with each other in their distances; each is
/// refined, and judged by what coincides then that chance would not have coincide, and by what contradicts it: surface of
/// one cloud where the other saw something else. The answer says whether the best is to be believed.
/// Same input, same seed, same answer.
///
/// # Errors
/// `BadParam`, `TooFewPoints`, `Cloud`. That nothing was found is an answer.
pub fn register_global(
    source: &PointCloud,
    target: &PointCloud,
    params: &GlobalParams,
) -> Result<GlobalResult, RegistrationError> {
    let mut search = GlobalSearch::new(Cow::Borrowed(source), Cow::Borrowed(target), params)?;
    loop {
        if let Some(answer) = search.step() {
            return answer;
        }
    }
}

/// [`register_global`] in steps, for who has little time at once: at most seven.
pub struct GlobalSearch<'a> {
    params: GlobalParams,
    source: Cow<'a, PointCloud>,
    target: Cow<'a, PointCloud>,
    /// Both clouds described, from the first step on.
    judge: Option<Judge>,
    /// The neighbourhood that comes next, and the source's features of it.
    radius: usize,
    of_source: Option<Keys>,
    pairs: Vec<Pair>,
    answer: GlobalResult,
}

impl std::fmt::Debug for GlobalSearch<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GlobalSearch").field("radius", &self.radius).finish_non_exhaustive()
    }
}

impl GlobalSearch<'_> {
    /// More are never needed: to describe the clouds, then two for each neighbourhood.
    pub const MAX_STEPS: usize = 1 + 2 * FEATURE_RADII.len();
}

impl<'a> GlobalSearch<'a> {
    /// A search that has not begun.
    ///
    /// # Errors
    /// `BadParam`.
    pub fn new(
        source: Cow<'a, PointCloud>,
        target: Cow<'a, PointCloud>,
        params: &GlobalParams,
    ) -> Result<Self, RegistrationError> {
        params.validate()?;
        let (params, answer) = (params.clone(), GlobalResult::nothing(0));
        Ok(Self { params, source, target, judge: None, radius: 0, of_source: None, pairs: vec![], answer })
    }

    /// Goes on for one step; answers as [`register_global`] does once that was the last.
    pub fn step(&mut self) -> Option<Result<GlobalResult, RegistrationError>> {
        match self.advance() {
            Ok(false) => None,
            Ok(true) => Some(Ok(if self.params.refine { self.finished() } else { self.answer.clone() })),
            Err(error) => Some(Err(error)),
        }
    }

    /// The answer aligned closely, with how far off it may be.
    fn finished(&self) -> GlobalResult {
        let finish = |answer| finish::finish(answer, &self.source, &self.target, self.params.voxel_size_m);
        let fine = match &self.judge {
            Some(judge) if self.answer.outcome == GlobalOutcome::Found => judge.confirmed(&self.answer, finish),
            _ => finish(self.answer.clone()),
        };
        let covariance = self.judge.as_ref().and_then(|j| j.evidence.covariance(&fine.t_target_source));
        match covariance {
            // What the refinement says is open stays open.
            Some(covariance) if fine.degenerate_axes.contains(&true) => {
                GlobalResult { covariance: fine.covariance + covariance, ..fine }
            }
            Some(covariance) => GlobalResult { covariance, ..fine },
            None => fine,
        }
    }

    /// Whether there is nothing more to try.
    fn advance(&mut self) -> Result<bool, RegistrationError> {
        let Some(judge) = &self.judge else {
            let (source, target) = rayon::join(
                || Described::new("source", &self.source, &self.params),
                || Described::new("target", &self.target, &self.params),
            );
            self.judge = Some(Judge::new(source?, target?, &self.params)?);
            return Ok(false);
        };
        let Some(&radius) = FEATURE_RADII.get(self.radius) else { return Ok(true) };
        let Some(of_source) = self.of_source.take() else {
            self.of_source = Some(judge.source.keys(radius));
            return Ok(false);
        };
        self.pairs.extend(matching::pairs(&of_source, &judge.target.keys(radius)));
        let candidates = match self.params.method {
            GlobalMethod::Consistency => consistency::candidates(&self.pairs, &self.params),
            GlobalMethod::Ransac => ransac::candidates(&self.pairs, &self.params),
        };
        let found = judge.best(&candidates, self.pairs.len());
        if found.evidence >= self.answer.evidence {
            self.answer = found;
        }
        // Wider neighbourhoods tell more apart but reach over the edges of what both clouds saw: only if need be.
        self.radius += 1;
        Ok(self.answer.outcome == GlobalOutcome::Found || self.radius == FEATURE_RADII.len())
    }
}

/// A rigid motion that some pairs agree on.
#[derive(Debug, Clone)]
struct Candidate {
    t_target_source: Pose,
    num_pairs: usize,
}
