//! FAST-9 corners with the exact score, largest among their neighbours.
//!
//! **Source:** Rosten and Drummond, "Machine learning for high-speed corner detection", ECCV 2006. The score of a pixel
//! is the largest threshold at which 9 of the 16 pixels around it in a row are all brighter, or all darker, by more
//! than the threshold. It is computed for every pixel of a block that may hold a corner, without branches: about 130
//! byte operations a pixel, 32 pixels at a time.

use super::pyramid::Level;
use percept_geometry::by_processor;

/// A corner: column, row, score.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Corner {
    pub(super) u: u16,
    pub(super) v: u16,
    pub(super) score: u8,
}

/// The circle of radius 3, clockwise from the top: (dx, dy).
const RING: [(isize, isize); 16] = [
    (0, -3),
    (1, -3),
    (2, -2),
    (3, -1),
    (3, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 3),
    (-1, 3),
    (-2, 2),
    (-3, 1),
    (-3, 0),
    (-3, -1),
    (-2, -2),
    (-1, -3),
];

/// Pixels decided on at once.
const BLOCK: usize = 32;

/// Corners with a score above `threshold`, at least `margin` (3 or more) from the border, row by row.
///
/// Of neighbouring corners the one with the largest score is kept, of equal ones the first.
pub(super) fn corners(level: &Level, threshold: u8, margin: usize) -> Vec<Corner> {
    let margin = margin.max(3);
    let mut out = Vec::new();
    if level.width <= 2 * margin || level.height <= 2 * margin {
        return out;
    }
    // Scores of three rows, with a column of zeros at each end.
    let n = level.width - 2 * margin;
    let mut scores: [Vec<u8>; 3] = std::array::from_fn(|_| vec![0u8; n + 2]);
    let mut busy = [false; 3];
    for v in margin..=level.height - margin {
        let now = v % 3;
        let row = &mut scores[now][1..=n];
        if v < level.height - margin {
            let start = v * level.stride + margin;
            busy[now] = score_row(&level.data, start, level.stride, threshold, row);
        } else {
            row.fill(0);
        }
        if v > margin && busy[(v - 1) % 3] {
            maxima(&scores[(v + 1) % 3], &scores[(v - 1) % 3], &scores[now], |i, score| {
                out.push(Corner { u: (margin + i) as u16, v: (v - 1) as u16, score });
            });
        }
        // The row that comes next takes the place of the oldest.
    }
    out
}

/// Calls back for each largest of its 3 x 3 neighbours.
fn maxima(above: &[u8], row: &[u8], below: &[u8], mut found: impl FnMut(usize, u8)) {
    let n = row.len() - 2;
    for start in (0..n).step_by(16) {
        let end = (start + 16).min(n);
        if row[start + 1..end + 1].iter().fold(0, |a, &b| a | b) == 0 {
            continue;
        }
        for i in start..end {
            let s = row[i + 1];
            let before = above[i].max(above[i + 1]).max(above[i + 2]).max(row[i]);
            let after = below[i].max(below[i + 1]).max(below[i + 2]).max(row[i + 2]);
            if s > before && s >= after && s > 0 {
                found(i, s);
            }
        }
    }
}

by_processor! {
    /// Scores of a row, 0 where not above the threshold; whether there are others than 0.
    fn score_row(data: &[u8], start: usize, stride: usize, threshold: u8, out: &mut [u8]) -> bool {
        let n = out.len();
        let ring: [&[u8]; 16] = RING.map(|(dx, dy)| {
            let at = (start as isize + dy * stride as isize + dx) as usize;
            &data[at..at + n]
        });
        let centre = &data[start..start + n];
        let mut any = false;
        let mut at = 0;
        while at < n {
            // The last block overlaps the one before it.
            let len = BLOCK.min(n);
            let from = at.min(n - len);
            let part = &mut out[from..from + len];
            let c = &centre[from..from + len];
            let r = |k: usize| &ring[k][from..from + len];
            if len == BLOCK {
                let c: &[u8; BLOCK] = c.try_into().unwrap_or(&[0; BLOCK]);
                let fixed = |k: usize| -> &[u8; BLOCK] { r(k).try_into().unwrap_or(&[0; BLOCK]) };
                if may_hold(c, [fixed(0), fixed(4), fixed(8), fixed(12)], threshold) {
                    let ring: [&[u8; BLOCK]; 16] = std::array::from_fn(fixed);
                    let scored = score_block(c, &ring, threshold);
                    any |= scored.iter().fold(0, |a, &b| a | b) != 0;
                    part.copy_from_slice(&scored);
                } else {
                    part.fill(0);
                }
            } else {
                for i in 0..len {
                    part[i] = score(c[i], std::array::from_fn(|k| r(k)[i]), threshold);
                    any |= part[i] != 0;
                }
            }
            at += len;
        }
        any
    }
}

