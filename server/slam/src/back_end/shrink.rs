//! The graph stays bounded: keyframes that newer ones stand for leave it, and loops move to what stands for their ends.

use super::culling::{self, Moves};
use super::{BackEnd, BackEndUpdate, Loop, LoopId, LoopState, MergedKeyframe, chain};
use std::collections::BTreeSet;

impl BackEnd {
    /// Merges old keyframes into newer ones that see the same. Everything is moved to where it is believed to be before.
    pub(super) fn cull(&mut self, mut update: BackEndUpdate) -> BackEndUpdate {
        let settled = self.settled();
        if let Some(correction) = settled.correction {
            update.correction = Some(correction.after(update.correction.take()));
        }
        update.loops.retain(|l| settled.loops.iter().all(|s| s.id != l.id));
        update.loops.extend(settled.loops);
        let merges = culling::redundant(&self.chain, &self.poses, &self.active_constraints(), &self.pending_ends());
        let moves = Moves::new(&merges, self.chain.len());
        let id = |k: u32| self.chain.nodes()[k as usize].id;
        let merged =
            merges.iter().map(|m| MergedKeyframe { id: id(m.gone), into: id(m.into), t_into_base: m.t_into_gone });
        update.merged = merged.collect();
        let (moved, dissolved) = self.move_loops(&moves);
        let steps = moves.steps(self.chain.steps());
        self.chain.keep(&moves.number, steps);
        let stays = |k: usize| moves.number[k].is_some();
        self.poses = (0..self.poses.len()).filter(|&k| stays(k)).map(|k| self.poses[k]).collect();
        self.given = (0..self.given.len()).filter(|&k| stays(k)).map(|k| self.given[k]).collect();
        for m in &update.merged {
            self.stand_ins.insert(m.id, (m.into, m.t_into_base));
            self.by_id.remove(&m.id);
            self.recognition.forget(m.id);
        }
        update.loops.retain(|l| !moved.contains(&l.id) && dissolved.binary_search(&l.id).is_err());
        update.loops.extend(self.loops.iter().filter(|l| moved.contains(&l.id)).cloned());
        update.dissolved = dissolved;
        self.cull_at = culling::FEWEST.max((culling::GROWTH * self.chain.len() as f64) as usize);
        update
    }

    /// Ties loops to what stands for their ends: those moved, and those that are gone, ascending.
    fn move_loops(&mut self, moves: &Moves<'_>) -> (BTreeSet<LoopId>, Vec<LoopId>) {
        let (mut moved, mut dissolved) = (BTreeSet::new(), vec![]);
        let chain = &self.chain;
        let id = |k: u32| chain.nodes()[k as usize].id;
        self.loops.retain_mut(|l| {
            let ends = (chain.index(l.closure.from), chain.index(l.closure.to));
            let (Some(from), Some(to)) = ends else { return true };
            if !moves.touches(from, to) {
                return true;
            }
            let (t_from_to, covariance) = (l.closure.t_from_to, l.closure.covariance);
            let edge = moves.moved(&chain::Step { from, to, t_from_to, covariance });
            let Some(edge) = edge.filter(|_| matches!(l.state, LoopState::Active | LoopState::Vetoed)) else {
                dissolved.push(l.id);
                return false;
            };
            (l.closure.from, l.closure.to) = (id(edge.from), id(edge.to));
            (l.closure.t_from_to, l.closure.covariance) = (edge.t_from_to, edge.covariance);
            moved.insert(l.id);
            true
        });
        let active = |l: &&mut Loop| l.state == LoopState::Active;
        let ends = |l: &mut Loop| (l.closure.from, l.closure.to, l.closure.covariance.trace());
        let mut stay = culling::surest(&self.loops.iter_mut().filter(active).map(ends).collect::<Vec<_>>()).into_iter();
        self.loops.retain(|l| {
            let stays = l.state != LoopState::Active || stay.next().unwrap_or(true);
            if !stays {
                moved.remove(&l.id);
                dissolved.push(l.id);
            }
            stays
        });
        dissolved.sort_unstable();
        (moved, dissolved)
    }
}
