//! Bundle adjustment: poses and points that fit what the views saw, by Levenberg-Marquardt.
//!
//! Points are eliminated first (Schur complement); what is left is a dense system of six unknowns a free camera.
//!
//! **Source:** Triggs, McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment: a modern synthesis", 2000, section 6.

use super::pose::{CHI2, by_pose, project};
use super::second::InverseDepth;
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Matrix6x3, Point3, Vector2, Vector3, Vector6};
use percept_geometry::{Pose, se3};

/// A pixel of a point in a camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct Observation {
    pub(super) camera: u32,
    pub(super) point: u32,
    pub(super) pixel: Vector2<f64>,
    /// Standard deviation, pixels.
    pub(super) sigma: f64,
    /// How far it is by a second camera.
    pub(super) depth: Option<InverseDepth>,
}

/// How far two cameras are apart by another source: `t_a_b`'s translation in a, with its information.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    pub(super) a: u32,
    pub(super) b: u32,
    pub(super) b_in_a: Vector3<f64>,
    pub(super) information: Matrix3<f64>,
}

/// What is adjusted.
#[derive(Debug, Clone, Default)]
pub(super) struct Bundle {
    /// `t_camera_map`; the first `num_free` move, the others hold the map.
    pub(super) cameras: Vec<Pose>,
    pub(super) num_free: usize,
    pub(super) points: Vec<Point3<f64>>,
    /// Sorted by point.
    pub(super) observations: Vec<Observation>,
    pub(super) steps: Vec<Step>,
    pub(super) focal: f64,
}

/// The normal equations, points apart.
struct Normal {
    cameras: DMatrix<f64>,
    camera_gradient: DVector<f64>,
    points: Vec<(Matrix3<f64>, Vector3<f64>)>,
    /// For each observation by a free camera, its block between camera and point.
    cross: Vec<Matrix6x3<f64>>,
}

impl Bundle {
    /// Adjusts; returns the robust cost before and after.
    pub(super) fn adjust(&mut self, iterations: usize) -> (f64, f64) {
        let before = self.cost();
        let (mut cost, mut lambda) = (before, 1e-4);
        for _ in 0..iterations {
            let normal = self.normal();
            let mut improved = false;
            for _ in 0..4 {
                let Some(candidate) = self.step(&normal, lambda) else {
                    lambda *= 10.0;
                    continue;
                };
                let after = candidate.cost();
                if after < cost {
                    improved = cost - after > 1e-4 * cost;
                    (cost, lambda) = (after, (lambda * 0.2).max(1e-8));
                    (self.cameras, self.points) = (candidate.cameras, candidate.points);
                    break;
                }
                lambda *= 10.0;
            }
            if !improved {
                break;
            }
        }
        (before, cost)
    }

    /// Squared error of an observation in standard deviations; infinite behind the camera.
    pub(super) fn chi2(&self, o: &Observation) -> f64 {
        let p = self.cameras[o.camera as usize] * self.points[o.point as usize];
        if p.z <= 1e-6 {
            return f64::INFINITY;
        }
        (p.coords.xy() * (self.focal / p.z) - o.pixel).norm_squared() / (o.sigma * o.sigma)
    }

    /// The same of its depth; 0 if there is none.
    pub(super) fn depth_chi2(&self, o: &Observation) -> f64 {
        let z = || (self.cameras[o.camera as usize] * self.points[o.point as usize]).z;
        o.depth.map_or(0.0, |d| d.residual(z().max(1e-6)).powi(2))
    }

    fn cost(&self) -> f64 {
        let huber = |c: f64| if c <= CHI2 { c } else { 2.0 * (CHI2 * c.min(1e12)).sqrt() - CHI2 };
        let seen: f64 = self.observations.iter().map(|o| huber(self.chi2(o)) + huber(self.depth_chi2(o))).sum();
        let steps: f64 = self
            .steps
            .iter()
            .map(|s| {
                let r = self.step_residual(s);
                r.dot(&(s.information * r))
            })
            .sum();
        seen + steps
    }

