//! A grid as bits, by rows and by columns, so that 64 cells are looked at in one step.

/// Bits of a grid's lines, 1 where blocked, with a blocked word before and after each line and a blocked line before the
/// first and after the last. Cell `at` of a line is bit `at + 64` of it; line `line` of the grid is line `line + 1` here.
#[derive(Debug, Default)]
pub(crate) struct BitLines {
    words: Vec<u64>,
    /// Words a line.
    stride: usize,
}

/// Where a scan along a line ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stop {
    /// At a cell with a neighbour beside it that only a way through it reaches: one side is free, and blocked a cell before.
    Jump {
        /// Position in the line.
        at: usize,
    },
    /// Before a blocked cell.
    Blocked {
        /// Position in the line, one beyond the cells if that is where it ended; the line's begin counts as 0 - 1.
        at: isize,
    },
}

impl BitLines {
    /// Rows of a row-major `height x width` grid. Its length has to fit.
    pub(crate) fn rows(blocked: &[bool], width: usize, height: usize) -> Self {
        let mut out = Self::solid(width, height);
        for (y, row) in blocked.chunks(width.max(1)).enumerate() {
            let line = &mut out.words[(y + 1) * out.stride + 1..];
            for (word, cells) in line.iter_mut().zip(row.chunks(64)) {
                *word = if cells.len() == 64 { packed(cells) } else { packed(cells) | u64::MAX << cells.len() };
            }
        }
        out
    }

    /// The same grid by columns: `width` and `height` are of the rows.
    pub(crate) fn transposed(&self, width: usize, height: usize) -> Self {
        let mut out = Self::solid(height, width);
        let mut block = [0; 64];
        for (column, first_x) in (0..width).step_by(64).enumerate() {
            for (row, first_y) in (0..height).step_by(64).enumerate() {
                for (i, word) in block.iter_mut().enumerate() {
                    let source = (first_y + i + 1) * self.stride + column + 1;
                    *word = if first_y + i < height { self.words[source] } else { u64::MAX };
                }
                transpose(&mut block);
                for (i, word) in block.iter().enumerate().take(width - first_x) {
                    out.words[(first_x + i + 1) * out.stride + row + 1] = *word;
                }
            }
        }
        out
    }

    /// Places for each cell where a scan along a line stops beside the end of an obstacle, in either direction, by every fourth
    /// line; `width` and `height` are of the lines.
    pub(crate) fn jump_density(&self, width: usize, height: usize) -> f64 {
        const EVERY: usize = 4;
        let mut stops = 0u64;
        for line in (0..height).step_by(EVERY) {
            let (before, own, after) = self.around(line);
            let mut last = [u64::MAX; 3];
            for ((&b, &o), &a) in before.iter().zip(own).zip(after) {
                let shifted = |now: u64, last: u64| now << 1 | last >> 63;
                // Cells that are free, and the one before them, too.
                let is_free = !o & !shifted(o, last[1]);
                let ends = |side: u64, last: u64| ((side ^ shifted(side, last)) & is_free).count_ones();
                stops += u64::from(ends(b, last[0]) + ends(a, last[2]));
                last = [b, o, a];
            }
        }
        stops as f64 / (width * height.div_ceil(EVERY)).max(1) as f64
    }

    fn solid(length: usize, lines: usize) -> Self {
        let stride = length / 64 + 3;
        Self { words: vec![u64::MAX; stride * (lines + 2)], stride }
    }

    /// The three cells of a line at `at - 1`, `at`, `at + 1` as bits 0 to 2; the line may be one beyond either end.
    #[inline]
    pub(crate) fn three(&self, line: isize, at: usize) -> u32 {
        let first = at + 63;
        let word = (line + 1) as usize * self.stride + first / 64;
        let low = self.words[word] >> (first % 64);
        // A shift by 64 in two steps, for the case that all three are in the first word.
        let high = self.words[word + 1] << 1 << (63 - first % 64);
        (low | high) as u32 & 7
    }

