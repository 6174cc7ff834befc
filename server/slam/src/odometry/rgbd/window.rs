//! The local model's keyframes and how they lie to each other, refined as a whole.
//!
//! A frame placed in the model inherits the model's errors. Every few frames one is kept and aligned, densely, to each of
//! the nearest kept ones, near in space and not in time, so that a place seen again at once ties its visits together; then
//! the kept ones' poses are solved for as a small pose graph, and the surfels move with the keyframe that last measured them.
//!
//! Source: Kerl, Sturm, Cremers, "Dense visual SLAM for RGB-D cameras", 2013, section IV (pairs of keyframes aligned
//! densely, weighted by their information); Whelan et al., "ElasticFusion", 2015, for moving the model with them.

use super::align::{Level, Problem, Requirements, align};
use super::frame::{Frame, Vertex};
use super::photometric::{MIN_CONTRAST, Photometric, TexturedPoint};
use super::surfels::View;
use crate::color_camera::ColorCamera;
use crate::covariance::diagonal;
use crate::pose_graph::{Edge, OptimiseParams, PoseGraph, information_of, optimise};
use nalgebra::{Matrix3, Matrix6};
use percept_geometry::{CameraIntrinsics, Covariance6, Pose, se3};
use std::collections::VecDeque;

/// A frame is kept when the camera has moved or turned so far from the one kept last, metres and radians. ATE of
/// `evaluate rgbd rgbd-7scenes-a`: halved 29.2, as 24 frames reach less far back then, doubled 22.0 mm (22.6).
const APART: (f64, f64) = (0.2, 0.2);
/// Kept frames: bounds memory (about 0.6 MB each) and the time of a solution. ATE of `evaluate rgbd rgbd-7scenes-a`:
/// halved 28.4, doubled 22.6 mm (22.6).
const MAX_KEYFRAMES: usize = 24;
/// Kept frames that a new one is aligned to. ATE of `evaluate rgbd rgbd-7scenes-a 2`: halved 28.5, doubled 22.6 mm
/// (22.3).
const MAX_PAIRS: usize = 4;
/// Views farther apart than this share too little, metres and radians. ATE of `evaluate rgbd rgbd-7scenes-a 2`: halved
/// 31.4 mm (22.3).
pub(crate) const NEAR: (f64, f64) = (1.0, 0.6);
/// Squared error in sigmas, for six unknowns, at which a pair is believed by half. 95 % of squared errors of six
/// standard normal numbers are below it.
const AGREE: f64 = 12.6;
/// Every other row and column is kept. A quarter of the points, and of the memory.
const STEP: usize = 2;
/// The start is the model's own, a centimetre or so off.
const LEVELS: [Level; 2] =
    [Level { stride: 2, gate: 0.08, iterations: 5 }, Level { stride: 1, gate: 0.05, iterations: 5 }];

/// A kept frame: its surface and its textured points, as a view that others are aligned to.
struct Kept {
    id: u32,
    view: View,
}

/// The pose of one kept frame measured from another.
struct Pair {
    from: u32,
    to: u32,
    t_from_to: Pose,
    covariance: Covariance6,
}

/// What is kept of the latest frames. Deterministic, bounded in time and memory.
#[derive(Default)]
pub(crate) struct Window {
    kept: VecDeque<Kept>,
    pairs: Vec<Pair>,
    newest: u32,
    /// What the kept frames were seen through.
    camera: Option<CameraIntrinsics>,
}

/// A frame as placed by the model, with the lens of its grid.
pub(crate) struct Placed<'a> {
    pub(crate) frame: &'a Frame,
    pub(crate) camera: &'a CameraIntrinsics,
    pub(crate) color: ColorCamera,
    pub(crate) t_odom_camera: Pose,
    /// Of that placement, right perturbation in the camera.
    pub(crate) covariance: Covariance6,
}

/// How a kept frame moved: new pose times inverse of the old one, in odom.
pub(crate) type Moved = (u32, Pose);

