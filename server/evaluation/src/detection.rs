//! Found objects against true ones.

use crate::EvaluationError;
use percept_geometry::{ObjectClass, OrientedBox3};
use serde::Serialize;

/// An object that is there.
pub type TrueObject = (ObjectClass, OrientedBox3);

/// An object that was found: class, confidence, box.
pub type FoundObject = (ObjectClass, f64, OrientedBox3);

/// Counts of one class. Each is of objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ClassScore {
    /// The class.
    pub class: ObjectClass,
    /// True objects of this class.
    pub num_true: usize,
    /// Found objects called by this class.
    pub num_found: usize,
    /// True objects of this class found at all, under whatever name.
    pub num_located: usize,
    /// True objects of this class found and called so.
    pub num_correct: usize,
}

impl ClassScore {
    /// Share of the objects called so that are so; `None` if none is called so.
    pub fn precision(&self) -> Option<f64> {
        share(self.num_correct, self.num_found)
    }

    /// Share of the true objects that were found and called so; `None` if there is none.
    pub fn recall(&self) -> Option<f64> {
        share(self.num_correct, self.num_true)
    }
}

/// How well objects were found. Position is judged apart from class: a match needs overlap only.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DetectionScore {
    /// Found objects that match a true one.
    pub true_positives: usize,
    /// Found objects that match none.
    pub false_positives: usize,
    /// True objects that none matches.
    pub false_negatives: usize,
    /// True positives over found; `None` if nothing was found.
    pub precision: Option<f64>,
    /// True positives over true; `None` if there is nothing to find.
    pub recall: Option<f64>,
    /// Harmonic mean of precision and recall, 2 TP / (2 TP + FP + FN); `None` if all are 0.
    pub f1: Option<f64>,
    /// Mean overlap of the matches; `None` without a match.
    pub mean_iou: Option<f64>,
    /// Share of the matches whose class is right; `None` without a match.
    pub class_correct: Option<f64>,
    /// Classes that occur, in the order of [`ObjectClass::BUILT_IN`].
    pub classes: Vec<ClassScore>,
    /// Matches as (index in truth, index in found, overlap), in the order of falling confidence.
    pub matches: Vec<(usize, usize, f64)>,
}

/// Matches found objects to true ones, one to one, by 3D overlap of upright boxes (intersection over union) of at
/// least `iou_threshold`.
///
/// In the order of falling confidence (then of index) each found object takes the free true one that it
/// overlaps most, as in PASCAL VOC (Everingham et al. 2010) and SUN RGB-D (Song et al. 2015).
///
/// # Errors
/// `InvalidParam` if the threshold is not in (0, 1] or a confidence is NaN.
pub fn match_detections(
    truth: &[TrueObject],
    found: &[FoundObject],
    iou_threshold: f64,
) -> Result<DetectionScore, EvaluationError> {
    if !(iou_threshold > 0.0 && iou_threshold <= 1.0) {
        let (field, requirement) = ("iou_threshold", "above 0 and at most 1");
        return Err(EvaluationError::InvalidParam { field, value: iou_threshold, requirement });
    }
    if let Some(&(_, value, _)) = found.iter().find(|f| f.1.is_nan()) {
        return Err(EvaluationError::InvalidParam { field: "confidence", value, requirement: "a number" });
    }
    let matches = greedy(truth, found, iou_threshold);
    let true_positives = matches.len();
    let (false_positives, false_negatives) = (found.len() - true_positives, truth.len() - true_positives);
    let correct = matches.iter().filter(|&&(t, f, _)| truth[t].0 == found[f].0).count();
    let iou_sum: f64 = matches.iter().map(|m| m.2).sum();
    Ok(DetectionScore {
        true_positives,
        false_positives,
        false_negatives,
        precision: share(true_positives, found.len()),
        recall: share(true_positives, truth.len()),
        f1: share(2 * true_positives, found.len() + truth.len()),
        mean_iou: (true_positives > 0).then(|| iou_sum / true_positives as f64),
        class_correct: share(correct, true_positives),
        classes: by_class(truth, found, &matches),
        matches,
    })
}

fn greedy(truth: &[TrueObject], found: &[FoundObject], iou_threshold: f64) -> Vec<(usize, usize, f64)> {
    let mut order: Vec<usize> = (0..found.len()).collect();
    order.sort_by(|&a, &b| found[b].1.total_cmp(&found[a].1).then(a.cmp(&b)));
    let mut taken = vec![false; truth.len()];
    let mut matches = Vec::new();
    for f in order {
        let mut best: Option<(usize, f64)> = None;
        for t in (0..truth.len()).filter(|&t| !taken[t]) {
            let iou = truth[t].1.iou_upright(&found[f].2);
            if iou >= iou_threshold && best.is_none_or(|(_, most)| iou > most) {
                best = Some((t, iou));
            }
        }
        if let Some((t, iou)) = best {
            taken[t] = true;
            matches.push((t, f, iou));
        }
    }
    matches
}