    /// Blocks or frees a cell.
    pub(crate) fn set(&mut self, line: usize, at: usize, is_blocked: bool) {
        let (word, bit) = ((line + 1) * self.stride + at / 64 + 1, at % 64);
        self.words[word] = self.words[word] & !(1 << bit) | u64::from(is_blocked) << bit;
    }

    /// Whether a cell, which may be one beyond any end, is blocked.
    #[inline]
    pub(crate) fn is_blocked(&self, line: isize, at: isize) -> bool {
        let bit = (at + 64) as usize;
        self.words[(line + 1) as usize * self.stride + bit / 64] >> (bit % 64) & 1 == 1
    }

    /// Goes from a free cell towards larger positions.
    pub(crate) fn scan_up(&self, line: usize, at: usize) -> Stop {
        let first = at / 64 + 1;
        let (before, own, after) = self.around(line);
        let mut beyond = u64::MAX << (at % 64) << 1;
        let (mut carry_before, mut carry_after) = (0, 0);
        for (i, ((&b, &o), &a)) in before[first..].iter().zip(&own[first..]).zip(&after[first..]).enumerate() {
            let forced = ((b << 1 | carry_before) & !b) | ((a << 1 | carry_after) & !a);
            let hit = (o | forced) & beyond;
            if hit != 0 {
                let bit = hit.trailing_zeros();
                let found = (first + i - 1) * 64 + bit as usize;
                let is_blocked = o >> bit & 1 == 1;
                return if is_blocked { Stop::Blocked { at: found as isize } } else { Stop::Jump { at: found } };
            }
            (carry_before, carry_after, beyond) = (b >> 63, a >> 63, u64::MAX);
        }
        // Each line ends in a blocked word.
        Stop::Blocked { at: (self.stride * 64) as isize }
    }

    /// Goes from a free cell towards smaller positions.
    pub(crate) fn scan_down(&self, line: usize, at: usize) -> Stop {
        let first = at / 64 + 1;
        let (before, own, after) = self.around(line);
        let mut beyond = !(u64::MAX << (at % 64));
        let (mut carry_before, mut carry_after) = (0, 0);
        for i in (0..=first).rev() {
            let (b, o, a) = (before[i], own[i], after[i]);
            let forced = ((b >> 1 | carry_before) & !b) | ((a >> 1 | carry_after) & !a);
            let hit = (o | forced) & beyond;
            if hit != 0 {
                let bit = 63 - hit.leading_zeros();
                let found = (i * 64 + bit as usize) as isize - 64;
                let is_blocked = o >> bit & 1 == 1;
                return if is_blocked { Stop::Blocked { at: found } } else { Stop::Jump { at: found as usize } };
            }
            (carry_before, carry_after, beyond) = (b << 63, a << 63, u64::MAX);
        }
        Stop::Blocked { at: -1 }
    }

    fn around(&self, line: usize) -> (&[u64], &[u64], &[u64]) {
        let three = &self.words[line * self.stride..(line + 3) * self.stride];
        let (before, rest) = three.split_at(self.stride);
        let (own, after) = rest.split_at(self.stride);
        (before, own, after)
    }
}

/// Up to 64 cells as bits, the first as bit 0.
fn packed(cells: &[bool]) -> u64 {
    let mut out = 0;
    let mut eights = cells.chunks_exact(8);
    for (i, eight) in eights.by_ref().enumerate() {
        let bytes = u64::from_le_bytes(std::array::from_fn(|i| u8::from(eight[i])));
        // Byte i, 0 or 1, goes to bit 56 + i: the eight products do not meet.
        out |= (bytes.wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * i);
    }
    let rest = cells.len() / 8 * 8;
    eights.remainder().iter().enumerate().fold(out, |out, (i, b)| out | u64::from(*b) << (rest + i))
}

