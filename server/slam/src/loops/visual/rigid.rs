//! The motion between two sets of points that were paired by their looks, of which many pairs are wrong.
//!
//! Sources: Fischler and Bolles, "Random sample consensus", 1981; Umeyama, "Least-squares estimation of transformation
//! parameters between two point patterns", 1991.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use percept_geometry::Pose;

/// Samples of three pairs. Of pairs of which a fifth are right, all samples miss in 4 of 100 cases: (1 - 0.2^3)^400.
const SAMPLES: usize = 400;

/// A pair: the point in `from`, the point in `to`, and how far they may lie apart, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair {
    pub(super) from: Point3<f64>,
    pub(super) to: Point3<f64>,
    pub(super) tolerance: f64,
}

impl Pair {
    fn fits(&self, t_from_to: &Pose) -> bool {
        (t_from_to * self.to - self.from).norm_squared() < self.tolerance * self.tolerance
    }
}

/// The motion that most pairs agree on, and which; none if fewer than `least` do. The same for the same pairs.
pub(super) fn most_agree(pairs: &[Pair], least: usize) -> Option<(Pose, Vec<usize>)> {
    if pairs.len() < least.max(3) {
        return None;
    }
    let mut best: Vec<usize> = vec![];
    let mut state = 0x2545_f491_4f6c_dd1du64;
    let mut draw = |n: usize| {
        // xorshift64*: Vigna 2016.
        state ^= state >> 12;
        state ^= state << 25;
        state ^= state >> 27;
        (state.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) as usize % n
    };
    for _ in 0..SAMPLES {
        let sample = [draw(pairs.len()), draw(pairs.len()), draw(pairs.len())];
        let Some(t) = of_sample(pairs, sample) else { continue };
        let inliers = inliers(pairs, &t);
        if inliers.len() > best.len() {
            best = inliers;
        }
    }
    let mut t = None;
    for _ in 0..3 {
        if best.len() < least {
            return None;
        }
        let found = fit(pairs, &best)?;
        best = inliers(pairs, &found);
        t = Some(found);
    }
    t.filter(|_| best.len() >= least).map(|t| (t, best))
}

fn inliers(pairs: &[Pair], t: &Pose) -> Vec<usize> {
    (0..pairs.len()).filter(|&i| pairs[i].fits(t)).collect()
}

/// Distances within a sample are the same in both, and it is no point or line.
fn of_sample(pairs: &[Pair], sample: [usize; 3]) -> Option<Pose> {
    let [a, b, c] = sample.map(|i| &pairs[i]);
    for (p, q) in [(a, b), (b, c), (c, a)] {
        let (d, e) = ((p.from - q.from).norm(), (p.to - q.to).norm());
        if d < 0.1 || (d - e).abs() > p.tolerance + q.tolerance {
            return None;
        }
    }
    if (b.from - a.from).cross(&(c.from - a.from)).norm() < 0.01 {
        return None;
    }
    fit(pairs, &sample)
}

/// Least squares, each pair by the inverse square of its tolerance.
fn fit(pairs: &[Pair], among: &[usize]) -> Option<Pose> {
    let weight = |p: &Pair| 1.0 / (p.tolerance * p.tolerance);
    let total: f64 = among.iter().map(|&i| weight(&pairs[i])).sum();
    let mean = |of: fn(&Pair) -> &Point3<f64>| -> Vector3<f64> {
        among.iter().map(|&i| of(&pairs[i]).coords * weight(&pairs[i])).sum::<Vector3<f64>>() / total
    };
    let (mf, mt) = (mean(|p| &p.from), mean(|p| &p.to));
    let mut c = Matrix3::zeros();
    for p in among.iter().map(|&i| &pairs[i]) {
        c += (p.from.coords - mf) * (p.to.coords - mt).transpose() * weight(p);
    }
    let svd = c.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = (u * v_t).determinant().signum();
    let r = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    // Not `from_matrix`: its iteration need not end.
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r));
    let t = Pose::from_parts((mf - rotation * mt).into(), rotation);
    t.translation.vector.iter().all(|x| x.is_finite()).then_some(t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::se3;

    #[test]
    fn the_true_motion_is_found_among_wrong_pairs_and_none_among_wrong_ones_alone() {
        let truth = se3::exp(&nalgebra::Vector6::new(0.5, -0.2, 0.1, 0.3, -0.1, 0.7));
        let at = |i: usize, k: f64| ((i as f64 * k).sin() * 1000.0).fract() * 3.0;
        let pair = |i: usize| {
            let to = Point3::new(at(i, 1.3), at(i, 2.7), at(i, 3.9));
            let from = if i.is_multiple_of(3) { truth * to } else { Point3::new(at(i, 5.1), at(i, 0.7), at(i, 4.3)) };
            Pair { from, to, tolerance: 0.03 }
        };
        let pairs: Vec<Pair> = (0..90).map(pair).collect();
        let (t, inliers) = most_agree(&pairs, 12).unwrap();
        assert!(se3::log(&(truth.inverse() * t)).norm() < 1e-9);
        assert_eq!(inliers.iter().filter(|i| i.is_multiple_of(3)).count(), 30);
        let wrong: Vec<Pair> =
            pairs.iter().enumerate().filter(|(i, _)| !i.is_multiple_of(3)).map(|(_, p)| *p).collect();
        assert!(most_agree(&wrong, 12).is_none());
    }
}