    fn step_residual(&self, s: &Step) -> Vector3<f64> {
        let (a, b) = (&self.cameras[s.a as usize], &self.cameras[s.b as usize]);
        (a * b.inverse()).translation.vector - s.b_in_a
    }

    fn normal(&self) -> Normal {
        let n = 6 * self.num_free;
        let mut normal = Normal {
            cameras: DMatrix::zeros(n, n),
            camera_gradient: DVector::zeros(n),
            points: vec![(Matrix3::zeros(), Vector3::zeros()); self.points.len()],
            cross: vec![Matrix6x3::zeros(); self.observations.len()],
        };
        let rotations: Vec<Matrix3<f64>> =
            self.cameras.iter().map(|t| t.rotation.to_rotation_matrix().into_inner()).collect();
        let mut diagonal = vec![(Matrix6::<f64>::zeros(), Vector6::<f64>::zeros()); self.num_free];
        for (k, o) in self.observations.iter().enumerate() {
            let c = o.camera as usize;
            let p = self.cameras[c] * self.points[o.point as usize];
            if p.z <= 1e-6 {
                continue;
            }
            let (pixel, by_camera_point) = project(&p, self.focal);
            let error = (pixel - o.pixel) / o.sigma;
            let length = error.norm();
            let weight = if length > CHI2.sqrt() { CHI2.sqrt() / length } else { 1.0 };
            let by_point = by_camera_point * rotations[c] / o.sigma;
            let weighted = by_point.transpose() * weight;
            let (h, g) = &mut normal.points[o.point as usize];
            *h += weighted * by_point;
            *g += weighted * error;
            if c < self.num_free {
                let by_pose = by_pose(&by_camera_point, &p) / o.sigma;
                let weighted = by_pose.transpose() * weight;
                diagonal[c].0 += weighted * by_pose;
                diagonal[c].1 += weighted * error;
                normal.cross[k] = weighted * by_point;
            }
            let Some(depth) = &o.depth else { continue };
            let error = depth.residual(p.z);
            let weight = if error.abs() > CHI2.sqrt() { CHI2.sqrt() / error.abs() } else { 1.0 };
            let by_camera_point = Vector3::new(0.0, 0.0, -depth.weight / (p.z * p.z));
            let by_point = rotations[c].tr_mul(&by_camera_point);
            let (h, g) = &mut normal.points[o.point as usize];
            *h += weight * by_point * by_point.transpose();
            *g += weight * error * by_point;
            if c < self.num_free {
                let by_turn = p.coords.cross(&by_camera_point);
                let by_pose = Vector6::from_fn(|i, _| if i < 3 { by_camera_point[i] } else { by_turn[i - 3] });
                diagonal[c].0 += weight * by_pose * by_pose.transpose();
                diagonal[c].1 += weight * error * by_pose;
                normal.cross[k] += weight * by_pose * by_point.transpose();
            }
        }
        for (c, (h, g)) in diagonal.iter().enumerate() {
            normal.cameras.fixed_view_mut::<6, 6>(6 * c, 6 * c).copy_from(h);
            normal.camera_gradient.fixed_rows_mut::<6>(6 * c).copy_from(g);
        }
        self.steps.iter().for_each(|s| self.add_step(s, &mut normal));
        normal
    }

