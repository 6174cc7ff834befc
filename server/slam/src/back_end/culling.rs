//! Bounded growth: of keyframes that saw the same place the newest stays, the older ones merge into it.
//!
//! A robot that stays in the same rooms would make keyframes without end. Where a newer keyframe stands within the
//! distance at which keyframes are made, sees the same way, and a loop ties the two passes, the older one tells nothing
//! that the newer does not. What tied the older one to others ties the newer from then on, with the uncertainty between
//! the two added.
//!
//! Source: Johannsson et al., "Temporally scalable visual SLAM using a reduced pose graph", 2013 (old places are used
//! again instead of adding to them); we keep the newer view, so that the map follows what changes.

use super::chain::{Chain, Step};
use super::consistency::{Constraint, NEIGHBOURS};
use crate::covariance::diagonal;
use nalgebra::Vector3;
use percept_geometry::{Covariance6, KeyframeId, Pose, se3};
use rustc_hash::{FxHashMap, FxHashSet};

/// Keyframes from which on older ones are merged. A robot that drove rounds in one room took 6.0 s of computing for 6,000
/// frames with 400, and 4.8 s with 250 and with 200. ATE with 400, 250, 200: Intel 0.061 0.062 0.060 m, CSAIL 0.079 0.077
/// 0.080, without wheels 0.064 0.067 0.066 and 0.091 0.088 0.085.
pub(super) const FEWEST: usize = 250;
/// How much more than were left the last time there must be until it is done again. Culling costs as the map is large:
/// so its sum is 1 / (1 - 1/1.4), three and a half times the last one's.
pub(super) const GROWTH: f64 = 1.4;
/// The newest keyframes are left alone: what they belong to is still being measured. As long as a loop waits for others
/// (`PATIENCE` in `acceptance`).
const RECENT: u64 = 60;
/// Two keyframes this near see the same, metres, and radians for a sensor that does not see around. The spacing of
/// keyframes, `keyframe.distance_m` and `angle_rad`.
const NEAR_M: f64 = 0.5;
const NEAR_RAD: f64 = 0.35;
/// Most loops of a keyframe, the surest. Halved and doubled as it is ([`crate::loops::planar`]).
const MOST_LOOPS: u32 = 12;

/// A node that another one stands for, by index.
#[derive(Debug, Clone)]
pub(super) struct Merge {
    pub(super) gone: u32,
    pub(super) into: u32,
    pub(super) t_into_gone: Pose,
    /// Right perturbation in `gone`.
    covariance: Covariance6,
}

