//! The whole of what was seen from one side.

use super::Structure;
use nalgebra::{Matrix3, Point2, Point3, Vector2, Vector3};
use percept_geometry::{ObjectClass, OrientedBox3, se3};

/// A circle is fitted to what lies lower than the top by this, metres: of the top the inside is seen, too.
const TOP_M: f64 = 0.1;
/// Points farther than this from the circle are none of it, metres: twice the voxels of the cloud.
const OFF_M: f64 = 0.1;
/// So many of the points have to lie on the circle.
const ON_CIRCLE: f64 = 0.7;
/// Nearer than this is on it, metres: a voxel.
const ON_M: f64 = 0.05;
/// Radii of what stands in rooms and is round, metres.
const RADII_M: [f64; 2] = [0.08, 0.4];
/// The arc that is seen is at least so long a share of the diameter: of less, noise makes circles of any size.
const MIN_CHORD: f64 = 0.7;
/// A box is so deep at least, metres: what boxes are wide in the mean ([`super::GaussianClassifier`]'s model).
const BOX_DEPTH_M: f64 = 0.42;
/// Strips so deep are looked at one after the other behind a face, metres: a voxel.
const STRIP_M: f64 = 0.05;
/// A strip was seen where so large a share of it shows floor or something else.
const SEEN: f64 = 0.2;

/// The box of a thing of a class, grown to what is hidden: what is round is a circle, of which an arc is seen; a box of which
/// one face is seen goes on behind it, as far as the floor there is not seen and boxes are deep.
///
/// `points` are the thing's, `all` those of the cloud; z up.
pub(super) fn completed(
    class: ObjectClass,
    bbox: &OrientedBox3,
    points: &[Point3<f32>],
    all: &[Point3<f32>],
    structure: &Structure,
) -> OrientedBox3 {
    match class {
        ObjectClass::Cylinder => round(bbox, points, structure).unwrap_or(*bbox),
        ObjectClass::Box => deepened(bbox, all, structure),
        _ => *bbox,
    }
}

/// The box around the circle on which a round thing's sides lie; none where they lie on none.
fn round(bbox: &OrientedBox3, points: &[Point3<f32>], structure: &Structure) -> Option<OrientedBox3> {
    let center = bbox.center();
    let top = structure.height(&center) + 0.5 * bbox.size.z;
    let sides = points.iter().map(|p| p.cast::<f64>()).filter(|p| structure.height(p) < top - TOP_M);
    let sides: Vec<Vector2<f64>> = sides.map(|p| (p - center).xy()).collect();
    let mut circle = circle_through(&sides)?;
    for _ in 0..3 {
        let near: Vec<Vector2<f64>> = sides.iter().filter(|p| off(&circle, p) < OFF_M).copied().collect();
        circle = circle_through(&near)?;
    }
    let on = sides.iter().filter(|p| off(&circle, p) < ON_M).count();
    let (middle, radius) = circle;
    let chord = bbox.size.x.max(bbox.size.y);
    let is_sound = on as f64 >= ON_CIRCLE * sides.len() as f64
        && (RADII_M[0]..=RADII_M[1]).contains(&radius)
        && chord >= MIN_CHORD * 2.0 * radius
        && middle.norm() <= 2.0 * radius;
    let size = Vector3::new(2.0 * radius, 2.0 * radius, bbox.size.z);
    let at = Point3::new(center.x + middle.x, center.y + middle.y, center.z);
    is_sound.then(|| OrientedBox3::upright(at, size, se3::yaw(&bbox.t_frame_box)))
}

fn off((middle, radius): &(Vector2<f64>, f64), p: &Vector2<f64>) -> f64 {
    ((p - middle).norm() - radius).abs()
}

/// Centre and radius of the circle that is nearest to points.
///
/// Source: Taubin, "Estimation of planar curves, surfaces and nonplanar space curves defined by implicit equations", 1991, as the
/// least singular vector of centred coordinates (Chernov, "Circular and linear regression", 2010, section 5.10): unlike the plain
/// algebraic fit it does not make short arcs smaller.
fn circle_through(points: &[Vector2<f64>]) -> Option<(Vector2<f64>, f64)> {
    if points.len() < 6 {
        return None;
    }
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector2<f64>>() / count;
    let squares = |p: &Vector2<f64>| (p - mean).norm_squared();
    let mean_square = points.iter().map(squares).sum::<f64>() / count;
    if mean_square <= 0.0 {
        return None;
    }
    let scale = 2.0 * mean_square.sqrt();
    let mut scatter = Matrix3::zeros();
    for p in points {
        let d = p - mean;
        let row = Vector3::new((d.norm_squared() - mean_square) / scale, d.x, d.y);
        scatter += row * row.transpose();
    }
    let eigen = scatter.symmetric_eigen();
    let a = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let square = a[0] / scale;
    if square.abs() < 1e-9 {
        return None;
    }
    let middle = -Vector2::new(a[1], a[2]) / (2.0 * square);
    let radius = (middle.norm_squared() + mean_square).sqrt();
    (middle.iter().all(|v| v.is_finite()) && radius.is_finite()).then(|| (middle + mean, radius))
}