impl Window {
    /// Bytes, about.
    pub(crate) fn memory_bytes(&self) -> usize {
        let views: usize = self.kept.iter().map(|k| k.view.memory_bytes()).sum();
        views + self.pairs.capacity() * size_of::<Pair>()
    }

    pub(crate) fn clear(&mut self) {
        self.kept.clear();
        self.pairs.clear();
    }

    /// Forgets brightness: it was looked up with a camera that turned out wrong.
    pub(crate) fn forget_light(&mut self) {
        self.kept.iter_mut().for_each(|k| k.view.textured.clear());
    }

    /// The kept frame that what is measured now moves with.
    pub(crate) fn newest(&self) -> u32 {
        self.newest
    }

    /// Keeps the frame if it shows a new view, and answers with what moved, the newest last; empty if nothing did.
    pub(crate) fn consider(&mut self, placed: &Placed<'_>) -> Vec<Moved> {
        if self.camera.as_ref() != Some(placed.camera) {
            self.clear();
            self.camera = Some(*placed.camera);
        }
        let apart = |k: &Kept, (m, rad): (f64, f64)| {
            let t = k.view.t_odom_view.inv_mul(&placed.t_odom_camera);
            (t.translation.vector.norm() / m).max(t.rotation.angle() / rad)
        };
        if self.kept.back().is_some_and(|k| apart(k, APART) < 1.0) {
            return vec![];
        }
        let mut near: Vec<(f64, usize)> =
            self.kept.iter().map(|k| apart(k, NEAR)).enumerate().map(|(i, a)| (a, i)).filter(|n| n.0 < 1.0).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = thinned(placed.frame, placed.camera);
        let id = self.newest + 1;
        let measured = near.iter().take(MAX_PAIRS).filter_map(|&(_, i)| measure(&self.kept[i], id, &half, placed));
        let mut pairs: Vec<Pair> = measured.collect();
        // The model's own placement is one more measurement, from the view before.
        if let Some(before) = self.kept.back() {
            let t_from_to = before.view.t_odom_view.inv_mul(&placed.t_odom_camera);
            let covariance = placed.covariance + wrong_by_shape(&t_from_to);
            pairs.push(Pair { from: before.id, to: id, t_from_to, covariance });
        }
        self.pairs.extend(pairs);
        self.keep(id, half, placed);
        if near.is_empty() { vec![] } else { self.solve() }
    }

    fn keep(&mut self, id: u32, (frame, _): (Frame, CameraIntrinsics), placed: &Placed<'_>) {
        let textured = textured(&frame, placed);
        self.kept.push_back(Kept { id, view: View::of(unit(placed.t_odom_camera), frame.vertices, textured) });
        self.newest = id;
        if self.kept.len() > MAX_KEYFRAMES {
            self.kept.pop_front();
            let oldest = self.kept.front().map_or(0, |k| k.id);
            self.pairs.retain(|p| p.from >= oldest);
        }
    }

