//! Lazy Theta* in space.

use super::field::Field;
use super::lattice::{Found, Limits};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

impl Field<'_> {
    /// A way between two open voxels whose legs join centres at any angle; what is found are its corners.
    ///
    /// Source: Nash, Koenig and Tovey, "Lazy Theta*: any-angle path planning and path length analysis in 3D", 2010, algorithm
    /// 2. The way is not always the shortest.
    pub(super) fn any_angle(&self, start: usize, goal: usize, limits: &Limits<'_>) -> Found {
        let num: usize = self.size().iter().product();
        // Zeros are untouched memory: a parent is kept plus one.
        let mut theta =
            Theta { field: self, parents: vec![0; num], lengths: vec![0.0; num], closed: vec![0; num.div_ceil(64)] };
        theta.run(start, goal, limits)
    }
}

struct Theta<'a> {
    field: &'a Field<'a>,
    /// Parent plus one; 0 where no way was found.
    parents: Vec<u32>,
    /// Of the way from the start, voxels.
    lengths: Vec<f64>,
    /// Bits of voxels that were expanded.
    closed: Vec<u64>,
}

impl Theta<'_> {
    fn run(&mut self, start: usize, goal: usize, limits: &Limits<'_>) -> Found {
        let mut open = BinaryHeap::new();
        let mut expansions = 0;
        self.parents[start] = start as u32 + 1;
        open.push(Open { estimate: 0.0, index: start as u32 });
        while let Some(Open { index, .. }) = open.pop() {
            let at = index as usize;
            if self.is_closed(at) {
                continue;
            }
            self.closed[at / 64] |= 1 << (at % 64);
            self.see_parent(at);
            if at == goal {
                return Found::Way { voxels: self.corners(goal), expansions };
            }
            if let Some(ended) = limits.reached(expansions) {
                return ended;
            }
            expansions += 1;
            let parent = self.parents[at] as usize - 1;
            for (next, _) in self.field.neighbors(at) {
                if self.is_closed(next) {
                    continue;
                }
                let length = self.lengths[parent] + self.apart(parent, next);
                if self.parents[next] == 0 || length < self.lengths[next] {
                    (self.lengths[next], self.parents[next]) = (length, parent as u32 + 1);
                    open.push(Open { estimate: length + self.apart(next, goal), index: next as u32 });
                }
            }
        }
        Found::Nothing { got_free: true }
    }

    /// Where the parent turns out not to be in sight, the shortest step from a voxel that was expanded replaces it.
    fn see_parent(&mut self, at: usize) {
        let parent = self.parents[at] as usize - 1;
        if self.field.sees(parent, at) {
            return;
        }
        let expanded = self.field.neighbors(at).map(|(n, _)| n).filter(|n| self.is_closed(*n));
        let steps = expanded.map(|n| (self.lengths[n] + self.apart(n, at), n as u32));
        if let Some((length, parent)) = steps.min_by(|a, b| a.0.total_cmp(&b.0)) {
            (self.lengths[at], self.parents[at]) = (length, parent + 1);
        }
    }

    fn is_closed(&self, index: usize) -> bool {
        self.closed[index / 64] >> (index % 64) & 1 == 1
    }

    fn apart(&self, a: usize, b: usize) -> f64 {
        (self.field.center(a) - self.field.center(b)).norm()
    }

    fn corners(&self, goal: usize) -> Vec<usize> {
        let mut out = vec![goal];
        let mut at = goal;
        while self.parents[at] as usize != at + 1 {
            at = self.parents[at] as usize - 1;
            out.push(at);
        }
        out.reverse();
        out
    }
}

/// An entry of the open list; the greatest, with the smallest estimate, is expanded first.
struct Open {
    estimate: f64,
    index: u32,
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        other.estimate.total_cmp(&self.estimate).then(other.index.cmp(&self.index))
    }
}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Open {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Open {}