    /// Residual `trans(A B^-1) - m` with left perturbations of A and B: moving A moves it as a point in a, moving B
    /// by the rotation from b to a.
    fn add_step(&self, s: &Step, normal: &mut Normal) {
        let t_a_b = self.cameras[s.a as usize] * self.cameras[s.b as usize].inverse();
        let mut by_a = nalgebra::Matrix3x6::zeros();
        by_a.fixed_columns_mut::<3>(0).copy_from(&Matrix3::identity());
        by_a.fixed_columns_mut::<3>(3).copy_from(&-t_a_b.translation.vector.cross_matrix());
        let mut by_b = nalgebra::Matrix3x6::zeros();
        by_b.fixed_columns_mut::<3>(0).copy_from(&-t_a_b.rotation.to_rotation_matrix().matrix());
        let residual = self.step_residual(s);
        let sides = [(s.a as usize, by_a), (s.b as usize, by_b)];
        for (i, ji) in &sides {
            if *i >= self.num_free {
                continue;
            }
            let weighted = ji.transpose() * s.information;
            let mut g = normal.camera_gradient.fixed_rows_mut::<6>(6 * i);
            g += weighted * residual;
            for (j, jj) in sides.iter().filter(|(j, _)| *j < self.num_free) {
                let mut block = normal.cameras.fixed_view_mut::<6, 6>(6 * i, 6 * j);
                block += weighted * jj;
            }
        }
    }

