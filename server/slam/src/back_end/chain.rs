//! Keyframes in the order of their making, and how sure the way from each to the next is.

use super::culling::View;
use percept_geometry::{Covariance6, KeyframeId, Pose, se3};
use std::collections::BTreeMap;

/// A keyframe of the graph.
#[derive(Debug, Clone)]
pub(super) struct Node {
    pub(super) id: KeyframeId,
    /// Base here, seen from base at the node before; the map pose for the first.
    pub(super) t_prev_node: Pose,
    /// Of that, right perturbation in base here.
    pub(super) step: Covariance6,
    /// What it sees.
    pub(super) view: View,
    /// Sums from the first node up to here: variance of position (m^2) and of turning (rad^2), mean over axes.
    sums: (f64, f64),
}

/// A way that odometry measured between two nodes.
#[derive(Debug, Clone)]
pub(super) struct Step {
    pub(super) from: u32,
    pub(super) to: u32,
    pub(super) t_from_to: Pose,
    /// Right perturbation in `to`.
    pub(super) covariance: Covariance6,
}

/// The nodes; their indices are those of the pose graph.
#[derive(Debug, Clone, Default)]
pub(super) struct Chain {
    nodes: Vec<Node>,
    /// From each node to the next, until nodes are merged.
    steps: Vec<Step>,
    index: BTreeMap<KeyframeId, u32>,
}

/// Least error of a step, whatever the registration says of itself: metres and radians, then shares of the way and of the
/// turn. Registrations are surer of themselves than they are right: neighbouring scans share their errors.
const FLOOR: (f64, f64) = (0.005, 0.002);
const SHARES: (f64, f64) = (0.01, 0.01);

/// What a step's covariance is at least.
fn floor_of(t_prev_node: &Pose) -> (f64, f64) {
    let (way, turn) = (t_prev_node.translation.vector.norm(), t_prev_node.rotation.angle());
    let sigma_t = FLOOR.0 + SHARES.0 * way;
    let sigma_r = FLOOR.1 + SHARES.1 * turn;
    (sigma_t * sigma_t, sigma_r * sigma_r)
}

impl Chain {
    pub(super) fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Bytes, about.
    pub(super) fn memory_bytes(&self) -> usize {
        let nodes = self.nodes.capacity() * (size_of::<Node>() + size_of::<(KeyframeId, u32)>());
        nodes + self.steps.capacity() * size_of::<Step>()
    }

    pub(super) fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    pub(super) fn steps(&self) -> &[Step] {
        &self.steps
    }

    /// Whether the steps are those from each node to the next, and no others.
    pub(super) fn is_way(&self) -> bool {
        self.steps.len() + 1 == self.nodes.len() && self.steps.iter().all(|s| s.from + 1 == s.to)
    }

    pub(super) fn index(&self, id: KeyframeId) -> Option<u32> {
        self.index.get(&id).copied()
    }

    /// Adds a node; `measured` is what the odometry says of its step, zero if that is not known.
    pub(super) fn push(&mut self, id: KeyframeId, view: View, t_prev_node: Pose, measured: &Covariance6) {
        let (var_t, var_r) = floor_of(&t_prev_node);
        let floor = Covariance6::from_diagonal(&[var_t, var_t, var_t, var_r, var_r, var_r].into());
        let step = measured + floor;
        let mean = |k: usize| (k..k + 3).map(|i| step[(i, i)]).sum::<f64>() / 3.0;
        let before = self.nodes.last().map_or((0.0, 0.0), |n| n.sums);
        let sums = (before.0 + mean(0), before.1 + mean(3));
        let to = self.nodes.len() as u32;
        if let Some(from) = to.checked_sub(1) {
            self.steps.push(Step { from, to, t_from_to: t_prev_node, covariance: step });
        }
        self.index.insert(id, to);
        self.nodes.push(Node { id, t_prev_node, step, view, sums });
    }

    /// Keeps the nodes that `number` gives a new index; `steps` are between those already.
    pub(super) fn keep(&mut self, number: &[Option<u32>], steps: Vec<Step>) {
        self.steps = steps;
        let mut over: Option<(Pose, Covariance6)> = None;
        let mut kept: Vec<Node> = Vec::with_capacity(self.nodes.len());
        for (mut node, number) in std::mem::take(&mut self.nodes).into_iter().zip(number) {
            if let Some((t, covariance)) = over.take() {
                node.step = se3::compose_covariance(&covariance, &node.t_prev_node, &node.step);
                node.t_prev_node = t * node.t_prev_node;
            }
            match number {
                Some(_) => kept.push(node),
                None => over = Some((node.t_prev_node, node.step)),
            }
        }
        self.index = kept.iter().zip(0..).map(|(n, i)| (n.id, i)).collect();
        self.nodes = kept;
    }

    /// Variances of position and turning that the way from one node to another adds, the lever of the turning over
    /// `distance` metres included.
    pub(super) fn drift(&self, a: u32, b: u32, distance: f64) -> (f64, f64) {
        let at = |i: u32| self.nodes[i as usize].sums;
        let (low, high) = (at(a.min(b)), at(a.max(b)));
        let turn = high.1 - low.1;
        (high.0 - low.0 + turn * distance * distance, turn)
    }
}

/// What the odometry added between two estimates since the start: not less than nothing in any direction.
pub(super) fn step_covariance(before: &Covariance6, t_before_now: &Pose, now: &Covariance6) -> Covariance6 {
    let carried = se3::compose_covariance(before, t_before_now, &Covariance6::zeros());
    let difference = now - carried;
    let mut eigen = ((difference + difference.transpose()) * 0.5).symmetric_eigen();
    eigen.eigenvalues.apply(|v| *v = v.max(0.0));
    let back = eigen.recompose();
    if back.iter().all(|v| v.is_finite()) { back } else { *now }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drift_is_that_of_the_way_between() {
        let mut chain = Chain::default();
        let view = View { sensor: "lidar".into(), around: true };
        for k in 0..10 {
            chain.push(KeyframeId(k), view.clone(), se3::from_xy_yaw(0.5, 0.0, 0.0), &Covariance6::zeros());
        }
        let (t, r) = chain.drift(2, 7, 0.0);
        let (back_t, back_r) = chain.drift(7, 2, 0.0);
        assert!((t - 5.0 * 0.01 * 0.01).abs() < 1e-12 && (r - 5.0 * 0.002 * 0.002).abs() < 1e-12);
        assert!((t, r) == (back_t, back_r));
        assert!((chain.drift(2, 7, 10.0).0 - t - 100.0 * r).abs() < 1e-12);
    }

    #[test]
    fn a_step_adds_what_the_estimates_differ_by() {
        let one = Covariance6::identity() * 1e-4;
        let t = se3::from_xy_yaw(1.0, 2.0, 0.3);
        let now = se3::compose_covariance(&one, &t, &one);
        assert!((step_covariance(&one, &t, &now) - one).norm() < 1e-12);
        // Placed again after a loss: what was added is taken back, not more.
        assert!(step_covariance(&now, &Pose::identity(), &one).symmetric_eigenvalues().min() > -1e-15);
    }
}
