//! Keyframes in the order of their making, and how sure the way from each to the next is.

use crate::odometry::{OdometryNoise, way_m};
use nalgebra::Vector6;
use percept_geometry::{Covariance6, KeyframeId, KeyframeScan, Pose, SensorId, se3};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};

/// A keyframe sees around if its points lie in so many of the sectors around it. Two sectors of 22.5 degrees may be
/// missing: a post, or the robot itself.
const SECTORS: usize = 16;
const AROUND: u32 = 14;

/// What a keyframe sees, as far as it matters for what another one sees, too.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct View {
    pub(super) sensor: SensorId,
    /// All around, so that turning shows nothing else.
    pub(super) around: bool,
}

impl View {
    /// Of a keyframe whose scan cannot be had: nobody else sees the same.
    pub(super) fn unknown() -> Self {
        Self { sensor: SensorId(String::new()), around: false }
    }

    pub(super) fn of(scan: &KeyframeScan) -> Self {
        let origin = scan.t_base_sensor.translation.vector.xy().cast::<f32>();
        let sector = |p: &nalgebra::Point3<f32>| {
            let d = p.coords.xy() - origin;
            let turn = (f64::from(d.y).atan2(f64::from(d.x)) + PI) / TAU;
            1u32 << ((turn * SECTORS as f64) as usize).min(SECTORS - 1)
        };
        let seen = scan.hits.positions.iter().fold(0, |seen, p| seen | sector(p));
        Self { sensor: scan.sensor.clone(), around: seen.count_ones() >= AROUND }
    }
}

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
#[derive(Debug, Clone)]
pub(super) struct Chain {
    noise: OdometryNoise,
    nodes: Vec<Node>,
    /// From each node to the next, until nodes are merged.
    steps: Vec<Step>,
    index: BTreeMap<KeyframeId, u32>,
}

impl Chain {
    /// No nodes; steps will be those of an odometry with this noise.
    pub(super) fn new(noise: OdometryNoise) -> Self {
        Self { noise, nodes: vec![], steps: vec![], index: BTreeMap::new() }
    }

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
        let step = self.at_least_noise(&t_prev_node, measured);
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

    /// A step's covariance with what registration adds at its ends, and not less than the noise of the way: what odometry says
    /// of itself does not know that neighbouring scans share their errors, or is not known.
    fn at_least_noise(&self, t_prev_node: &Pose, measured: &Covariance6) -> Covariance6 {
        let (sigma_m, sigma_rad) =
            self.noise.after(way_m(t_prev_node.translation.vector.norm(), t_prev_node.rotation.angle()));
        let at_once = (self.noise.position.at_once, self.noise.rotation.at_once);
        let added = Vector6::from_fn(|k, _| {
            let (sigma, once) = if k < 3 { (sigma_m, at_once.0) } else { (sigma_rad, at_once.1) };
            (sigma * sigma - measured[(k, k)]).max(once * once)
        });
        measured + Covariance6::from_diagonal(&added)
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
    use crate::odometry::OdometryKind;

    #[test]
    fn drift_is_that_of_the_way_between() {
        let noise = OdometryNoise::of(OdometryKind::Lidar3d);
        let mut chain = Chain::new(noise);
        let view = View { sensor: "lidar".into(), around: true };
        for k in 0..10 {
            chain.push(KeyframeId(k), view.clone(), se3::from_xy_yaw(0.5, 0.0, 0.0), &Covariance6::zeros());
        }
        let (t, r) = chain.drift(2, 7, 0.0);
        let (back_t, back_r) = chain.drift(7, 2, 0.0);
        let step = noise.after(0.5);
        assert!((t - 5.0 * step.0.powi(2)).abs() < 1e-12 && (r - 5.0 * step.1.powi(2)).abs() < 1e-12);
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
