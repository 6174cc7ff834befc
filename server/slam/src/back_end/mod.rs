//! The back end: keyframes and loops in, corrected keyframe poses out.
//!
//! Every keyframe is tied to the one before it by odometry, and to older ones by the loops that [`PlaceRecognition`] finds.
//! Loops that move the map are believed only as groups that agree ([`consistency`]), and only if what was believed before
//! still holds with them; the rest are weighed down by how badly they fit. Start with [`BackEnd::insert`].

mod acceptance;
mod chain;
mod consistency;
mod culling;
mod shrink;
mod solve;
mod types;

#[cfg(test)]
mod tests;

use crate::covariance::diagonal;
use crate::loops::{Evidence, KeyframePoses, LoopClosure, PlaceRecognition, Relocalisation};
use crate::motion_noise::OVER_GAP;
use crate::odometry::OdometryNoise;
use chain::{Chain, View, step_covariance};
use percept_geometry::{Correction, Covariance6, KeyframeId, KeyframeScan, Pose, se3};
use solve::Effort;
use std::collections::BTreeMap;
use std::sync::Arc;
pub use types::{
    BackEndKeyframe, BackEndMemory, BackEndParams, BackEndUpdate, Loop, LoopId, LoopState, MergedKeyframe,
};

/// Keyframes between optimisations that change next to nothing: so many, or this share of all, as corrections that
/// small wait for more (see [`TURNS`]), and a solution costs more the more there are. Halved 35.2, doubled 35.3; the
/// share halved and doubled 35.3 ([`crate::loops::planar`]).
const LAZY: usize = 10;
const LAZY_SHARE: f64 = 0.05;
/// Displacements (metres and radians) and the share of all keyframes that must have come since the last correction
/// before one is made for them: less than the first is left, the last does not wait. The first is about half of what
/// one registration is off by ([`OdometryNoise::at_once`]). Each of the others, halved and doubled, leaves the error of
/// [`crate::loops::planar`]'s run as it is, within 0.1 mm. While the map grows by a share of s between two corrections, a
/// keyframe is rebuilt (1 + s) / s times in the mean, at most: 5 and 11 times.
const TURNS: [((f64, f64), f64); 3] = [((0.003, 0.001), 0.25), ((0.02, 0.005), 0.1), ((0.25, 0.05), 0.0)];

/// Keyframes, what ties them, and where they are believed to be.
pub struct BackEnd {
    params: BackEndParams,
    recognition: Box<dyn PlaceRecognition>,
    chain: Chain,
    /// By index in the chain.
    poses: Vec<Pose>,
    /// The same, by number, as place recognition reads them.
    by_id: KeyframePoses,
    /// Poses that were given out, by index.
    given: Vec<Pose>,
    loops: Vec<Loop>,
    /// Number of the next loop: those of loops that are gone do not come again.
    next_loop: u64,
    /// What vetoed loops were.
    before_veto: BTreeMap<LoopId, LoopState>,
    last: Option<(Pose, Covariance6)>,
    /// Odom to map as it was given out: so where keyframes lie follows from keyframes alone, and not from when what was
    /// decided about them is shown.
    t_map_odom: Pose,
    /// What stands for keyframes that are gone, and base at the one that is gone seen from there.
    stand_ins: BTreeMap<KeyframeId, (KeyframeId, Pose)>,
    /// Of the newest keyframe's pose in the map, and what it was when the graph was last solved.
    drift: Covariance6,
    drift_solved: Covariance6,
    since_optimised: usize,
    since_given: usize,
    /// Keyframes from which on old ones are merged into newer ones.
    cull_at: usize,
}

impl std::fmt::Debug for BackEnd {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BackEnd")
            .field("keyframes", &self.chain.len())
            .field("loops", &self.loops.len())
            .finish_non_exhaustive()
    }
}

impl BackEnd {
    /// A back end without keyframes, whose steps come from an odometry of this noise. Validate `params` first.
    pub fn new(params: BackEndParams, noise: OdometryNoise, recognition: Box<dyn PlaceRecognition>) -> Self {
        Self {
            params,
            recognition,
            chain: Chain::new(noise),
            poses: vec![],
            by_id: KeyframePoses::new(),
            given: vec![],
            loops: vec![],
            next_loop: 0,
            before_veto: BTreeMap::new(),
            last: None,
            t_map_odom: Pose::identity(),
            stand_ins: BTreeMap::new(),
            drift: Covariance6::zeros(),
            drift_solved: Covariance6::zeros(),
            since_optimised: 0,
            since_given: 0,
            cull_at: culling::FEWEST,
        }
    }