fn by_class(truth: &[TrueObject], found: &[FoundObject], matches: &[(usize, usize, f64)]) -> Vec<ClassScore> {
    let count = |class| ClassScore {
        class,
        num_true: truth.iter().filter(|t| t.0 == class).count(),
        num_found: found.iter().filter(|f| f.0 == class).count(),
        num_located: matches.iter().filter(|m| truth[m.0].0 == class).count(),
        num_correct: matches.iter().filter(|m| truth[m.0].0 == class && found[m.1].0 == class).count(),
    };
    ObjectClass::BUILT_IN.into_iter().map(count).filter(|c| c.num_true + c.num_found > 0).collect()
}

pub(crate) fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};
    use proptest::prelude::*;

    fn cube(x: f64) -> OrientedBox3 {
        OrientedBox3::upright(Point3::new(x, 0.0, 0.5), Vector3::repeat(1.0), 0.0)
    }

    #[test]
    fn counts_overlap_and_classes_by_hand() {
        use ObjectClass::{Box, Chair, Table};
        let truth = [(Table, cube(0.0)), (Chair, cube(5.0)), (Chair, cube(10.0))];
        // Overlap with the table is 1 and 1/3; the surer one takes it, the other is left over.
        let found = [(Table, 0.6, cube(0.0)), (Table, 0.9, cube(0.5)), (Box, 0.5, cube(5.0)), (Chair, 0.1, cube(20.0))];
        let score = match_detections(&truth, &found, 0.25).unwrap();
        assert_eq!((score.true_positives, score.false_positives, score.false_negatives), (2, 2, 1));
        assert_eq!((score.precision, score.recall, score.f1), (Some(0.5), Some(2.0 / 3.0), Some(4.0 / 7.0)));
        assert!((score.mean_iou.unwrap() - (1.0 + 1.0 / 3.0) / 2.0).abs() < 1e-12);
        assert_eq!(score.class_correct, Some(0.5));
        let chair = score.classes.iter().find(|c| c.class == Chair).unwrap();
        assert_eq!((chair.num_true, chair.num_found, chair.num_located, chair.num_correct), (2, 1, 1, 0));
        assert_eq!((chair.precision(), chair.recall()), (Some(0.0), Some(0.0)));
        assert_eq!(score.classes.len(), 3);
    }

    #[test]
    fn nothing_to_find_is_not_a_score_of_zero() {
        let score = match_detections(&[], &[], 0.25).unwrap();
        assert_eq!((score.precision, score.recall, score.f1, score.mean_iou), (None, None, None, None));
        assert!(match_detections(&[], &[], 0.0).is_err());
        assert!(match_detections(&[], &[(ObjectClass::Box, f64::NAN, cube(0.0))], 0.5).is_err());
    }

    proptest! {
        #[test]
        fn matches_are_one_to_one_and_above_the_threshold(
            truth in prop::collection::vec(0.0..6.0f64, 0..8),
            found in prop::collection::vec((0.0..6.0f64, 0.0..1.0f64), 0..8),
            threshold in 0.05..0.95f64,
        ) {
            let truth: Vec<TrueObject> = truth.iter().map(|&x| (ObjectClass::Box, cube(x))).collect();
            let found: Vec<FoundObject> = found.iter().map(|&(x, c)| (ObjectClass::Box, c, cube(x))).collect();
            let score = match_detections(&truth, &found, threshold).unwrap();
            let mut ts: Vec<usize> = score.matches.iter().map(|m| m.0).collect();
            let mut fs: Vec<usize> = score.matches.iter().map(|m| m.1).collect();
            ts.sort_unstable();
            fs.sort_unstable();
            ts.dedup();
            fs.dedup();
            prop_assert_eq!((ts.len(), fs.len()), (score.true_positives, score.true_positives));
            prop_assert!(score.matches.iter().all(|m| m.2 >= threshold));
            // Maximal: whatever is left over overlaps nothing that is left over.
            for t in (0..truth.len()).filter(|t| !ts.contains(t)) {
                for f in (0..found.len()).filter(|f| !fs.contains(f)) {
                    prop_assert!(truth[t].1.iou_upright(&found[f].2) < threshold);
                }
            }
        }
    }
}
