//! Which pixels lie at a jump in depth.

use super::positive;
use percept_geometry::{DepthImage, GeometryError};
use serde::{Deserialize, Serialize};

/// When two neighbouring pixels lie on two surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EdgeParams {
    /// Part of the depth by which the farther pixel has to lie behind the nearer one.
    pub min_jump_fraction: f64,
    /// Pixels around an edge that are marked too: flying pixels sit there.
    pub margin_px: usize,
}

impl Default for EdgeParams {
    fn default() -> Self {
        Self { min_jump_fraction: 0.05, margin_px: 1 }
    }
}

/// Which pixels lie at a depth discontinuity, `H x W` row-major: those that jump against one of their four
/// neighbours, and all within the margin around them (a square). Pixels without return make no edge.
///
/// # Errors
/// `OutOfRange` naming the parameter.
pub fn edge_mask(depth: &DepthImage, params: &EdgeParams) -> Result<Vec<bool>, GeometryError> {
    positive("min_jump_fraction", params.min_jump_fraction)?;
    if params.margin_px > 64 {
        let value = params.margin_px as f64;
        return Err(GeometryError::OutOfRange { field: "margin_px", value, requirement: "at most 64" });
    }
    let (w, h, data) = (depth.width(), depth.height(), depth.data());
    let jump = params.min_jump_fraction as f32;
    let differs = |a: f32, b: f32| a > 0.0 && b > 0.0 && (a - b).abs() > jump * a.min(b);
    let mut mask = vec![false; data.len()];
    for v in 0..h {
        for u in 0..w {
            let i = v * w + u;
            if u + 1 < w && differs(data[i], data[i + 1]) {
                (mask[i], mask[i + 1]) = (true, true);
            }
            if v + 1 < h && differs(data[i], data[i + w]) {
                (mask[i], mask[i + w]) = (true, true);
            }
        }
    }
    Ok(if params.margin_px == 0 { mask } else { dilate(&mask, w, h, params.margin_px) })
}

/// A square dilation, rows then columns.
fn dilate(mask: &[bool], w: usize, h: usize, margin: usize) -> Vec<bool> {
    let mut rows = vec![false; mask.len()];
    for (i, _) in mask.iter().enumerate().filter(|(_, m)| **m) {
        let (u, row) = (i % w, i - i % w);
        rows[row + u.saturating_sub(margin)..=row + (u + margin).min(w - 1)].fill(true);
    }
    let mut out = vec![false; mask.len()];
    for (i, _) in rows.iter().enumerate().filter(|(_, m)| **m) {
        let (u, v) = (i % w, i / w);
        for y in v.saturating_sub(margin)..=(v + margin).min(h - 1) {
            out[y * w + u] = true;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step() -> DepthImage {
        let data = (0..40 * 30).map(|i| if i % 40 < 20 { 1.0 } else { 2.0 }).collect();
        DepthImage::new(40, 30, data).unwrap()
    }

    #[test]
    fn edges_are_marked_on_both_sides_and_nowhere_else() {
        let mask = edge_mask(&step(), &EdgeParams { margin_px: 0, ..Default::default() }).unwrap();
        assert!(mask.iter().enumerate().all(|(i, m)| *m == (19..=20).contains(&(i % 40))));
        let mask = edge_mask(&step(), &EdgeParams { margin_px: 2, ..Default::default() }).unwrap();
        assert!(mask.iter().enumerate().all(|(i, m)| *m == (17..=22).contains(&(i % 40))));
    }
}