/// The box with the sides that are less deep than boxes are moved out over what is hidden.
fn deepened(bbox: &OrientedBox3, all: &[Point3<f32>], structure: &Structure) -> OrientedBox3 {
    let mut grown = *bbox;
    for axis in 0..2 {
        let lacking = BOX_DEPTH_M - grown.size[axis];
        if lacking < STRIP_M {
            continue;
        }
        let hidden = [-1.0, 1.0].map(|side| hidden_behind(&grown, axis, side, lacking, all, structure));
        let (side, depth) = if hidden[1] > hidden[0] { (1.0, hidden[1]) } else { (-1.0, hidden[0]) };
        let outward = grown.t_frame_box.rotation * Vector3::ith(axis, side);
        grown.size[axis] += depth;
        grown.t_frame_box.translation.vector += outward * (0.5 * depth);
    }
    grown
}

/// How far behind a face neither floor nor anything else is seen, at most `limit`; metres.
fn hidden_behind(
    bbox: &OrientedBox3,
    axis: usize,
    side: f64,
    limit: f64,
    all: &[Point3<f32>],
    structure: &Structure,
) -> f64 {
    let across = 1 - axis;
    let num = (limit / STRIP_M).ceil() as usize;
    let mut seen = vec![0_usize; num];
    let reach = 0.5 * bbox.size.xy().norm() + limit + STRIP_M;
    let center: Point2<f32> = bbox.center().xy().cast();
    // A voxel is the face's own.
    let start = 0.5 * bbox.size[axis] + STRIP_M;
    for p in all.iter().filter(|p| (p.xy() - center).norm_squared() < (reach * reach) as f32) {
        let p: Point3<f64> = p.cast();
        if structure.height(&p) > bbox.size.z {
            continue;
        }
        let local = bbox.t_frame_box.inverse_transform_point(&p);
        let depth = side * local[axis] - start;
        if depth >= 0.0
            && local[across].abs() <= 0.5 * bbox.size[across]
            && let Some(strip) = seen.get_mut((depth / STRIP_M) as usize)
        {
            *strip += 1;
        }
    }
    let cells = (bbox.size[across] / STRIP_M).max(1.0);
    let hidden = seen.iter().take_while(|n| (**n as f64) < SEEN * cells).count();
    if hidden == 0 { 0.0 } else { (STRIP_M * (hidden + 1) as f64).min(limit) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_geometry::Plane;

    fn level() -> Structure {
        Structure { floor: Plane::through(&Point3::origin(), Vector3::z_axis()), walls: vec![] }
    }

    #[test]
    fn an_arc_of_a_third_tells_the_circle() {
        let (middle, radius) = (Vector2::new(3.0, -2.0), 0.2);
        let arc = |i: i32, n: i32| f64::from(i) / f64::from(n) * std::f64::consts::TAU / 3.0;
        let points: Vec<Vector2<f64>> =
            (0..=20).map(|i| middle + radius * Vector2::new(arc(i, 20).cos(), arc(i, 20).sin())).collect();
        let found = circle_through(&points).unwrap();
        assert!((found.0 - middle).norm() < 1e-6 && (found.1 - radius).abs() < 1e-6, "{found:?}");
        assert_eq!(circle_through(&points[..5]), None);
        assert_eq!(circle_through(&[middle; 10]), None);
    }

    #[test]
    fn a_bin_that_was_seen_from_one_side_is_round() {
        let (middle, radius, height) = (Point3::new(1.0, 2.0, 0.0), 0.2, 0.6);
        let mut points = vec![];
        for (i, k) in (0..=12).flat_map(|i| (0..=12).map(move |k| (i, k))) {
            let (angle, z) = (std::f64::consts::PI * f64::from(i) / 12.0, height * f64::from(k) / 12.0);
            points.push((middle + Vector3::new(radius * angle.cos(), radius * angle.sin(), z)).cast::<f32>());
        }
        let seen = OrientedBox3::upright(Point3::new(1.0, 2.1, 0.3), Vector3::new(0.4, 0.2, 0.6), 0.0);
        let whole = completed(ObjectClass::Cylinder, &seen, &points, &points, &level());
        let truth = OrientedBox3::upright(Point3::new(1.0, 2.0, 0.3), Vector3::new(0.4, 0.4, 0.6), 0.0);
        assert!(whole.iou_upright(&truth) > 0.95, "{whole:?}");
    }

    #[test]
    fn a_box_of_which_one_face_was_seen_goes_on_where_the_floor_is_hidden() {
        let mut all = vec![];
        // Floor before it and beside it; behind it is what it hides.
        for (i, j) in (-20..=20).flat_map(|i| (-20..=20).map(move |j| (i, j))) {
            let (x, y) = (0.05 * f64::from(i), 0.05 * f64::from(j));
            if !(x > -0.02 && y.abs() < 0.28) {
                all.push(Point3::new(x as f32, y as f32, 0.0));
            }
        }
        let seen = OrientedBox3::upright(Point3::new(0.02, 0.0, 0.2), Vector3::new(0.04, 0.5, 0.4), 0.0);
        let whole = completed(ObjectClass::Box, &seen, &[], &all, &level());
        assert!((whole.size.x - BOX_DEPTH_M).abs() < 1e-9 && (whole.center().x - 0.21).abs() < 1e-9, "{whole:?}");
        // With floor close behind it, it is thin.
        for j in -20..=20 {
            all.extend([0.1, 0.15, 0.2].map(|x| Point3::new(x, 0.05 * j as f32, 0.0)));
        }
        let thin = completed(ObjectClass::Box, &seen, &[], &all, &level());
        assert!(thin.size.x < 0.1, "{thin:?}");
    }
}
