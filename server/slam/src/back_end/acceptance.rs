//! Which loops are believed: those that fit the map, and groups that agree with each other and with what was believed
//! before.

use super::consistency::{AGREE, Constraint, NEIGHBOURS, agreeing, chi2, within_drift};
use super::solve::Effort;
use super::{BackEnd, Loop, LoopId, LoopState};
use crate::loops::LoopClosure;
use percept_geometry::Covariance6;

/// Keyframes after which a loop that nothing confirmed is given up. Halved and doubled as it is
/// ([`crate::loops::planar`]).
const PATIENCE: u32 = 60;
/// Standard deviations of drift that a loop may ask for; more takes twice as many that agree. Of the three axes
/// together one of a thousand true loops asks for more. Halved 26.2 mm, doubled 28.7, of 26.2 on Intel's log with a
/// short range (see [`crate::odometry::lidar2d`]).
const LIKELY_DRIFT: f64 = 4.0;
/// Misfits from which a new loop is solved for at once, and from which the poses do not know of it: half of the good
/// ones exceed the one in six dimensions, one of a hundred the other. Chi squared of six degrees of freedom, of which
/// 42 of a hundred exceed the first and one the second.
const MISFITS: (f64, f64) = (6.0, 16.8);
/// The newest pose is known badly if its variance is so many times that of the last solution and of a loop together.
/// Halved and doubled as it is ([`crate::loops::planar`]).
const GROWN: f64 = 4.0;
/// Squared standard deviations of misfit from which a loop that was believed is so no longer: its weight is next to nothing.
const CONTRADICTS: f64 = 10.0 * AGREE;

impl BackEnd {
    /// Places of the new loops; those between keyframes that are not there are left out.
    pub(super) fn add_loops(&mut self, closures: Vec<LoopClosure>) -> Vec<usize> {
        let first = self.loops.len();
        let next = self.next_loop;
        let known = closures.into_iter().filter(|c| {
            let ends = (self.chain.index(c.from), self.chain.index(c.to));
            matches!(ends, (Some(a), Some(b)) if a != b) && c.covariance.cholesky().is_some()
        });
        let new = known.enumerate().map(|(k, closure)| Loop {
            id: LoopId(next + k as u64),
            closure,
            state: LoopState::Pending,
        });
        self.loops.extend(new.collect::<Vec<_>>());
        self.next_loop += (self.loops.len() - first) as u64;
        (first..self.loops.len()).collect()
    }

    /// Decides about pending loops; how thoroughly the graph should be optimised now, if it should.
    pub(super) fn judge(&mut self, changed: &mut Vec<usize>) -> Option<Effort> {
        let now = self.chain.len() as u32;
        let mut far = vec![];
        let mut urgent = None;
        for k in 0..self.loops.len() {
            if self.loops[k].state != LoopState::Pending {
                continue;
            }
            let Some(constraint) = self.constraint(k) else { continue };
            let (from, to) = (constraint.from, constraint.to);
            let off = chi2(constraint.closure, &self.poses[from as usize], &self.poses[to as usize]);
            if off < AGREE {
                self.loops[k].state = LoopState::Active;
                let is_unknown = off > MISFITS.1 || self.is_news(k);
                let effort =
                    if is_unknown { Some(Effort::Thorough) } else { (off > MISFITS.0).then_some(Effort::Routine) };
                urgent = urgent.max(effort);
                changed.push(k);
            } else if to + PATIENCE < now {
                self.loops[k].state = LoopState::Rejected;
                changed.push(k);
            } else {
                far.push(k);
            }
        }
        if far.is_empty() {
            return urgent;
        }
        let is_group_believed = self.try_groups(far, changed);
        if is_group_believed { Some(Effort::Thorough) } else { urgent }
    }

