//! An occupancy grid against the true one.

use crate::{EvaluationError, detection::share};
use serde::Serialize;

/// Agreement of two grids. Shares are in 0..1 and `None` where their whole is empty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OccupancyScore {
    /// Cells occupied in both over cells occupied in either, among the cells known in both; no tolerance.
    pub iou: Option<f64>,
    /// Of the cells estimated as occupied where the truth is known: share with a truly occupied cell within tolerance.
    pub precision: Option<f64>,
    /// Of the truly occupied cells: share with a cell estimated as occupied within tolerance. Unknown counts as missed.
    pub recall: Option<f64>,
    /// Of the truly free cells known in the estimate: share estimated as free.
    pub free_accuracy: Option<f64>,
    /// Of the cells known in the truth: share unknown in the estimate.
    pub unknown_share: Option<f64>,
}

/// Compares two `H x W` row-major grids over the same ground: `Some(true)` occupied, `Some(false)` free, `None`
/// unknown (in the truth: does not count).
///
/// `tolerance_cells` is how far off (in columns and in rows) an occupied cell may be for precision and recall: 1
/// forgives a wall that lies on a border between cells.
///
/// # Errors
/// `ShapeMismatch` if a grid does not fill its width or they differ in size.
pub fn score_occupancy(
    width: usize,
    truth: &[Option<bool>],
    estimate: &[Option<bool>],
    tolerance_cells: usize,
) -> Result<OccupancyScore, EvaluationError> {
    if estimate.len() != truth.len() {
        let (expected, actual) = (truth.len(), estimate.len());
        return Err(EvaluationError::ShapeMismatch { field: "estimate", expected, actual });
    }
    let height = truth.len().checked_div(width).unwrap_or(0);
    if width * height != truth.len() {
        let (expected, actual) = (width * height, truth.len());
        return Err(EvaluationError::ShapeMismatch { field: "truth", expected, actual });
    }
    let near_truth = dilated(width, height, truth, tolerance_cells);
    let near_estimate = dilated(width, height, estimate, tolerance_cells);
    let count = |test: &dyn Fn(usize) -> bool| (0..truth.len()).filter(|&i| test(i)).count();
    let (t, e) = (|i: usize| truth[i], |i: usize| estimate[i]);
    let occupied = Some(true);
    let both = count(&|i| t(i) == occupied && e(i) == occupied);
    let either = count(&|i| t(i).is_some() && e(i).is_some() && (t(i) == occupied || e(i) == occupied));
    let claimed = count(&|i| t(i).is_some() && e(i) == occupied);
    let real = count(&|i| t(i) == occupied);
    let known = count(&|i| t(i).is_some());
    let free = count(&|i| t(i) == Some(false) && e(i).is_some());
    Ok(OccupancyScore {
        iou: share(both, either),
        precision: share(count(&|i| t(i).is_some() && e(i) == occupied && near_truth[i]), claimed),
        recall: share(count(&|i| t(i) == occupied && near_estimate[i]), real),
        free_accuracy: share(count(&|i| t(i) == Some(false) && e(i) == Some(false)), free),
        unknown_share: share(count(&|i| t(i).is_some() && e(i).is_none()), known),
    })
}

/// Whether an occupied cell lies within `reach` columns and rows of each cell.
fn dilated(width: usize, height: usize, cells: &[Option<bool>], reach: usize) -> Vec<bool> {
    let mut out = vec![false; cells.len()];
    for y in 0..height {
        for x in 0..width {
            if cells[y * width + x] != Some(true) {
                continue;
            }
            for v in y.saturating_sub(reach)..=y.saturating_add(reach).min(height - 1) {
                for u in x.saturating_sub(reach)..=x.saturating_add(reach).min(width - 1) {
                    out[v * width + u] = true;
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(rows: &[&str]) -> Vec<Option<bool>> {
        let cell = |c| match c {
            '#' => Some(true),
            '.' => Some(false),
            _ => None,
        };
        rows.iter().flat_map(|r| r.chars().map(cell)).collect()
    }

    #[test]
    fn shares_by_hand_with_and_without_tolerance() {
        let truth = grid(&["####", "....", "...?"]);
        let estimate = grid(&["##..", "..#.", "?.##"]);
        let strict = score_occupancy(4, &truth, &estimate, 0).unwrap();
        // Known in both 10; occupied in both 2; in either 6.
        assert_eq!(strict.iou, Some(2.0 / 6.0));
        assert_eq!((strict.precision, strict.recall), (Some(2.0 / 4.0), Some(2.0 / 4.0)));
        assert_eq!((strict.free_accuracy, strict.unknown_share), (Some(4.0 / 6.0), Some(1.0 / 11.0)));
        let loose = score_occupancy(4, &truth, &estimate, 1).unwrap();
        assert_eq!((loose.precision, loose.recall), (Some(3.0 / 4.0), Some(1.0)));
        assert_eq!(loose.iou, strict.iou);
    }

    #[test]
    fn a_grid_agrees_with_itself_and_an_empty_one_with_nothing() {
        let truth = grid(&["#.", ".#"]);
        let score = score_occupancy(2, &truth, &truth, 0).unwrap();
        assert_eq!((score.iou, score.precision, score.recall), (Some(1.0), Some(1.0), Some(1.0)));
        let empty = score_occupancy(0, &[], &[], 3).unwrap();
        assert_eq!((empty.iou, empty.recall, empty.unknown_share), (None, None, None));
        assert!(score_occupancy(3, &truth, &truth, 0).is_err());
        assert!(score_occupancy(2, &truth, &truth[..2], 0).is_err());
    }
}
