//! People and things among points that lie where the map says that nothing stands.

use crate::cloud::{ClusterParams, cluster, upright_box_trimmed};
use nalgebra::{Point3, Vector3};
use percept_geometry::{ObjectClass, OrientedBox3, se3};

/// Points of one thing lie so near to each other, metres; and so much farther apart for each metre from the sensor: rings of a lidar
/// with 16 of them over 30 degrees do.
const APART_M: f64 = 0.25;
const APART_SLOPE: f64 = 0.03;
/// Fewer points are what a pose that is off, or an edge, makes.
const MIN_POINTS: usize = 15;
/// What is lower may be the ground, metres above the floor.
const MIN_TOP_M: f64 = 0.5;
/// What is longer is no one thing that passes indoors, metres.
const MAX_LENGTH_M: f64 = 3.0;
/// Share of the points that may be strays on either side.
const TRIM: f64 = 0.02;
/// Adults are so high with their shoes on, metres: the 1st percentile of women less 0.1, the 99th of men and 0.05 (ANSUR II, 2012).
const PERSON_HEIGHT_M: [f64; 2] = [1.38, 2.0];
/// And so long at most, metres: a stride, arms that swing.
const PERSON_LENGTH_M: f64 = 1.0;
/// Shoulders are so wide, and a body so deep that a sensor sees from one side, metres (the same, means of bideltoid breadth and
/// chest depth with arms).
const PERSON_SIZE_M: [f64; 2] = [0.5, 0.35];
/// Of what has a person's size and moves indoors, so much is one: a guess on the safe side, carts and doors are rare.
const PERSON: f64 = 0.9;

/// A person who stands so near that a sensor sees them to the chest is so high, metres; robots, carts and chairs that are pushed may be,
/// too.
const PART_M: f64 = 0.9;
const PART: f64 = 0.6;

/// Something in free space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PassingThing {
    /// A person, by size; else unknown.
    pub class: ObjectClass,
    /// Probability of the class, 0..1.
    pub confidence: f64,
    /// Upright box down to the floor, frame of the points.
    pub bbox: OrientedBox3,
    /// Points in it.
    pub num_points: usize,
}

/// The things that points make which lie in free space, seen from `viewer`, on a floor at `floor_z`: upright boxes, grown to what the
/// viewer cannot see of a person. Those with the most points first. Frame: z up, metres.
pub fn find_passing(points: &[Point3<f32>], viewer: &Point3<f64>, floor_z: f64) -> Vec<PassingThing> {
    let from_viewer: Vec<Point3<f32>> = points.iter().map(|p| (p.cast::<f64>() - viewer.coords).cast()).collect();
    let params = ClusterParams { eps_m: APART_M, eps_slope: APART_SLOPE, min_points: MIN_POINTS };
    // The parameters are sound: nothing refuses them.
    let clusters = cluster(&from_viewer, &params).unwrap_or_default();
    let mut out: Vec<PassingThing> =
        clusters.indices().iter().filter_map(|indices| thing(points, indices, viewer, floor_z)).collect();
    out.sort_by_key(|thing| std::cmp::Reverse(thing.num_points));
    out
}

fn thing(points: &[Point3<f32>], indices: &[usize], viewer: &Point3<f64>, floor_z: f64) -> Option<PassingThing> {
    let of: Vec<Point3<f32>> = indices.iter().map(|i| points[*i]).collect();
    let tight = upright_box_trimmed(&of, TRIM)?;
    let top = tight.center().z + 0.5 * tight.size.z;
    let (height, length) = (top - floor_z, tight.size.x.max(tight.size.y));
    if height < MIN_TOP_M || length > MAX_LENGTH_M {
        return None;
    }
    let (class, confidence) = match height {
        _ if length > PERSON_LENGTH_M || height > PERSON_HEIGHT_M[1] => (ObjectClass::Unknown, 0.5),
        _ if height >= PERSON_HEIGHT_M[0] => (ObjectClass::Person, PERSON),
        _ if height >= PART_M => (ObjectClass::Person, PART),
        _ => (ObjectClass::Unknown, 0.5),
    };
    let least = if class == ObjectClass::Person { PERSON_SIZE_M } else { [0.0; 2] };
    let bbox = standing(&tight, least, viewer, floor_z, top);
    Some(PassingThing { class, confidence, bbox, num_points: of.len() })
}