    /// Takes a keyframe in. The first one stays where the map has put it. What is answered follows from the keyframes, and
    /// from vetoes and settling among them, whenever it is asked.
    pub fn insert(&mut self, keyframe: &BackEndKeyframe) -> BackEndUpdate {
        let constraint = keyframe.constraint.clone().map(|constraint| self.measured_from_who_stands_in(constraint));
        let t_map_base = self.place_of(keyframe, constraint.as_ref());
        let is_placed = keyframe.after_gap && constraint.is_some();
        self.extend(keyframe, &t_map_base);
        let mut changed = self.add_loops(constraint.into_iter().collect());
        // Place recognition is to know where it has to look.
        let urgent = if changed.is_empty() { None } else { self.judge(&mut changed) };
        if let Some(effort) = urgent {
            self.optimise(effort, &mut changed);
        }
        let found = match keyframe.recognise {
            true => self.recognition.insert(keyframe.id, &keyframe.scan, &self.drift, &self.by_id),
            false => vec![],
        };
        changed.extend(self.add_loops(found));
        let urgent = self.judge(&mut changed);
        self.since_optimised += 1;
        self.since_given += 1;
        let is_constrained = self.loops.iter().any(|l| l.state == LoopState::Active);
        if let Some(effort) = urgent {
            self.optimise(effort, &mut changed);
        } else if is_constrained
            && self.since_optimised as f64 >= (LAZY_SHARE * self.chain.len() as f64).max(LAZY as f64)
        {
            self.optimise(Effort::Routine, &mut changed);
        }
        let loops = self.loops_at(changed);
        let mut correction = self.due();
        if let Some(given) = self.given.last().filter(|_| is_placed) {
            // The map may have been corrected since it was put there.
            let moved = &mut correction.get_or_insert_with(Correction::default).t_map_base;
            if moved.last().is_none_or(|(id, _)| *id != keyframe.id) {
                moved.push((keyframe.id, *given));
            }
        }
        let update = BackEndUpdate { loops, correction, ..BackEndUpdate::default() };
        let update = if self.chain.len() < self.cull_at { update } else { self.cull(update) };
        self.told(update)
    }

    /// Takes a loop out of the map, or undoes that: it is then what it was before. After a restart of the session that is
    /// not known any more, and it holds the map again. None if there is no such loop.
    pub fn veto(&mut self, id: LoopId, vetoed: bool) -> Option<BackEndUpdate> {
        let position = self.loops.binary_search_by_key(&id, |l| l.id).ok()?;
        let was = self.loops[position].state;
        let state = match (vetoed, was) {
            (true, LoopState::Vetoed) => was,
            (true, _) => {
                self.before_veto.insert(id, was);
                LoopState::Vetoed
            }
            (false, LoopState::Vetoed) => self.before_veto.remove(&id).unwrap_or(LoopState::Active),
            (false, other) => other,
        };
        self.loops[position].state = state;
        let mut changed = vec![position];
        if state != was && (state == LoopState::Active || was == LoopState::Active) {
            self.restart();
            self.optimise(Effort::Thorough, &mut changed);
        }
        let loops = self.loops_at(changed);
        let update = BackEndUpdate { loops, correction: self.give(), ..BackEndUpdate::default() };
        Some(self.told(update))
    }

    /// All loops, in the order of finding.
    pub fn loops(&self) -> &[Loop] {
        &self.loops
    }

    /// Number of the next loop.
    pub fn next_loop(&self) -> u64 {
        self.next_loop
    }

    /// What is kept of places and of the graph, bytes, about; scans are the map's.
    pub fn memory(&self) -> BackEndMemory {
        let poses = self.poses.capacity() + self.given.capacity() + self.by_id.len() + self.stand_ins.len();
        let loops = self.loops.capacity() * size_of::<Loop>();
        BackEndMemory {
            places: self.recognition.memory_bytes(),
            graph: self.chain.memory_bytes() + poses * size_of::<(KeyframeId, Pose)>() + loops,
        }
    }

    /// Where keyframes are believed to be, base to map.
    pub fn poses(&self) -> &KeyframePoses {
        &self.by_id
    }

    /// Of the newest keyframe's pose in the map, right perturbation in base: what loops left of the drift.
    pub fn drift(&self) -> &Covariance6 {
        &self.drift
    }

    /// Where a scan is with no guess; none unless that is certain. `before` is what was seen since the robot was lost,
    /// oldest first, with base then seen from base now.
    pub fn relocalise(&mut self, before: &[(Pose, Arc<KeyframeScan>)], scan: &KeyframeScan) -> Option<Relocalisation> {
        self.recognition.relocalise_driven(before, scan, &self.by_id)
    }

    /// What a scan says of the place where it is believed to have been taken, base to map.
    pub fn check(&mut self, scan: &KeyframeScan, t_map_base: &Pose) -> Evidence {
        self.recognition.check(scan, t_map_base, &self.by_id)
    }