    /// Least squares over the pairs; those that contradict the rest fade out.
    fn solve(&mut self) -> Vec<Moved> {
        let place = |id: u32| self.kept.iter().position(|k| k.id == id).map(|i| i as u32);
        let poses: Vec<Pose> = self.kept.iter().map(|k| k.view.t_odom_view).collect();
        let mut graph = PoseGraph::<Pose, 6> { poses: poses.clone(), edges: vec![], fixed: vec![0] };
        for p in &self.pairs {
            let (Some(from), Some(to), Some(information)) = (place(p.from), place(p.to), information_of(&p.covariance))
            else {
                continue;
            };
            graph.edges.push(Edge { from, to, t_from_to: p.t_from_to, information });
        }
        let full: Vec<Matrix6<f64>> = graph.edges.iter().map(|e| e.information).collect();
        for _ in 0..2 {
            for (edge, full) in graph.edges.iter_mut().zip(&full) {
                let (a, b) = (&graph.poses[edge.from as usize], &graph.poses[edge.to as usize]);
                let off = se3::log(&edge.t_from_to.inv_mul(&a.inv_mul(b)));
                let halves = Matrix6::from_diagonal(&nalgebra::Vector6::new(1.0, 1.0, 1.0, 0.5, 0.5, 0.5));
                let chi2 = off.dot(&(halves * full * halves * off));
                edge.information = full * (AGREE / (AGREE + chi2)).powi(2).max(1e-4);
            }
            if optimise(&mut graph, &OptimiseParams { max_iterations: 4, tolerance: 1e-3 }).is_err() {
                return vec![];
            }
        }
        let mut moved = vec![];
        for ((kept, new), old) in self.kept.iter_mut().zip(graph.poses).zip(poses) {
            kept.view.t_odom_view = new;
            moved.push((kept.id, unit(new * old.inverse())));
        }
        moved
    }
}

/// With a rotation of length one: what is off in its last digits doubles with every product of a pose and an inverse.
pub(crate) fn unit(mut t: Pose) -> Pose {
    t.rotation.renormalize();
    t
}

/// Aligns the frame to a kept one, from where the model has them.
fn measure(kept: &Kept, to: u32, (half, lens): &(Frame, CameraIntrinsics), placed: &Placed<'_>) -> Option<Pair> {
    let lit = !placed.frame.intensity.is_empty() && kept.view.textured.len() > 200;
    let found = align(&Problem {
        frame: half,
        view: &kept.view,
        camera: lens,
        start: kept.view.t_odom_view.inv_mul(&placed.t_odom_camera),
        photometric: lit.then(|| Photometric {
            intensity: &placed.frame.intensity,
            color: placed.color,
            points: &kept.view.textured,
        }),
        covariance: diagonal(0.1, 0.1),
        r_base_camera: Matrix3::identity(),
        requirements: Requirements { min_overlap: 0.3, min_inlier_ratio: 0.5, max_correction: (0.1, 0.1) },
        levels: &LEVELS,
        pixels_each: (STEP * STEP) as f64,
    })
    .ok()?;
    let t_from_to = kept.view.t_odom_view.inv_mul(&found.t_odom_base);
    Some(Pair { from: kept.id, to, t_from_to, covariance: found.covariance + wrong_by_shape(&t_from_to) })
}

/// Depth is bent alike in every frame (a percent or two with consumer cameras), so what is off does not average out and
/// grows with the distance between views; a radian shifts what is seen as much as a metre does.
fn wrong_by_shape(t_from_to: &Pose) -> Covariance6 {
    let off = 0.002 + 0.02 * (t_from_to.translation.vector.norm() + t_from_to.rotation.angle());
    diagonal(off, 0.5 * off)
}

/// Every `STEP`-th row and column of the frame, with its lens.
fn thinned(frame: &Frame, camera: &CameraIntrinsics) -> (Frame, CameraIntrinsics) {
    let lens = camera.shrunk(STEP, false);
    let pick = |i: usize| frame.vertices[i / lens.width * STEP * frame.width + i % lens.width * STEP];
    let vertices: Vec<Vertex> = (0..lens.width * lens.height).map(pick).collect();
    (Frame::of_vertices(lens.width, vertices), lens)
}