/// Transposes 64 x 64 bits. Source: Warren, "Hacker's Delight", 2nd edition, section 7-3, for bit 0 as the first column.
fn transpose(block: &mut [u64; 64]) {
    let mut mask = 0x0000_0000_FFFF_FFFF_u64;
    let mut half = 32;
    while half > 0 {
        let mut k = 0;
        while k < 64 {
            let swapped = (block[k] >> half ^ block[k + half]) & mask;
            block[k] ^= swapped << half;
            block[k + half] ^= swapped;
            k = (k + half + 1) & !half;
        }
        half /= 2;
        mask ^= mask << half;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The same scan, cell by cell.
    fn plain_scan(blocked: &dyn Fn(isize, isize) -> bool, line: isize, at: isize, step: isize) -> Stop {
        let mut before = at;
        loop {
            let next = before + step;
            if blocked(line, next) {
                return Stop::Blocked { at: next };
            }
            if [line - 1, line + 1].iter().any(|side| blocked(*side, before) && !blocked(*side, next)) {
                return Stop::Jump { at: next as usize };
            }
            before = next;
        }
    }

    #[test]
    fn density_counts_the_ends_of_obstacles_on_both_sides() {
        // Obstacles of one cell, eight apart both ways: in every fourth row, each is beside that row or not.
        let (width, height) = (128, 64);
        let cells: Vec<bool> = (0..width * height).map(|i| i % 8 == 4 && i / width % 8 == 1).collect();
        let found = BitLines::rows(&cells, width, height).jump_density(width, height);
        // Rows 0, 8, ... have sixteen obstacles beside them, each with two ends; rows 4, 12, ... have none.
        assert_eq!(found, 2.0 * 16.0 * 8.0 / (128.0 * 16.0));
        let free = BitLines::rows(&vec![false; 100 * 10], 100, 10);
        assert_eq!((free.jump_density(100, 10), BitLines::rows(&[], 0, 0).jump_density(0, 0)), (0.0, 0.0));
    }

    proptest! {
        #[test]
        fn scans_by_words_equal_scans_by_cells(
            width in 1..200usize, height in 1..80usize, share in 0..4usize, seed in any::<u64>(),
        ) {
            let mut state = seed;
            let mut random = move || {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 33) % 1000
            };
            let limit = [0, 5, 50, 400][share];
            let cells: Vec<bool> = (0..width * height).map(|_| random() < limit).collect();
            let is_blocked = |y: isize, x: isize| {
                let inside = x >= 0 && y >= 0 && x < width as isize && y < height as isize;
                !inside || cells[y as usize * width + x as usize]
            };
            let rows = BitLines::rows(&cells, width, height);
            let columns = rows.transposed(width, height);
            let turned = |x: isize, y: isize| is_blocked(y, x);
            for (i, &is_cell_blocked) in cells.iter().enumerate() {
                let (x, y) = (i % width, i / width);
                prop_assert_eq!(rows.is_blocked(y as isize, x as isize), is_cell_blocked);
                prop_assert_eq!(columns.is_blocked(x as isize, y as isize), is_cell_blocked);
                let (sx, sy) = (x as isize, y as isize);
                let three = (0..3).map(|k| u32::from(is_blocked(sy - 1, sx + k - 1)) << k).sum::<u32>();
                prop_assert_eq!(rows.three(sy - 1, x), three);
                if is_cell_blocked { continue; }
                prop_assert_eq!(rows.scan_up(y, x), plain_scan(&is_blocked, sy, sx, 1));
                prop_assert_eq!(rows.scan_down(y, x), plain_scan(&is_blocked, sy, sx, -1));
                prop_assert_eq!(columns.scan_up(x, y), plain_scan(&turned, sx, sy, 1));
                prop_assert_eq!(columns.scan_down(x, y), plain_scan(&turned, sx, sy, -1));
            }
        }
    }
}