/// Nodes that newer ones can stand for, oldest first. `busy` are left alone.
///
/// At each place the oldest stays, too: the newer ones keep to where it is. Were every round measured from the round before
/// alone, the map would wander.
pub(super) fn redundant(chain: &Chain, poses: &[Pose], constraints: &[Constraint<'_>], busy: &[u32]) -> Vec<Merge> {
    let nodes = chain.nodes();
    let Some(newest) = nodes.last().map(|n| n.id.0) else { return vec![] };
    let by_ends = constraints_by_ends(constraints);
    let mut first = Places::default();
    for k in 0..nodes.len() {
        let known = first.around(&poses[k]).any(|n| sees_the_same(chain, poses, n as usize, k));
        if !known {
            first.insert(k as u32, &poses[k]);
        }
    }
    let mut last = Places::default();
    let mut merges = vec![];
    for k in (0..nodes.len()).rev().filter(|&k| !first.contains(k as u32)) {
        let may_go = nodes[k].id.0 + RECENT <= newest && !busy.contains(&(k as u32));
        let merge = may_go.then(|| {
            let is_later = |n: &u32| nodes[*n as usize].id.0 >= nodes[k].id.0 + RECENT;
            let same = last.around(&poses[k]).filter(is_later).filter(|&n| sees_the_same(chain, poses, n as usize, k));
            same.filter_map(|n| merge(chain, poses, &by_ends, k as u32, n))
                .min_by(|a, b| a.covariance.trace().total_cmp(&b.covariance.trace()).then(b.into.cmp(&a.into)))
        });
        match merge.flatten() {
            Some(merge) => merges.push(merge),
            None => last.insert(k as u32, &poses[k]),
        }
    }
    merges.reverse();
    merges
}

/// Nodes by where they are.
#[derive(Default)]
struct Places {
    cells: FxHashMap<[i64; 3], Vec<u32>>,
    nodes: FxHashSet<u32>,
}

impl Places {
    fn cell(pose: &Pose) -> [i64; 3] {
        pose.translation.vector.map(|v| (v / NEAR_M).floor() as i64).into()
    }

    fn insert(&mut self, node: u32, pose: &Pose) {
        self.nodes.insert(node);
        self.cells.entry(Self::cell(pose)).or_default().push(node);
    }

    fn contains(&self, node: u32) -> bool {
        self.nodes.contains(&node)
    }

    /// All within [`NEAR_M`], and some farther ones.
    fn around(&self, pose: &Pose) -> impl Iterator<Item = u32> {
        let [x, y, z] = Self::cell(pose);
        let cells = (0..27).map(move |i| [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1]);
        cells.filter_map(|c| self.cells.get(&c)).flatten().copied()
    }
}

fn sees_the_same(chain: &Chain, poses: &[Pose], a: usize, b: usize) -> bool {
    let off = poses[a].inv_mul(&poses[b]);
    let (a, b) = (&chain.nodes()[a], &chain.nodes()[b]);
    // A sensor that sees around must still be as level as before.
    let turn = if a.view.around { tilt(&off) } else { off.rotation.angle() };
    a.view == b.view && off.translation.vector.norm() < NEAR_M && turn < NEAR_RAD
}

/// Angle between the upward axes of two poses.
fn tilt(off: &Pose) -> f64 {
    (off.rotation * Vector3::z()).z.clamp(-1.0, 1.0).acos()
}

/// Numbers of keyframes between which there are constraints, both ways round, with the place of the loop; ascending.
fn constraints_by_ends<'a>(constraints: &'a [Constraint<'a>]) -> Vec<(u64, u64, &'a Constraint<'a>)> {
    let ends = |t: &'a Constraint<'a>| (t.closure.from.0, t.closure.to.0);
    let mut out: Vec<_> =
        constraints.iter().flat_map(|t| [(ends(t).0, ends(t).1, t), (ends(t).1, ends(t).0, t)]).collect();
    out.sort_by_key(|&(a, b, _)| (a, b));
    out
}

/// `gone` into `into`, if a loop near both says how they lie to each other.
fn merge(
    chain: &Chain,
    poses: &[Pose],
    constraints: &[(u64, u64, &Constraint<'_>)],
    gone: u32,
    into: u32,
) -> Option<Merge> {
    let id = |k: u32| chain.nodes()[k as usize].id.0;
    let (low, high) = (id(gone).saturating_sub(NEIGHBOURS), id(gone) + NEIGHBOURS);
    let first = constraints.partition_point(|t| t.0 < low);
    let near = constraints[first..].iter().take_while(|t| t.0 <= high).filter(|t| t.1.abs_diff(id(into)) <= NEIGHBOURS);
    let variances = near.filter_map(|&(a, b, constraint)| {
        let (a, b) = (chain.index(KeyframeId(a))?, chain.index(KeyframeId(b))?);
        let arm = |i: u32, j: u32| poses[i as usize].inv_mul(&poses[j as usize]).translation.vector.norm();
        let ways = [chain.drift(gone, a, arm(gone, a)), chain.drift(into, b, arm(into, b))];
        let own = |k: usize| (k..k + 3).map(|i| constraint.closure.covariance[(i, i)]).fold(0.0, f64::max);
        Some((own(0) + ways[0].0 + ways[1].0, own(3) + ways[0].1 + ways[1].1))
    });
    let (var_t, var_r) = variances.min_by(|a, b| a.0.total_cmp(&b.0))?;
    let t_into_gone = poses[into as usize].inv_mul(&poses[gone as usize]);
    Some(Merge { gone, into, t_into_gone, covariance: diagonal(var_t.sqrt(), var_r.sqrt()) })
}

/// What happens to the edges of nodes that are gone.
pub(super) struct Moves<'a> {
    merges: FxHashMap<u32, &'a Merge>,
    /// New index by old; none for those gone.
    pub(super) number: Vec<Option<u32>>,
}

impl<'a> Moves<'a> {
    pub(super) fn new(merges: &'a [Merge], nodes: usize) -> Self {
        let merges: FxHashMap<u32, &Merge> = merges.iter().map(|m| (m.gone, m)).collect();
        let mut next = 0;
        let mut number = |k: u32| {
            let kept = !merges.contains_key(&k);
            next += u32::from(kept);
            kept.then(|| next - 1)
        };
        let number = (0..nodes as u32).map(&mut number).collect();
        Self { merges, number }
    }

    /// Whether an edge has lost an end.
    pub(super) fn touches(&self, from: u32, to: u32) -> bool {
        self.merges.contains_key(&from) || self.merges.contains_key(&to)
    }

    /// The edge between the nodes that stand for its ends (old indices); none if that is one and the same.
    pub(super) fn moved(&self, edge: &Step) -> Option<Step> {
        let mut edge = edge.clone();
        if let Some(m) = self.merges.get(&edge.to) {
            let t_gone_into = m.t_into_gone.inverse();
            let back = turned(&m.covariance, &m.t_into_gone);
            edge.covariance = se3::compose_covariance(&edge.covariance, &t_gone_into, &back);
            (edge.t_from_to, edge.to) = (edge.t_from_to * t_gone_into, m.into);
        }
        if let Some(m) = self.merges.get(&edge.from) {
            edge.covariance = se3::compose_covariance(&m.covariance, &edge.t_from_to, &edge.covariance);
            (edge.t_from_to, edge.from) = (m.t_into_gone * edge.t_from_to, m.into);
        }
        (edge.from != edge.to).then_some(edge)
    }

    /// The steps between nodes that stay, by their new indices; of several between two nodes the surest.
    pub(super) fn steps(&self, steps: &[Step]) -> Vec<Step> {
        let mut out: Vec<Step> =
            steps.iter().filter_map(|s| self.moved(s)).filter_map(|s| self.renumbered(s)).collect();
        let ends = |s: &Step| (s.from.min(s.to), s.from.max(s.to));
        out.sort_by(|a, b| ends(a).cmp(&ends(b)).then(a.covariance.trace().total_cmp(&b.covariance.trace())));
        out.dedup_by_key(|s| ends(s));
        out
    }

    fn renumbered(&self, step: Step) -> Option<Step> {
        let number = |k: u32| self.number.get(k as usize).copied().flatten();
        Some(Step { from: number(step.from)?, to: number(step.to)?, ..step })
    }
}

/// Covariance of the way back: right perturbation at the other end.
fn turned(covariance: &Covariance6, t: &Pose) -> Covariance6 {
    let adjoint = se3::adjoint(t);
    adjoint * covariance * adjoint.transpose()
}

/// Loops that stay: the surest between two keyframes, and of a keyframe the surest few. Places in `loops`, each its ends
/// and its variance.
pub(super) fn surest(loops: &[(KeyframeId, KeyframeId, f64)]) -> Vec<bool> {
    let mut order: Vec<usize> = (0..loops.len()).collect();
    order.sort_by(|&a, &b| loops[a].2.total_cmp(&loops[b].2).then(a.cmp(&b)));
    let mut degree: FxHashMap<KeyframeId, u32> = FxHashMap::default();
    let mut pairs = FxHashSet::default();
    let mut stay = vec![false; loops.len()];
    for k in order {
        let (a, b, _) = loops[k];
        let is_full = [a, b].iter().all(|id| degree.get(id).is_some_and(|d| *d >= MOST_LOOPS));
        if !is_full && pairs.insert((a.min(b), a.max(b))) {
            stay[k] = true;
            [a, b].into_iter().for_each(|id| *degree.entry(id).or_default() += 1);
        }
    }
    stay
}