/// The box down to the floor, its sides at least so long: the longer and the shorter one. It grows away from the viewer.
fn standing(tight: &OrientedBox3, least: [f64; 2], viewer: &Point3<f64>, floor_z: f64, top: f64) -> OrientedBox3 {
    let [longer, shorter] = if tight.size.x >= tight.size.y { [0, 1] } else { [1, 0] };
    let mut size = Vector3::new(tight.size.x, tight.size.y, top - floor_z);
    size[longer] = size[longer].max(least[0]);
    size[shorter] = size[shorter].max(least[1]);
    let away = tight.t_frame_box.rotation.inverse() * (tight.center() - viewer);
    let grown = Vector3::new(
        0.5 * (size.x - tight.size.x) * away.x.signum(),
        0.5 * (size.y - tight.size.y) * away.y.signum(),
        0.0,
    );
    let mut center = tight.center() + tight.t_frame_box.rotation * grown;
    center.z = 0.5 * (top + floor_z);
    OrientedBox3::upright(center, size, se3::yaw(&tight.t_frame_box))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The side of a box that a viewer at the origin sees: points 4 cm apart.
    fn front(center: [f64; 3], width: f64, height: f64) -> Vec<Point3<f32>> {
        let (nx, nz) = ((width / 0.04) as i32, (height / 0.04) as i32);
        let at = |i: i32, n: i32, size: f64| (f64::from(i) / f64::from(n) - 0.5) * size;
        let points = (0..=nx).flat_map(|i| (0..=nz).map(move |k| (i, k)));
        let point =
            |(i, k)| Point3::new(center[0], center[1] + at(i, nx, width), center[2] + at(k, nz, height)).cast::<f32>();
        points.map(point).collect()
    }

    #[test]
    fn a_person_is_found_at_full_depth_and_a_cart_beside_is_none() {
        // 1.7 m high and seen from 0.3 m up, since the band begins there.
        let mut points = front([3.0, 0.0, 1.0], 0.46, 1.4);
        points.extend(front([3.0, 1.5, 0.5], 0.8, 0.7));
        let found = find_passing(&points, &Point3::new(0.0, 0.0, 1.0), 0.0);
        let classes: Vec<ObjectClass> = found.iter().map(|f| f.class).collect();
        assert_eq!(classes, [ObjectClass::Person, ObjectClass::Unknown]);
        let person = found[0].bbox;
        assert!((person.center().z - 0.85).abs() < 0.03 && (person.size.z - 1.7).abs() < 0.05, "{person:?}");
        // It grows away from the viewer, who sees its front at x = 3.
        assert!((person.center().x - (3.0 + 0.5 * PERSON_SIZE_M[1])).abs() < 0.02, "{person:?}");
        assert!((found[1].bbox.size.z - 0.85).abs() < 0.05);
    }

    #[test]
    fn crumbs_low_things_and_walls_are_not_told() {
        let viewer = Point3::new(0.0, 0.0, 1.0);
        let cases =
            [front([3.0, 0.0, 0.2], 0.5, 0.2), front([3.0, 0.0, 1.0], 5.0, 1.5), front([3.0, 0.0, 1.0], 0.04, 0.2)];
        for points in cases {
            assert_eq!(find_passing(&points, &viewer, 0.0), []);
        }
        assert_eq!(find_passing(&[], &viewer, 0.0), []);
        assert_eq!(find_passing(&[Point3::new(f32::NAN, 0.0, 0.0); 100], &viewer, 0.0), []);
        assert_eq!(find_passing(&[Point3::new(1e30, 0.0, 0.0); 100], &viewer, 0.0), []);
    }
}
