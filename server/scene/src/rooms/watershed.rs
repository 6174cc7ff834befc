//! Basins of the distance to walls: two that meet in a doorway stay apart, others become one.

use super::cleared::{Cleared, Kind};
use super::doors::jambs;
use super::floor::{Around, Labels};
use super::{Floor, RoomParams};
use std::collections::{BTreeMap, BTreeSet};

/// The floor in basins.
pub(super) struct Basins {
    /// Basin of each cell; NONE where it is closed.
    of: Vec<u32>,
    parent: Vec<u32>,
    /// Cell where each is widest.
    peak: Vec<usize>,
    /// Of each root those that it met in a doorway: where they meet is narrower from then on, and says no more.
    apart: BTreeMap<u32, BTreeSet<u32>>,
    around: Around,
}

const NONE: u32 = u32::MAX;

impl Basins {
    fn root(&mut self, mut i: u32) -> u32 {
        while self.parent[i as usize] != i {
            self.parent[i as usize] = self.parent[self.parent[i as usize] as usize];
            i = self.parent[i as usize];
        }
        i
    }

    /// Joins two; the one that is wider goes on.
    fn join(&mut self, a: u32, b: u32, clearance: &[f32]) {
        let (a, b) = (self.root(a), self.root(b));
        let width = |i: u32| clearance[self.peak[i as usize]];
        let (wide, narrow) = if width(a) > width(b) || (width(a) == width(b) && a < b) { (a, b) } else { (b, a) };
        self.parent[narrow as usize] = wide;
        for other in self.apart.remove(&narrow).unwrap_or_default() {
            if let Some(back) = self.apart.get_mut(&other) {
                back.remove(&narrow);
            }
            if other != wide {
                self.keep_apart(wide, other);
            }
        }
    }

    fn keep_apart(&mut self, a: u32, b: u32) {
        self.apart.entry(a).or_default().insert(b);
        self.apart.entry(b).or_default().insert(a);
    }

    fn are_apart(&self, a: u32, b: u32) -> bool {
        self.apart.get(&a).is_some_and(|others| others.contains(&b))
    }
}

/// Divides what is open. Source: watershed by immersion from the widest cell down, as Vincent and Soille, "Watersheds in digital
/// spaces", 1991, on the negated distance transform.
pub(super) fn divide(floor: &Floor<'_>, cleared: &Cleared, clearance: &[f32], params: &RoomParams) -> Basins {
    let mut order: Vec<u32> = (0..floor.cells.len() as u32).filter(|i| cleared.is_open(*i as usize)).collect();
    order.sort_by(|a, b| clearance[*b as usize].total_cmp(&clearance[*a as usize]).then(a.cmp(b)));
    let around = floor.around();
    let of = vec![NONE; floor.cells.len()];
    let mut basins = Basins { of, parent: vec![], peak: vec![], apart: BTreeMap::new(), around };
    for at in order.into_iter().map(|i| i as usize) {
        let mut met: Vec<u32> = vec![];
        // It belongs to what lies up from it.
        let up = around.eight(at).filter(|next| basins.of[*next] != NONE);
        let up = up.max_by(|a, b| clearance[*a].total_cmp(&clearance[*b]).then(b.cmp(a)));
        let Some(up) = up else {
            basins.of[at] = basins.parent.len() as u32;
            basins.parent.push(basins.parent.len() as u32);
            basins.peak.push(at);
            continue;
        };
        basins.of[at] = basins.of[up];
        for next in around.eight(at) {
            if basins.of[next] != NONE {
                let root = basins.root(basins.of[next]);
                if !met.contains(&root) {
                    met.push(root);
                }
            }
        }
        let width = |b: u32, basins: &Basins| clearance[basins.peak[b as usize]];
        met.sort_by(|a, b| width(*b, &basins).total_cmp(&width(*a, &basins)).then(a.cmp(b)));
        let first = met[0];
        for other in &met[1..] {
            // What was met before may have become one.
            let (one, other) = (basins.root(first), basins.root(*other));
            if one == other || basins.are_apart(one, other) {
                continue;
            }
            let narrower = width(one, &basins).min(width(other, &basins));
            if is_doorway(floor, cleared, clearance, at, narrower, params) {
                basins.keep_apart(one, other);
            } else {
                basins.join(one, other, clearance);
            }
        }
    }
    basins
}