/// Whether one of the pixels may be a corner: of two opposite pixels an arc of 9 holds one at least.
#[inline(always)]
fn may_hold(c: &[u8; BLOCK], [top, right, bottom, left]: [&[u8; BLOCK]; 4], threshold: u8) -> bool {
    let mut most = 0;
    for i in 0..BLOCK {
        let brighter = top[i].max(bottom[i]).min(right[i].max(left[i])).saturating_sub(c[i]);
        let darker = c[i].saturating_sub(top[i].min(bottom[i]).max(right[i].min(left[i])));
        most = brighter.max(darker).max(most);
    }
    most > threshold
}

#[inline(always)]
fn score_block(c: &[u8; BLOCK], ring: &[&[u8; BLOCK]; 16], threshold: u8) -> [u8; BLOCK] {
    let mut out = [0; BLOCK];
    for i in 0..BLOCK {
        out[i] = score(c[i], std::array::from_fn(|k| ring[k][i]), threshold);
    }
    out
}

/// The largest over arcs of 9 of the least difference, if above the threshold, else 0.
#[inline(always)]
fn score(c: u8, p: [u8; 16], threshold: u8) -> u8 {
    // The least of the ring's brightest arc, and the largest of its darkest: two arcs share 8 pixels.
    let (mut bright, mut dark) = (0u8, 255u8);
    let mut low = [0u8; 8];
    let mut high = [0u8; 8];
    for j in 0..8 {
        low[j] = p[2 * j + 1].min(p[(2 * j + 2) % 16]);
        high[j] = p[2 * j + 1].max(p[(2 * j + 2) % 16]);
    }
    let low4: [u8; 8] = [
        low[0].min(low[1]),
        low[1].min(low[2]),
        low[2].min(low[3]),
        low[3].min(low[4]),
        low[4].min(low[5]),
        low[5].min(low[6]),
        low[6].min(low[7]),
        low[7].min(low[0]),
    ];
    let high4: [u8; 8] = [
        high[0].max(high[1]),
        high[1].max(high[2]),
        high[2].max(high[3]),
        high[3].max(high[4]),
        high[4].max(high[5]),
        high[5].max(high[6]),
        high[6].max(high[7]),
        high[7].max(high[0]),
    ];
    for j in 0..8 {
        // Pixels 2j + 1 ..= 2j + 8, and one more at either end.
        let (first, last) = (p[2 * j], p[(2 * j + 9) % 16]);
        bright = bright.max(low4[j].min(low4[(j + 2) % 8]).min(first.max(last)));
        dark = dark.min(high4[j].max(high4[(j + 2) % 8]).max(first.min(last)));
    }
    let score = bright.saturating_sub(c).max(c.saturating_sub(dark));
    if score > threshold { score } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By the definition: arcs counted one by one.
    fn by_definition(level: &Level, u: usize, v: usize) -> u8 {
        let at = |dx: isize, dy: isize| i32::from(level.row((v as isize + dy) as usize)[(u as isize + dx) as usize]);
        let difference: Vec<i32> = RING.iter().map(|&(dx, dy)| at(dx, dy) - at(0, 0)).collect();
        let arc =
            |sign: i32| (0..16).map(|s| (0..9).map(|k| sign * difference[(s + k) % 16]).min().unwrap()).max().unwrap();
        arc(1).max(arc(-1)).max(0) as u8
    }

    #[test]
    fn scores_are_those_of_the_definition() {
        let (w, h) = (71, 40);
        let mut state = 1u32;
        let data: Vec<u8> = (0..w * h)
            .map(|i| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                if (i % w / 9 + i / w / 7) % 2 == 0 { 200 - (state >> 28) as u8 } else { 20 + (state >> 27) as u8 }
            })
            .collect();
        let level = Level { width: w, height: h, stride: w, data };
        let mut row = vec![0; w - 6];
        for v in 3..h - 3 {
            score_row(&level.data, v * w + 3, w, 10, &mut row);
            for u in 3..w - 3 {
                let truth = by_definition(&level, u, v);
                assert_eq!(row[u - 3], if truth > 10 { truth } else { 0 }, "{u} {v}");
            }
        }
        let found = corners(&level, 10, 3);
        assert!(found.len() > 20);
        for c in &found {
            assert_eq!(c.score, by_definition(&level, usize::from(c.u), usize::from(c.v)));
        }
    }

    #[test]
    fn an_image_smaller_than_its_margin_has_no_corners() {
        let level = Level { width: 6, height: 6, stride: 6, data: vec![0; 36] };
        assert!(corners(&level, 10, 3).is_empty());
    }
}
