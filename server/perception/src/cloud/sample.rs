//! Fewer points: every n-th, a random share, or far from each other.

use super::{at_least, positive};
use nalgebra::Point3;
use percept_geometry::{GeometryError, cloud::is_finite};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Indices of every `step`-th finite point, from the first on.
///
/// # Errors
/// `OutOfRange` for a step of 0.
pub fn sample_uniform(positions: &[Point3<f32>], step: usize) -> Result<Vec<usize>, GeometryError> {
    at_least("step", step, 1, "at least 1")?;
    Ok(finite(positions).step_by(step).collect())
}

/// Indices, ascending, of `count` finite points drawn without putting back (all if there are no more). Same seed, same
/// points.
///
/// Source: selection sampling, Knuth, "The art of computer programming" 2, algorithm 3.4.2 S.
pub fn sample_random(positions: &[Point3<f32>], count: usize, seed: u64) -> Vec<usize> {
    let mut left = finite(positions).count();
    let mut wanted = count.min(left);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Vec::with_capacity(wanted);
    for i in finite(positions) {
        if wanted > 0 && rng.random_range(0..left) < wanted {
            out.push(i);
            wanted -= 1;
        }
        left -= 1;
    }
    out
}

/// Indices of `count` finite points (all if there are no more), each as far as possible from those before it, beginning
/// with one that the seed chooses. Ends early when all that is left lies on chosen points. `O(n count)`.
///
/// Source: Eldar et al., "The farthest point strategy for progressive image sampling", 1997.
pub fn sample_farthest(positions: &[Point3<f32>], count: usize, seed: u64) -> Vec<usize> {
    let indices: Vec<usize> = finite(positions).collect();
    if indices.is_empty() || count == 0 {
        return vec![];
    }
    let points: Vec<Point3<f32>> = indices.iter().map(|&i| positions[i]).collect();
    let mut nearest2 = vec![f32::INFINITY; points.len()];
    let mut next = ChaCha8Rng::seed_from_u64(seed).random_range(0..points.len());
    let mut out = Vec::with_capacity(count.min(points.len()));
    while out.len() < count.min(points.len()) {
        out.push(indices[next]);
        let (farthest, distance2) = recede(&points, &points[next], &mut nearest2);
        if distance2 <= 0.0 {
            break;
        }
        next = farthest;
    }
    out
}

/// Shortens each point's distance to the chosen ones by a new one; the farthest point then, the first of equals.
fn recede(points: &[Point3<f32>], chosen: &Point3<f32>, nearest2: &mut [f32]) -> (usize, f32) {
    for (n, p) in nearest2.iter_mut().zip(points) {
        let d = p - chosen;
        *n = n.min(d.x * d.x + d.y * d.y + d.z * d.z);
    }
    let mut best = (0, -1.0);
    for (i, &n) in nearest2.iter().enumerate() {
        if n > best.1 {
            best = (i, n);
        }
    }
    best
}

fn finite(positions: &[Point3<f32>]) -> impl Iterator<Item = usize> + '_ {
    (0..positions.len()).filter(|&i| is_finite(&positions[i]))
}

/// Indices of the finite points within `low_m..=high_m` of `center`, ascending.
///
/// # Errors
/// `OutOfRange` for ranges that are negative, not finite or do not rise, or a centre that is not finite.
pub fn crop_range(
    positions: &[Point3<f32>],
    center: &Point3<f64>,
    low_m: f64,
    high_m: f64,
) -> Result<Vec<usize>, GeometryError> {
    if !(low_m >= 0.0 && low_m.is_finite()) {
        return Err(GeometryError::OutOfRange { field: "min_range_m", value: low_m, requirement: "0 or more" });
    }
    positive("max_range_m", high_m)?;
    if high_m < low_m {
        return Err(GeometryError::OutOfRange {
            field: "max_range_m",
            value: high_m,
            requirement: "min_range_m or more",
        });
    }
    finite_point("centre_m", center)?;
    let within = |i: &usize| (low_m..=high_m).contains(&(positions[*i].cast::<f64>() - center).norm());
    Ok(finite(positions).filter(within).collect())
}