    /// Covariance of a keyframe's pose as the way to it from the first one has it; loops make it smaller than that.
    pub fn drift_at(&self, id: KeyframeId) -> Covariance6 {
        let drift = self.chain.index(id).map_or((0.0, 0.0), |index| self.chain.drift(0, index, 0.0));
        diagonal(drift.0.sqrt(), drift.1.sqrt())
    }

    /// Whether the newest search for a robot has not ended yet: it goes on when it is asked for again.
    pub fn is_unfinished(&self) -> bool {
        self.recognition.is_unfinished()
    }

    /// Whether a search for a robot goes on in steps of counted work, one a question; else a question is all of it.
    pub fn relocalises_in_steps(&self) -> bool {
        self.recognition.relocalises_in_steps()
    }

    /// Optimises once more and moves every keyframe to where it is believed to be, however little that is.
    pub fn settle(&mut self) -> BackEndUpdate {
        let update = self.settled();
        self.told(update)
    }

    fn settled(&mut self) -> BackEndUpdate {
        let mut changed = vec![];
        if self.since_optimised > 0 && self.loops.iter().any(|l| l.state == LoopState::Active) {
            self.optimise(Effort::Thorough, &mut changed);
        }
        let loops = self.loops_at(changed);
        BackEndUpdate { loops, correction: self.give(), ..BackEndUpdate::default() }
    }

    /// Goes on with stored keyframes and loops: all poses are those of the map. `next_loop` is the next loop's number.
    pub fn resume(&mut self, keyframes: impl Iterator<Item = BackEndKeyframe>, loops: Vec<Loop>, next_loop: u64) {
        let mut constraints: BTreeMap<KeyframeId, Vec<KeyframeId>> = BTreeMap::new();
        for l in loops.iter().filter(|l| l.state == LoopState::Active) {
            constraints.entry(l.closure.to).or_default().push(l.closure.from);
        }
        for keyframe in keyframes {
            let t_map_base = keyframe.t_map_base;
            let merged_between = self.chain.nodes().last().is_some_and(|n| n.id.0 + 1 != keyframe.id.0);
            match self.poses.last().filter(|_| merged_between) {
                Some(last) => self.extend_over(&keyframe, &last.inv_mul(&t_map_base)),
                None => self.extend(&keyframe, &t_map_base),
            }
            if let Some(pose) = self.poses.last_mut() {
                *pose = t_map_base;
            }
            if let Some(pose) = self.given.last_mut() {
                *pose = t_map_base;
            }
            self.by_id.insert(keyframe.id, t_map_base);
            self.t_map_odom = t_map_base * keyframe.t_odom_base.inverse();
            if keyframe.recognise {
                let constraints = constraints.get(&keyframe.id).map_or(&[][..], Vec::as_slice);
                self.recognition.restore(keyframe.id, &keyframe.scan, &self.drift, &self.by_id, constraints);
            }
        }
        self.next_loop = next_loop.max(loops.last().map_or(0, |l| l.id.0 + 1));
        self.loops = loops;
        // What loops left of the drift; the map stays as it was stored.
        if let Some(solved) = solve::solve(&self.chain, &self.active_constraints(), &self.poses, Effort::Routine) {
            self.drift = solved.covariance_of_newest;
            self.drift_solved = self.drift;
        }
    }

    /// Base to map at a new keyframe, as the map has it.
    fn place_of(&mut self, keyframe: &BackEndKeyframe, constraint: Option<&LoopClosure>) -> Pose {
        let found = |constraint: &LoopClosure| {
            let from = self.chain.index(constraint.from)?;
            Some(self.given[from as usize] * constraint.t_from_to)
        };
        let t_map_base = match constraint.filter(|_| keyframe.after_gap).and_then(found) {
            Some(found) => found,
            None if keyframe.after_gap || self.last.is_none() => keyframe.t_map_base,
            None => return self.t_map_odom * keyframe.t_odom_base,
        };
        self.t_map_odom = t_map_base * keyframe.t_odom_base.inverse();
        t_map_base
    }

    fn measured_from_who_stands_in(&self, mut constraint: LoopClosure) -> LoopClosure {
        while let Some((into, t_into_base)) = self.stand_ins.get(&constraint.from) {
            (constraint.from, constraint.t_from_to) = (*into, t_into_base * constraint.t_from_to);
        }
        constraint
    }