    /// Believes the largest group of far loops that agree, if they are enough and the map still holds with them, else the
    /// largest of the others: rooms that resemble each other keep no right ones waiting.
    fn try_groups(&mut self, mut far: Vec<usize>, changed: &mut Vec<usize>) -> bool {
        while far.len() >= self.params.min_agreeing {
            let constraints: Vec<Constraint<'_>> = far.iter().filter_map(|&k| self.constraint(k)).collect();
            let group = agreeing(&constraints, &self.chain, &self.poses);
            let likely = group.iter().all(|&g| within_drift(&constraints[g], &self.chain, &self.poses, LIKELY_DRIFT));
            let enough = self.params.min_agreeing * if likely { 1 } else { 2 };
            let group: Vec<usize> = group.iter().map(|&g| far[g]).collect();
            if group.len() >= enough && self.try_group(&group, changed) {
                return true;
            }
            if group.len() < self.params.min_agreeing {
                return false;
            }
            far.retain(|k| !group.contains(k));
        }
        false
    }

    /// Whether a loop at one of the newest keyframes tells where the robot is that has long been unsure of it.
    fn is_news(&self, k: usize) -> bool {
        let closure = &self.loops[k].closure;
        let variance = |c: &Covariance6, from: usize| (from..from + 3).map(|i| c[(i, i)]).sum::<f64>();
        let has_grown = |from: usize| {
            let known = variance(&closure.covariance, from) + variance(&self.drift_solved, from);
            variance(&self.drift, from) > GROWN * known
        };
        let newest = self.chain.len() as u64;
        let is_new = self.chain.index(closure.to).is_some_and(|to| u64::from(to) + NEIGHBOURS >= newest);
        is_new && (has_grown(0) || has_grown(3))
    }

    /// Believes a group of loops, if the map still holds with them.
    fn try_group(&mut self, group: &[usize], changed: &mut Vec<usize>) -> bool {
        let (poses, drift, misfits) = (self.poses.clone(), (self.drift, self.drift_solved), self.misfits());
        group.iter().for_each(|&k| self.loops[k].state = LoopState::Active);
        self.solve(Effort::Thorough);
        // What was believed before has to say so itself: none of it is doubted until the group is believed.
        let holds = group.iter().all(|&k| self.misfit(k) < AGREE) && self.misfits() <= misfits + group.len() / 4;
        changed.extend(group);
        if holds {
            self.doubt(changed);
        } else {
            group.iter().for_each(|&k| self.loops[k].state = LoopState::Rejected);
            self.place(poses);
            (self.drift, self.drift_solved) = drift;
        }
        holds
    }

    /// Loops that the map has come to contradict are believed no longer.
    pub(super) fn doubt(&mut self, changed: &mut Vec<usize>) {
        for k in 0..self.loops.len() {
            if self.loops[k].state == LoopState::Active && self.misfit(k) > CONTRADICTS {
                self.loops[k].state = LoopState::Rejected;
                changed.push(k);
            }
        }
    }

    /// Loops at these places, each once.
    pub(super) fn loops_at(&self, mut changed: Vec<usize>) -> Vec<Loop> {
        changed.sort_unstable();
        changed.dedup();
        changed.into_iter().map(|k| self.loops[k].clone()).collect()
    }

    pub(super) fn active_constraints(&self) -> Vec<Constraint<'_>> {
        let active = (0..self.loops.len()).filter(|&k| self.loops[k].state == LoopState::Active);
        active.filter_map(|k| self.constraint(k)).collect()
    }

    /// Nodes that loops wait at.
    pub(super) fn pending_ends(&self) -> Vec<u32> {
        let pending = (0..self.loops.len()).filter(|&k| self.loops[k].state == LoopState::Pending);
        let mut ends: Vec<u32> = pending.filter_map(|k| self.constraint(k)).flat_map(|t| [t.from, t.to]).collect();
        ends.sort_unstable();
        ends
    }

    pub(super) fn constraint(&self, k: usize) -> Option<Constraint<'_>> {
        let closure = &self.loops[k].closure;
        Some(Constraint { from: self.chain.index(closure.from)?, to: self.chain.index(closure.to)?, closure })
    }

    /// How badly a loop fits the poses, squared standard deviations.
    pub(super) fn misfit(&self, k: usize) -> f64 {
        self.constraint(k).map_or(0.0, |t| chi2(t.closure, &self.poses[t.from as usize], &self.poses[t.to as usize]))
    }

    /// Loops that are believed and do not fit.
    fn misfits(&self) -> usize {
        let active = (0..self.loops.len()).filter(|&k| self.loops[k].state == LoopState::Active);
        active.filter(|&k| self.misfit(k) > 2.0 * AGREE).count()
    }
}