/// Indices of the finite points in a box, its border included, ascending. The box is axis-aligned in its own frame:
/// `t_frame_box` maps its coordinates to the cloud's, `size` are its edges.
///
/// # Errors
/// `OutOfRange` for edges that are negative or not finite.
pub fn crop_box(positions: &[Point3<f32>], bbox: &percept_geometry::OrientedBox3) -> Result<Vec<usize>, GeometryError> {
    for value in bbox.size.iter().copied() {
        if !(value >= 0.0 && value.is_finite()) {
            return Err(GeometryError::OutOfRange { field: "size_m", value, requirement: "0 or more and finite" });
        }
    }
    finite_point("t_frame_box", &bbox.center())?;
    let t_box_frame = bbox.t_frame_box.inverse();
    let half = 0.5 * bbox.size;
    let within = |i: &usize| {
        let p = t_box_frame * positions[*i].cast::<f64>();
        p.x.abs() <= half.x && p.y.abs() <= half.y && p.z.abs() <= half.z
    };
    Ok(finite(positions).filter(within).collect())
}

/// Indices of the finite points whose x and y lie inside of a polygon and whose z lies within `z_min_m..=z_max_m`,
/// ascending. The polygon may be concave; where it crosses itself, the even-odd rule holds.
///
/// Source: Shimrat, "Algorithm 112: position of point relative to polygon", 1962.
///
/// # Errors
/// `OutOfRange` for fewer than three corners, one that is not finite, or heights that do not rise.
pub fn crop_polygon(
    positions: &[Point3<f32>],
    corners: &[nalgebra::Point2<f64>],
    z_min_m: f64,
    z_max_m: f64,
) -> Result<Vec<usize>, GeometryError> {
    at_least("polygon", corners.len(), 3, "at least 3 corners")?;
    if let Some(&value) = corners.iter().flat_map(|c| c.coords.iter()).find(|v| !v.is_finite()) {
        return Err(GeometryError::OutOfRange { field: "polygon", value, requirement: "finite" });
    }
    if z_min_m.is_nan() || z_max_m.is_nan() || z_max_m < z_min_m {
        return Err(GeometryError::OutOfRange { field: "z_max_m", value: z_max_m, requirement: "z_min_m or more" });
    }
    let within = |i: &usize| {
        let p = positions[*i].cast::<f64>();
        (z_min_m..=z_max_m).contains(&p.z) && inside(corners, p.x, p.y)
    };
    Ok(finite(positions).filter(within).collect())
}

fn inside(corners: &[nalgebra::Point2<f64>], x: f64, y: f64) -> bool {
    let mut odd = false;
    let mut before = corners[corners.len() - 1];
    for &corner in corners {
        if (corner.y > y) != (before.y > y) {
            let crossing = before.x + (y - before.y) / (corner.y - before.y) * (corner.x - before.x);
            odd ^= x < crossing;
        }
        before = corner;
    }
    odd
}

