//! Regions of free cells, and the lanes through them.

/// The grid's cells as rows along which lanes lie: those of the map, or its columns.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) along_y: bool,
}

impl Rows {
    pub(super) fn num(&self) -> usize {
        if self.along_y { self.width } else { self.height }
    }

    pub(super) fn length(&self) -> usize {
        if self.along_y { self.height } else { self.width }
    }

    /// Row-major index of a cell of the map.
    pub(super) fn index(&self, row: usize, at: usize) -> usize {
        if self.along_y { at * self.width + row } else { row * self.width + at }
    }
}

/// A stretch of free cells of one row, both ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stretch {
    pub(super) row: usize,
    pub(super) first: usize,
    pub(super) last: usize,
}

impl Stretch {
    fn meets(&self, other: &Stretch) -> bool {
        self.first <= other.last && other.first <= self.last
    }

    /// Cells beside those of another.
    fn shared(&self, other: &Stretch) -> usize {
        if self.meets(other) { self.last.min(other.last) - self.first.max(other.first) + 1 } else { 0 }
    }
}

/// Stretches of consecutive rows, each beside the next and no other.
#[derive(Debug, Clone, Default)]
pub(super) struct Region {
    pub(super) stretches: Vec<Stretch>,
    /// Whether other regions lie beside most of its first row, and of its last.
    is_open: [bool; 2],
}

/// Share of a row's end that has to lie beside other regions for a lane there to be left to them.
const MOSTLY: f64 = 0.8;

/// The regions of the cells that are free, in the order of their first rows.
pub(super) fn regions(rows: &Rows, is_free: impl Fn(usize) -> bool) -> Vec<Region> {
    let mut out: Vec<Region> = vec![];
    // Of the row before: its stretches, and the regions that they belong to.
    let mut before: Vec<(Stretch, usize)> = vec![];
    for row in 0..rows.num() {
        let stretches = stretches_of(rows, row, &is_free);
        let beside_before = |s: &Stretch| before.iter().filter(|(b, _)| b.meets(s)).count();
        let beside_now = |b: &Stretch| stretches.iter().filter(|s| s.meets(b)).count();
        let shares = |of: &Stretch, beside: &mut dyn Iterator<Item = Stretch>| {
            let shared: usize = beside.map(|b| b.shared(of)).sum();
            shared as f64 >= MOSTLY * (of.last - of.first + 1) as f64
        };
        let mut now = vec![];
        for stretch in &stretches {
            let one = before.iter().find(|(b, _)| b.meets(stretch)).filter(|_| beside_before(stretch) == 1);
            let goes_on = one.filter(|(b, _)| beside_now(b) == 1);
            let region = goes_on.map_or(out.len(), |(_, region)| *region);
            if region == out.len() {
                let is_open = shares(stretch, &mut before.iter().map(|(b, _)| *b));
                out.push(Region { stretches: vec![], is_open: [is_open, false] });
            }
            out[region].stretches.push(*stretch);
            now.push((*stretch, region));
        }
        for (stretch, region) in &before {
            if out[*region].stretches.last() == Some(stretch) {
                out[*region].is_open[1] = shares(stretch, &mut stretches.iter().copied());
            }
        }
        before = now;
    }
    out
}

fn stretches_of(rows: &Rows, row: usize, is_free: &impl Fn(usize) -> bool) -> Vec<Stretch> {
    let mut out: Vec<Stretch> = vec![];
    for at in (0..rows.length()).filter(|at| is_free(rows.index(row, *at))) {
        match out.last_mut() {
            Some(stretch) if stretch.last + 1 == at => stretch.last = at,
            _ => out.push(Stretch { row, first: at, last: at }),
        }
    }
    out
}

impl Region {
    /// Lanes through it, first to last, at most `spacing` rows apart. They begin in its first row and end in its last, but for
    /// half the spacing where another region goes on.
    pub(super) fn lanes(&self, spacing: f64) -> Vec<Stretch> {
        let last = self.stretches.len() as f64 - 1.0;
        let aside = |is_open: bool| if is_open { (0.5 * (spacing - 1.0)).max(0.0) } else { 0.0 };
        let (begin, end) = (aside(self.is_open[0]), last - aside(self.is_open[1]));
        if begin >= end {
            return vec![self.stretches[(0.5 * (begin + end)).round().clamp(0.0, last) as usize]];
        }
        let gaps = ((end - begin) / spacing).ceil().max(1.0);
        let at = |i: usize| (begin + (end - begin) * (i as f64 / gaps)).round() as usize;
        let mut out: Vec<Stretch> = (0..=gaps as usize).map(|i| self.stretches[at(i)]).collect();
        out.dedup();
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn free(rows: &[&str]) -> (Rows, Vec<bool>) {
        let cells = rows.iter().flat_map(|row| row.bytes().map(|c| c == b'.')).collect();
        (Rows { width: rows[0].len(), height: rows.len(), along_y: false }, cells)
    }

    #[test]
    fn a_pillar_divides_a_room_into_four_regions() {
        let (rows, cells) = free(&["......", "......", "..##..", "..##..", "......"]);
        let found = regions(&rows, |i| cells[i]);
        let sizes: Vec<usize> = found.iter().map(|r| r.stretches.len()).collect();
        assert_eq!(sizes, [2, 2, 2, 1]);
        // Beside the pillar two thirds of the row above lie beside regions.
        assert_eq!(found.iter().map(|r| r.is_open).collect::<Vec<_>>()[1], [true, true]);
        assert_eq!((found[0].is_open, found[3].is_open), ([false, false], [false, false]));
        let turned = Rows { width: 6, height: 5, along_y: true };
        assert_eq!(regions(&turned, |i| cells[i]).iter().map(|r| r.stretches.len()).collect::<Vec<_>>(), [2, 2, 2, 2]);
    }

    #[test]
    fn lanes_reach_both_walls_and_are_no_farther_apart_than_asked_for() {
        let (rows, cells) = free(&["...."; 12]);
        let found = regions(&rows, |i| cells[i]);
        assert_eq!(found[0].lanes(5.0).iter().map(|l| l.row).collect::<Vec<_>>(), [0, 4, 7, 11]);
        assert_eq!(found[0].lanes(100.0).iter().map(|l| l.row).collect::<Vec<_>>(), [0, 11]);
        assert_eq!(found[0].lanes(1.0).len(), 12);
    }
}