    /// A copy moved by the damped step; none if the system cannot be solved.
    fn step(&self, normal: &Normal, lambda: f64) -> Option<Self> {
        let mut schur = normal.cameras.clone();
        for i in 0..schur.nrows() {
            schur[(i, i)] += lambda * schur[(i, i)] + 1e-9;
        }
        let mut gradient = normal.camera_gradient.clone();
        let mut inverses = Vec::with_capacity(self.points.len());
        let mut first = 0;
        for (point, (h, g)) in normal.points.iter().enumerate() {
            let damped = h + Matrix3::from_diagonal(&(h.diagonal() * lambda).add_scalar(1e-9));
            let inverse =
                damped.try_inverse().filter(|m| m.iter().all(|x| x.is_finite())).unwrap_or_else(Matrix3::zeros);
            inverses.push(inverse);
            let last = first + self.observations[first..].iter().take_while(|o| o.point as usize == point).count();
            for a in first..last {
                let ca = self.observations[a].camera as usize;
                if ca >= self.num_free {
                    continue;
                }
                let w = normal.cross[a] * inverse;
                let mut rows = gradient.fixed_rows_mut::<6>(6 * ca);
                rows -= w * g;
                for b in first..last {
                    let cb = self.observations[b].camera as usize;
                    // The lower triangle is all that Cholesky reads.
                    if cb <= ca && cb < self.num_free {
                        let mut block = schur.fixed_view_mut::<6, 6>(6 * ca, 6 * cb);
                        block -= w * normal.cross[b].transpose();
                    }
                }
            }
            first = last;
        }
        let moved = schur.cholesky()?.solve(&gradient);
        let mut out = self.clone();
        for (c, t) in out.cameras.iter_mut().take(self.num_free).enumerate() {
            *t = se3::exp(&-moved.fixed_rows::<6>(6 * c).into_owned()) * *t;
        }
        // Back to the points: dp = H^-1 (g - W^T dc).
        let mut pulls: Vec<Vector3<f64>> = normal.points.iter().map(|(_, g)| *g).collect();
        for (k, o) in self.observations.iter().enumerate().filter(|(_, o)| (o.camera as usize) < self.num_free) {
            pulls[o.point as usize] -= normal.cross[k].tr_mul(&moved.fixed_rows::<6>(6 * o.camera as usize));
        }
        for ((p, pull), inverse) in out.points.iter_mut().zip(&pulls).zip(&inverses) {
            *p -= inverse * pull;
        }
        Some(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six cameras around a cloud of 80 points, all seen by all.
    fn scene() -> Bundle {
        let wave = |i: usize, k: f64| (i as f64 * k).sin();
        let points: Vec<Point3<f64>> =
            (0..80).map(|i| Point3::new(wave(i, 1.7), wave(i, 2.9), 4.0 + wave(i, 0.7))).collect();
        let cameras: Vec<Pose> = (0..6)
            .map(|i| {
                se3::exp(&Vector6::new(
                    0.2 * i as f64 - 0.5,
                    0.1 * wave(i, 2.0),
                    0.05 * wave(i, 1.0),
                    0.02,
                    -0.05 * i as f64,
                    0.01,
                ))
            })
            .collect();
        let mut observations = vec![];
        for (point, p) in points.iter().enumerate() {
            for (camera, t) in cameras.iter().enumerate() {
                let pixel = project(&(t * p), 500.0).0;
                observations.push(Observation {
                    camera: camera as u32,
                    point: point as u32,
                    pixel,
                    sigma: 1.0,
                    depth: None,
                });
            }
        }
        Bundle { cameras, num_free: 4, points, observations, steps: vec![], focal: 500.0 }
    }

    #[test]
    fn a_disturbed_scene_comes_back_to_the_truth() {
        let truth = scene();
        let mut bundle = truth.clone();
        for (i, t) in bundle.cameras.iter_mut().take(4).enumerate() {
            *t = se3::exp(&Vector6::new(0.02, -0.01, 0.03, 0.01, 0.01 * i as f64, -0.01)) * *t;
        }
        bundle.points.iter_mut().enumerate().for_each(|(i, p)| p.z += 0.05 * (i as f64).sin());
        let (before, after) = bundle.adjust(20);
        assert!(after < 1e-6 * before, "{before} {after}");
        for (a, b) in bundle.cameras.iter().zip(&truth.cameras) {
            assert!(se3::log(&(a * b.inverse())).norm() < 1e-4);
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let mut bundle = scene();
        bundle.steps.push(Step {
            a: 0,
            b: 2,
            b_in_a: Vector3::new(0.3, 0.1, 0.0),
            information: Matrix3::identity() * 40.0,
        });
        bundle.points[3].x += 0.002;
        bundle
            .observations
            .iter_mut()
            .step_by(7)
            .for_each(|o| o.depth = Some(InverseDepth { value: 0.26, weight: 60.0 }));
        let gradient = bundle.normal().camera_gradient;
        let h = 1e-6;
        for i in 0..4 {
            for k in 0..6 {
                let cost = |s: f64| {
                    let mut d = Vector6::zeros();
                    d[k] = s;
                    let mut moved = bundle.clone();
                    moved.cameras[i] = se3::exp(&d) * moved.cameras[i];
                    moved.cost()
                };
                // The cost is the sum of squares: its derivative is twice the gradient's.
                let numeric = (cost(h) - cost(-h)) / (4.0 * h);
                let analytic = gradient[6 * i + k];
                assert!((numeric - analytic).abs() < 1e-3 * (1.0 + analytic.abs()), "{i} {k} {numeric} {analytic}");
            }
        }
    }

    #[test]
    fn known_depths_hold_the_scale() {
        let truth = scene();
        let mut bundle = truth.clone();
        for o in &mut bundle.observations {
            let z = (truth.cameras[o.camera as usize] * truth.points[o.point as usize]).z;
            o.depth = (o.camera < 4).then_some(InverseDepth { value: 0.5 / z, weight: 100.0 });
        }
        // All free but one: everything is twice as large as the cameras say.
        bundle.num_free = 5;
        bundle.adjust(50);
        let apart = |b: &Bundle| (b.cameras[5] * b.cameras[0].inverse()).translation.vector;
        assert!((apart(&bundle) - 2.0 * apart(&truth)).norm() < 1e-3, "{} {}", apart(&bundle), apart(&truth));
    }

    #[test]
    fn a_known_step_sets_the_scale() {
        let mut bundle = scene();
        // All free but the first camera, which is made the fixed one.
        bundle.cameras.reverse();
        for o in &mut bundle.observations {
            o.camera = 5 - o.camera;
        }
        bundle.num_free = 5;
        let t_0_1 = bundle.cameras[5] * bundle.cameras[0].inverse();
        let metric = t_0_1.translation.vector * 2.0;
        bundle.steps.push(Step { a: 5, b: 0, b_in_a: metric, information: Matrix3::identity() * 1e6 });
        bundle.adjust(50);
        let got = (bundle.cameras[5] * bundle.cameras[0].inverse()).translation.vector;
        assert!((got - metric).norm() < 1e-3, "{got} {metric}");
    }
}