/// Points of the thinned frame at which brightness changes.
fn textured(thinned: &Frame, placed: &Placed<'_>) -> Vec<TexturedPoint> {
    if placed.frame.intensity.is_empty() {
        return vec![];
    }
    let look = |p: &nalgebra::Vector3<f32>| {
        let (u, v) = placed.color.project(p);
        placed.frame.intensity.sample(u, v).filter(|s| s.du.abs().max(s.dv.abs()) > MIN_CONTRAST)
    };
    let points = thinned.vertices.iter().filter(|v| v.p.z > 0.1);
    points.filter_map(|v| look(&v.p).map(|s| TexturedPoint { p: v.p, intensity: s.value })).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn lens() -> CameraIntrinsics {
        CameraIntrinsics::pinhole(160, 120, 130.0, 130.0, 80.0, 60.0)
    }

    /// What a camera at `t` sees of a room of 4 x 3 x 5 m around the origin.
    fn seen(t: &Pose) -> Frame {
        let half = Vector3::new(2.0, 1.5, 2.5);
        let vertex = |i: usize| {
            let ray = lens().ray((i % 160) as f64, (i / 160) as f64).coords;
            let (from, along) = (t.translation.vector, t.rotation * ray);
            let hit = |k: usize| (half[k] * along[k].signum() - from[k]) / along[k];
            let k = (0..3).min_by(|&a, &b| hit(a).total_cmp(&hit(b))).unwrap();
            let normal = Vector3::ith(k, -along[k].signum());
            Vertex { p: (ray * hit(k)).cast(), n: (t.rotation.inverse() * normal).cast() }
        };
        Frame::of_vertices(160, (0..160 * 120).map(vertex).collect())
    }

    fn consider(window: &mut Window, truth: &Pose, t_odom_camera: Pose) -> Vec<Moved> {
        let (frame, camera, color) = (seen(truth), lens(), ColorCamera::registered(&lens()));
        let placed =
            Placed { frame: &frame, camera: &camera, color, t_odom_camera, covariance: diagonal(0.001, 0.001) };
        window.consider(&placed)
    }

    /// A corner in view, so that all six axes are fixed; swaying sideways, there and back.
    fn at(k: usize) -> Pose {
        let sway = 0.25 * [0, 1, 2, 1][k % 4] as f64;
        se3::exp(&nalgebra::Vector6::new(0.2 - sway, 0.1, 0.3, 0.6, 0.5, 0.0))
    }

    #[test]
    fn a_view_seen_again_takes_the_drift_out() {
        let mut window = Window::default();
        let drift = se3::exp(&nalgebra::Vector6::new(0.004, -0.003, 0.002, 0.002, 0.001, -0.001));
        // Each placement is off by the drift from the pose before, as refined.
        let mut believed = at(0);
        consider(&mut window, &at(0), believed);
        for k in 1..8 {
            believed *= at(k - 1).inv_mul(&at(k)) * drift;
            let moved = consider(&mut window, &at(k), believed);
            believed = moved.last().unwrap().1 * believed;
        }
        let off = se3::log(&at(7).inv_mul(&believed));
        assert!(off.fixed_rows::<3>(0).norm() < 0.006 && off.fixed_rows::<3>(3).norm() < 0.004, "{off}");
    }

    #[test]
    fn rotations_keep_length_one_through_any_number_of_corrections() {
        let mut window = Window::default();
        let mut believed = at(0);
        for k in 0..70 {
            believed = at(k) * believed.inverse() * believed;
            if let Some((_, t)) = consider(&mut window, &at(k), believed).last() {
                believed = unit(t * believed);
            }
            assert!((believed.rotation.norm() - 1.0).abs() < 1e-12, "{k}");
        }
        assert!(window.kept.len() <= MAX_KEYFRAMES && window.pairs.len() <= MAX_KEYFRAMES * (MAX_PAIRS + 1));
    }

    #[test]
    fn another_lens_starts_anew() {
        let mut window = Window::default();
        consider(&mut window, &at(0), at(0));
        let (frame, color) = (seen(&at(1)), ColorCamera::registered(&lens()));
        let camera = CameraIntrinsics::pinhole(160, 120, 140.0, 140.0, 80.0, 60.0);
        let covariance = diagonal(0.001, 0.001);
        let placed = Placed { frame: &frame, camera: &camera, color, t_odom_camera: at(1), covariance };
        assert!(window.consider(&placed).is_empty());
        assert_eq!(window.kept.len(), 1);
    }
}