    fn extend(&mut self, keyframe: &BackEndKeyframe, t_map_base: &Pose) {
        let (t_odom_base, covariance) = (keyframe.t_odom_base, keyframe.covariance);
        let (t_prev_node, step) = match &self.last {
            None => (*t_map_base, Covariance6::zeros()),
            Some(_) if keyframe.after_gap => {
                let last = self.poses.last().copied().unwrap_or_else(Pose::identity);
                (last.inv_mul(t_map_base), diagonal(OVER_GAP.0, OVER_GAP.1))
            }
            Some((t_odom_last, before)) => {
                let t_last_now = t_odom_last.inv_mul(&t_odom_base);
                (t_last_now, step_covariance(before, &t_last_now, &covariance))
            }
        };
        self.push(keyframe, &t_prev_node, &step);
        let pose = self.poses.last().map_or(*t_map_base, |last| last * t_prev_node);
        let step = self.chain.nodes().last().map_or(step, |n| n.step);
        if !self.poses.is_empty() {
            self.drift = se3::compose_covariance(&self.drift, &t_prev_node, &step);
        }
        self.poses.push(pose);
        self.by_id.insert(keyframe.id, pose);
        // The map has put it where it believes that the odometry's origin is.
        self.given.push(*t_map_base);
    }

    /// Adds a keyframe whose neighbour was merged: how it lies to the one before is known from the map alone.
    fn extend_over(&mut self, keyframe: &BackEndKeyframe, t_prev_node: &Pose) {
        self.push(keyframe, t_prev_node, &Covariance6::zeros());
        let pose = self.poses.last().map_or(*t_prev_node, |last| last * t_prev_node);
        self.poses.push(pose);
        self.given.push(pose);
    }

    fn push(&mut self, keyframe: &BackEndKeyframe, t_prev_node: &Pose, step: &Covariance6) {
        self.last = Some((keyframe.t_odom_base, keyframe.covariance));
        let view = keyframe.scan.get().map_or_else(View::unknown, |scan| View::of(&scan));
        self.chain.push(keyframe.id, view, *t_prev_node, step);
    }

    /// Poses by odometry alone, as long as nothing but that ties keyframes to each other: where some were merged, what tied
    /// them holds the map together.
    fn restart(&mut self) {
        if !self.chain.is_way() {
            return;
        }
        let mut poses: Vec<Pose> = Vec::with_capacity(self.chain.len());
        for node in self.chain.nodes() {
            let pose = match poses.last() {
                None => self.poses[0],
                Some(last) => last * node.t_prev_node,
            };
            poses.push(pose);
        }
        self.place(poses);
    }

    fn place(&mut self, poses: Vec<Pose>) {
        for (node, pose) in self.chain.nodes().iter().zip(&poses) {
            self.by_id.insert(node.id, *pose);
        }
        self.poses = poses;
    }

    fn optimise(&mut self, effort: Effort, changed: &mut Vec<usize>) {
        self.solve(effort);
        self.doubt(changed);
    }

    fn solve(&mut self, effort: Effort) {
        self.since_optimised = 0;
        let constraints = self.active_constraints();
        // A graph that cannot be solved leaves the poses as they are.
        if let Some(solved) = solve::solve(&self.chain, &constraints, &self.poses, effort) {
            self.drift = solved.covariance_of_newest;
            self.drift_solved = self.drift;
            self.place(solved.poses);
        }
    }

    /// The correction, if it is time for one: the layers are rebuilt with each, so small ones wait for as many keyframes
    /// as keep that cheap.
    fn due(&mut self) -> Option<Correction> {
        let far = |limit: (f64, f64)| {
            self.poses.iter().zip(&self.given).any(|(a, b)| {
                let off = b.inv_mul(a);
                off.translation.vector.norm() > limit.0 || off.rotation.angle() > limit.1
            })
        };
        let waited = self.since_given as f64;
        let is_time = |&(limit, share): &((f64, f64), f64)| waited >= share * self.chain.len() as f64 && far(limit);
        if TURNS.iter().any(is_time) { self.give() } else { None }
    }

    fn give(&mut self) -> Option<Correction> {
        let changed = self.poses.iter().zip(&self.given).zip(self.chain.nodes()).filter(|((a, b), _)| a != b);
        let t_map_base: Vec<_> = changed.map(|((pose, _), node)| (node.id, *pose)).collect();
        self.since_given = 0;
        self.given.clone_from(&self.poses);
        if let (Some(newest), Some((t_odom_base, _))) = (self.given.last(), &self.last) {
            self.t_map_odom = newest * t_odom_base.inverse();
        }
        (!t_map_base.is_empty()).then_some(Correction { t_map_base })
    }

    /// An update with what follows from it for keyframes to come.
    fn told(&self, update: BackEndUpdate) -> BackEndUpdate {
        let t_map_odom = update.correction.as_ref().map(|_| self.t_map_odom);
        BackEndUpdate { t_map_odom, ..update }
    }
}