/// Whether two basins of which the narrower is so wide, in cells, meet at a cell between the jambs of a door.
fn is_doorway(
    floor: &Floor<'_>,
    cleared: &Cleared,
    clearance: &[f32],
    at: usize,
    narrower: f32,
    params: &RoomParams,
) -> bool {
    let here = clearance[at];
    let width_m = 2.0 * f64::from(here) * floor.resolution_m();
    if width_m > params.door_max_m || f64::from(narrower) < params.door_ratio * f64::from(here) {
        return false;
    }
    jambs(floor, cleared, clearance, at).is_some()
}

impl Basins {
    /// Joins what is smaller than so many cells to the basin that it is joined to by the widest passage; leaves it out if there is none.
    pub(super) fn drop_small(&mut self, least_cells: usize, clearance: &[f32]) {
        let (mut counts, mut passages) = (BTreeMap::<u32, usize>::new(), BTreeMap::<(u32, u32), f32>::new());
        for i in 0..self.of.len() {
            if self.of[i] == NONE {
                continue;
            }
            let root = self.root(self.of[i]);
            self.of[i] = root;
            *counts.entry(root).or_default() += 1;
        }
        for (i, next) in (0..self.of.len()).flat_map(|i| self.around.eight(i).map(move |next| (i, next))) {
            let (a, b) = (self.of[i], self.of[next]);
            if a != NONE && b != NONE && a != b {
                let widest = passages.entry((a, b)).or_default();
                *widest = widest.max(clearance[i].min(clearance[next]));
            }
        }
        let least = |counts: &BTreeMap<u32, usize>| counts.iter().map(|(b, n)| (*n, *b)).min();
        while let Some((count, small)) = least(&counts).filter(|(n, _)| *n < least_cells) {
            counts.remove(&small);
            let beside: Vec<(u32, f32)> =
                passages.range((small, 0)..=(small, NONE)).map(|((_, other), width)| (*other, *width)).collect();
            passages.retain(|(a, b), _| *a != small && *b != small);
            // Of as wide ones the first.
            let Some((into, _)) = beside.iter().rev().copied().max_by(|a, b| a.1.total_cmp(&b.1)) else {
                self.peak[small as usize] = LEFT_OUT;
                continue;
            };
            self.parent[small as usize] = into;
            *counts.entry(into).or_default() += count;
            for (other, width) in beside.into_iter().filter(|(other, _)| *other != into) {
                for pair in [(into, other), (other, into)] {
                    let widest = passages.entry(pair).or_default();
                    *widest = widest.max(width);
                }
            }
        }
    }

    /// Rooms of cells, and the widest cell of each room. Things that stand in a room and are joined to its walls are floor.
    pub(super) fn finished(mut self, floor: &Floor<'_>, cleared: &Cleared) -> (Labels, Vec<usize>) {
        let (mut numbers, mut peaks) = (BTreeMap::<u32, u32>::new(), vec![]);
        let mut cells = vec![Labels::NONE; self.of.len()];
        for (i, cell) in cells.iter_mut().enumerate() {
            if self.of[i] == NONE {
                continue;
            }
            let root = self.root(self.of[i]);
            let peak = self.peak[root as usize];
            if peak != LEFT_OUT {
                *cell = *numbers.entry(root).or_insert_with(|| {
                    peaks.push(peak);
                    peaks.len() as u32 - 1
                });
            }
        }
        let mut edge: Vec<usize> = (0..cells.len()).filter(|i| cells[*i] != Labels::NONE).collect();
        while !edge.is_empty() {
            let mut next = vec![];
            for i in edge {
                for j in self.around.four(i) {
                    if cells[j] == Labels::NONE && cleared.kinds[j] == Kind::Thing {
                        cells[j] = cells[i];
                        next.push(j);
                    }
                }
            }
            edge = next;
        }
        (Labels { geometry: Some(floor.geometry), width: floor.width, height: floor.height, cells }, peaks)
    }
}

/// In place of the widest cell of what is no room.
const LEFT_OUT: usize = usize::MAX;
