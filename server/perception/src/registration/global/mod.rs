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
use std::ops::ControlFlow;
use verify::{Confirming, Judge, Judged, Refined};

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

/// [`register_global`] in steps, for who has little time at once: at most [`GlobalSearch::MAX_STEPS`].
pub struct GlobalSearch<'a> {
    params: GlobalParams,
    source: Cow<'a, PointCloud>,
    target: Cow<'a, PointCloud>,
    /// Both clouds described, from the first step on.
    judge: Option<Judge>,
    /// Of the neighbourhood that is being tried.
    radius: usize,
    next: Stage,
    pairs: Vec<Pair>,
    best: Judged,
}

/// What the next step does.
enum Stage {
    /// Describes both clouds.
    Describe,
    /// Finds what is particular in the source, for a neighbourhood.
    Source,
    /// The same in the target, and what looks alike in both.
    Target(Keys),
    /// Finds motions that pairs agree on.
    Agree,
    /// Refines the likeliest of these.
    Refine(Vec<Candidate>),
    /// Says which of them it is, and whether to believe it.
    Judge(Vec<Refined>),
    /// Aligns the answer closely.
    Finish,
    /// Says whether to believe it still, or tries another close alignment first.
    Confirm(Confirming),
}

impl std::fmt::Debug for GlobalSearch<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GlobalSearch").field("radius", &self.radius).finish_non_exhaustive()
    }
}

impl GlobalSearch<'_> {
    /// More are never needed: to describe the clouds, five for each neighbourhood, to finish and to confirm.
    pub const MAX_STEPS: usize = 3 + 5 * FEATURE_RADII.len() + evidence::TURNS;
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
        let (params, best) = (params.clone(), Judged::nothing(0));
        Ok(Self { params, source, target, judge: None, radius: 0, next: Stage::Describe, pairs: vec![], best })
    }

    /// Goes on for one step; answers as [`register_global`] does once that was the last.
    pub fn step(&mut self) -> Option<Result<GlobalResult, RegistrationError>> {
        match self.advance() {
            Ok(Some(next)) => {
                self.next = next;
                None
            }
            Ok(None) => Some(Ok(self.best.answer.clone())),
            Err(error) => Some(Err(error)),
        }
    }

    /// One step; what comes next, if anything does.
    fn advance(&mut self) -> Result<Option<Stage>, RegistrationError> {
        let Some(judge) = &self.judge else {
            let (source, target) = rayon::join(
                || Described::new("source", &self.source, &self.params),
                || Described::new("target", &self.target, &self.params),
            );
            self.judge = Some(Judge::new(source?, target?, &self.params)?);
            return Ok(Some(Stage::Source));
        };
        let radius = FEATURE_RADII[self.radius];
        Ok(match std::mem::replace(&mut self.next, Stage::Finish) {
            Stage::Describe | Stage::Source => Some(Stage::Target(judge.source.keys(radius))),
            Stage::Target(of_source) => {
                self.pairs.extend(matching::pairs(&of_source, &judge.target.keys(radius)));
                Some(Stage::Agree)
            }
            Stage::Agree => Some(Stage::Refine(match self.params.method {
                GlobalMethod::Consistency => consistency::candidates(&self.pairs, &self.params),
                GlobalMethod::Ransac => ransac::candidates(&self.pairs, &self.params),
            })),
            Stage::Refine(candidates) => Some(Stage::Judge(judge.refine(&candidates))),
            Stage::Judge(refined) => {
                let found = judge.judged(&refined, self.pairs.len());
                if found.answer.evidence >= self.best.answer.evidence {
                    self.best = found;
                }
                // Wider neighbourhoods tell more apart but reach over the edges of what both clouds saw: only if need be.
                if self.best.answer.outcome != GlobalOutcome::Found && self.radius + 1 < FEATURE_RADII.len() {
                    self.radius += 1;
                    Some(Stage::Source)
                } else {
                    self.params.refine.then_some(Stage::Finish)
                }
            }
            Stage::Finish if self.best.answer.outcome == GlobalOutcome::Found => {
                Some(Stage::Confirm(judge.confirming(&self.best, |answer| self.aligned(answer))))
            }
            Stage::Finish => {
                self.best.answer = measured(judge, self.aligned(self.best.answer.clone()));
                None
            }
            Stage::Confirm(confirming) => match judge.confirm(&self.best, confirming, |answer| self.aligned(answer)) {
                ControlFlow::Break(answer) => {
                    self.best.answer = measured(judge, answer);
                    None
                }
                ControlFlow::Continue(confirming) => Some(Stage::Confirm(confirming)),
            },
        })
    }

    fn aligned(&self, answer: GlobalResult) -> GlobalResult {
        finish::finish(answer, &self.source, &self.target, self.params.voxel_size_m)
    }
}

/// The answer with how far off it may be.
fn measured(judge: &Judge, fine: GlobalResult) -> GlobalResult {
    match judge.evidence.covariance(&fine.t_target_source) {
        // What the refinement says is open stays open.
        Some(covariance) if fine.degenerate_axes.contains(&true) => {
            GlobalResult { covariance: fine.covariance + covariance, ..fine }
        }
        Some(covariance) => GlobalResult { covariance, ..fine },
        None => fine,
    }
}

/// A rigid motion that some pairs agree on.
#[derive(Debug, Clone)]
struct Candidate {
    t_target_source: Pose,
    num_pairs: usize,
}