fn finite_point(field: &'static str, p: &Point3<f64>) -> Result<(), GeometryError> {
    match p.iter().find(|v| !v.is_finite()) {
        Some(&value) => Err(GeometryError::OutOfRange { field, value, requirement: "finite" }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point2, Vector3};
    use percept_geometry::{OrientedBox3, Pose};
    use proptest::prelude::*;

    fn cloud() -> impl Strategy<Value = Vec<Point3<f32>>> {
        let coordinate = || prop_oneof![9 => -5.0..5.0f32, 1 => Just(f32::NAN)];
        prop::collection::vec([coordinate(), coordinate(), coordinate()].prop_map(Point3::from), 0..60)
    }

    proptest! {
        #[test]
        fn samples_are_finite_points_without_doubles(points in cloud(), count in 0usize..80, seed in any::<u64>()) {
            let all = finite(&points).count();
            for chosen in [sample_random(&points, count, seed), sample_farthest(&points, count, seed)] {
                prop_assert_eq!(chosen.len(), count.min(all));
                let mut sorted = chosen.clone();
                sorted.sort_unstable();
                sorted.dedup();
                prop_assert_eq!(sorted.len(), chosen.len());
                prop_assert!(chosen.iter().all(|&i| is_finite(&points[i])));
            }
        }

        #[test]
        fn the_farthest_point_is_chosen_each_time(points in cloud(), seed in any::<u64>()) {
            let chosen = sample_farthest(&points, 10, seed);
            let away = |i: usize, from: &[usize]| {
                from.iter().map(|&j| (points[i] - points[j]).norm_squared()).fold(f32::INFINITY, f32::min)
            };
            for k in 1..chosen.len() {
                let most = finite(&points).map(|i| away(i, &chosen[..k])).fold(0.0, f32::max);
                prop_assert!(away(chosen[k], &chosen[..k]) >= most * (1.0 - 1e-5));
            }
        }

        #[test]
        fn a_polygon_that_is_a_box_crops_as_the_box(points in cloud(), x in -4.0..4.0f64, y in -4.0..4.0f64) {
            let corners = [(x - 1.5, y - 2.0), (x + 1.5, y - 2.0), (x + 1.5, y + 2.0), (x - 1.5, y + 2.0)];
            let corners = corners.map(|(x, y)| Point2::new(x, y));
            let bbox = OrientedBox3 { t_frame_box: Pose::translation(x, y, 0.5), size: Vector3::new(3.0, 4.0, 3.0) };
            prop_assert_eq!(crop_polygon(&points, &corners, -1.0, 2.0).unwrap(), crop_box(&points, &bbox).unwrap());
        }
    }

    #[test]
    fn a_turned_box_and_a_shell_crop_what_lies_in_them() {
        let points: Vec<_> = (0..10).map(|i| Point3::new(i as f32, i as f32, 0.0)).collect();
        let turned = Pose::new(Vector3::new(2.0, 2.0, 0.0), Vector3::z() * std::f64::consts::FRAC_PI_4);
        let long = OrientedBox3 { t_frame_box: turned, size: Vector3::new(3.0, 0.1, 1.0) };
        assert_eq!(crop_box(&points, &long).unwrap(), [1, 2, 3]);
        assert_eq!(crop_range(&points, &Point3::origin(), 1.0, 5.0).unwrap(), [1, 2, 3]);
        assert_eq!(sample_uniform(&points, 4).unwrap(), [0, 4, 8]);
    }

    #[test]
    fn a_concave_polygon_leaves_its_notch_out() {
        let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (2.0, 1.0), (0.0, 4.0)].map(|(x, y)| Point2::new(x, y));
        let points = [Point3::new(2.0, 3.0, 0.0), Point3::new(0.5, 2.0, 0.0), Point3::new(3.5, 2.0, 0.0)];
        assert_eq!(crop_polygon(&points, &corners, f64::NEG_INFINITY, f64::INFINITY).unwrap(), [1, 2]);
    }

    #[test]
    fn what_cannot_be_is_named() {
        assert!(matches!(sample_uniform(&[], 0), Err(GeometryError::OutOfRange { field: "step", .. })));
        let center = Point3::origin();
        assert!(matches!(
            crop_range(&[], &center, 2.0, 1.0),
            Err(GeometryError::OutOfRange { field: "max_range_m", .. })
        ));
        assert!(matches!(crop_polygon(&[], &[], 0.0, 1.0), Err(GeometryError::OutOfRange { field: "polygon", .. })));
        let flat = OrientedBox3 { t_frame_box: Pose::identity(), size: Vector3::new(1.0, -1.0, 1.0) };
        assert!(matches!(crop_box(&[], &flat), Err(GeometryError::OutOfRange { field: "size_m", .. })));
    }
}
