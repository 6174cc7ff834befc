//! Clusters that may be objects, mended where one object came apart.

use super::sides::Sides;
use super::{DetectionParams, Structure};
use crate::cloud::{DbscanParams, dbscan, upright_box_along, upright_box_trimmed};
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::shapes::convex_intersection_area;
use percept_geometry::{GeometryError, OrientedBox3};

/// A part whose footprint lies by this share within another's belongs to it.
const SHARED: f64 = 0.5;
/// Parts of one object are at most this far apart in height, metres: a seat and its back, a top and its legs.
const MAX_GAP_M: f64 = 0.5;

/// So much larger than the least rectangle around a thing one along its sides may be.
const MOST_LARGER: f64 = 1.25;
/// A leg as it is seen, metres: four to ten centimetres as they are made, and a voxel or two of noise.
const LEG_M: f64 = 0.2;
/// Tables have so many at most; these stand at the edge of the top, or so far in, metres.
const TABLE_LEGS: usize = 4;
const LEG_INSIDE_M: f64 = 0.25;
/// What lies lower than this share of the height is leg.
const LEG_SHARE: f64 = 0.75;
/// Tables are so high, metres: three deviations of [`super::GaussianClassifier`]'s model.
const TABLE_HEIGHTS_M: (f64, f64) = (0.59, 0.89);
/// Pieces of one top end at one height, metres: a voxel.
const SAME_TOP_M: f64 = 0.06;
/// What is seen of a table is so long at least, metres: less is a chair.
const LEAST_TABLE_M: f64 = 0.6;
/// And so long and wide at most, metres.
const MOST_TABLE_M: (f64, f64) = (2.1, 1.2);

/// A back this near to a wall was taken for the wall, metres.
const MAX_LEAN_M: f64 = 0.09;
/// Parallel within 12 degrees.
const PARALLEL_COS: f64 = 0.978;

/// A cluster and its box, which stands on the floor if the object does and lies along its sides if it has some.
#[derive(Debug, Clone)]
pub(super) struct Proposal {
    pub(super) points: Vec<Point3<f32>>,
    pub(super) bbox: OrientedBox3,
    pub(super) sides: Sides,
}

/// A cluster, or a part of one.
#[derive(Debug, Clone)]
struct Part {
    points: Vec<Point3<f32>>,
    bbox: OrientedBox3,
}

/// Objects among thinned points: without floor, walls and what is above, joined by nearness, parts that
/// stand over each other put together.
pub(super) fn propose(
    points: &[Point3<f32>],
    structure: &Structure,
    params: &DetectionParams,
) -> Result<Vec<Proposal>, GeometryError> {
    let free: Vec<Point3<f32>> = points
        .iter()
        .filter(|p| {
            let p = p.cast();
            let height = structure.height(&p);
            height > params.floor_margin_m
                && height <= params.max_height_m
                && !structure.in_wall(&p, params.wall_distance_m)
        })
        .copied()
        .collect();
    // By density, so that a spray of noise between two objects does not join them; small parts may still belong
    // to something and are judged after mending.
    let clusters = dbscan(&free, &DbscanParams { eps_m: params.cluster_eps_m, min_points: params.min_density })?;
    let mut parts: Vec<Part> = clusters
        .indices()
        .iter()
        .filter_map(|members| boxed(members.iter().map(|&i| free[i]).collect(), params.box_trim))
        .collect();
    mend(&mut parts, params);
    gather_legs(&mut parts, structure, params);
    parts.retain(|part| is_object(part, structure, params));
    let proposal = |Part { points, bbox }| {
        let sides = Sides::of(&points);
        let along = sides.yaw().and_then(|yaw| upright_box_along(&points, yaw, params.box_trim));
        // Two faces fill either rectangle alike; where this one is much larger, thin legs have told the direction.
        let area = |b: &OrientedBox3| b.size.x * b.size.y;
        let along = along.filter(|along| area(along) <= MOST_LARGER * area(&bbox));
        let mut proposal = Proposal { bbox: along.unwrap_or(bbox), points, sides };
        stand(&mut proposal, structure);
        lean(&mut proposal, structure);
        proposal
    };
    Ok(parts.into_iter().map(proposal).collect())
}

fn boxed(points: Vec<Point3<f32>>, trim: f64) -> Option<Part> {
    let bbox = upright_box_trimmed(&points, trim)?;
    Some(Part { points, bbox })
}

/// Puts parts over each other together, the larger ones first, until nothing changes.
fn mend(parts: &mut Vec<Part>, params: &DetectionParams) {
    parts.sort_by_key(|p| std::cmp::Reverse(p.points.len()));
    let mut i = 0;
    while i < parts.len() {
        match (i + 1..parts.len()).find(|&j| belong_together(&parts[i].bbox, &parts[j].bbox, params)) {
            Some(j) => {
                let part = parts.remove(j);
                parts[i].points.extend(part.points);
                if let Some(bbox) = upright_box_trimmed(&parts[i].points, params.box_trim) {
                    parts[i].bbox = bbox;
                }
            }
            None => i += 1,
        }
    }
}

/// A piece of what stands on legs, and where these stand.
struct OnLegs {
    part: Part,
    legs: Vec<Point2<f64>>,
}

/// Puts the pieces of tables together: who looks from below a top sees legs, with pieces of the edge above them, and little between.
/// Together they have four legs at most, at the edges of the whole: tables beside each other have more.
fn gather_legs(parts: &mut Vec<Part>, structure: &Structure, params: &DetectionParams) {
    let mut pieces: Vec<OnLegs> = vec![];
    let mut others: Vec<Part> = vec![];
    for part in parts.drain(..) {
        match legs_of(&part, structure, params) {
            Some(legs) => pieces.push(OnLegs { part, legs }),
            None => others.push(part),
        }
    }
    // The two that grow least by each other first.
    while let Some((i, j, both)) = (0..pieces.len())
        .flat_map(|i| (i + 1..pieces.len()).map(move |j| (i, j)))
        .filter_map(|(i, j)| Some((i, j, one_of(&pieces[i], &pieces[j], params)?)))
        .min_by(|a, b| growth(&pieces, a).total_cmp(&growth(&pieces, b)))
    {
        pieces.remove(j);
        pieces[i] = both;
    }
    // Under some tables more stands than legs.
    for piece in pieces {
        let is_leg = piece.legs.len() == 1 && long(&piece.part) <= LEAST_TABLE_M;
        let grown = |other: &Part| {
            let both = joined(other, &piece.part, params).filter(|_| is_leg && long(other) >= LEAST_TABLE_M)?;
            Some((area(&both) - area(other), both))
        };
        let wholes = others.iter().enumerate().filter_map(|(i, other)| Some((i, grown(other)?)));
        match wholes.min_by(|a, b| a.1.0.total_cmp(&b.1.0)).map(|(i, (_, both))| (i, both)) {
            Some((i, both)) => others[i] = both,
            None => others.push(piece.part),
        }
    }
    others.sort_by_key(|p| std::cmp::Reverse(p.points.len()));
    *parts = others;
}

/// Two pieces as one table, if they may be.
fn one_of(a: &OnLegs, b: &OnLegs, params: &DetectionParams) -> Option<OnLegs> {
    let part = joined(&a.part, &b.part, params).filter(|both| long(both) >= LEAST_TABLE_M)?;
    let mut legs = a.legs.clone();
    for leg in &b.legs {
        if legs.iter().all(|other| (other - leg).norm() > LEG_M) {
            legs.push(*leg);
        }
    }
    let inside = |leg: &Point2<f64>| {
        let in_box = part.bbox.t_frame_box.inverse() * Point3::new(leg.x, leg.y, part.bbox.center().z);
        (0.5 * part.bbox.size.x - in_box.x.abs()).min(0.5 * part.bbox.size.y - in_box.y.abs())
    };
    let is_table = legs.len() <= TABLE_LEGS && legs.iter().all(|leg| inside(leg) <= LEG_INSIDE_M);
    is_table.then_some(OnLegs { part, legs })
}

/// By how much the larger of two pieces grows, square metres.
fn growth(pieces: &[OnLegs], (i, j, both): &(usize, usize, OnLegs)) -> f64 {
    area(&both.part) - area(&pieces[*i].part).max(area(&pieces[*j].part))
}

/// Two parts as one, if their tops are at one height and the whole is no larger than tables are.
fn joined(a: &Part, b: &Part, params: &DetectionParams) -> Option<Part> {
    let top = |p: &Part| p.bbox.center().z + 0.5 * p.bbox.size.z;
    let is_one = (top(a) - top(b)).abs() <= SAME_TOP_M;
    let points = || a.points.iter().chain(&b.points).copied().collect();
    let both = is_one.then(|| boxed(points(), params.box_trim)).flatten();
    both.filter(|both| long(both) <= MOST_TABLE_M.0 && short(both) <= MOST_TABLE_M.1)
}

fn area(part: &Part) -> f64 {
    part.bbox.size.x * part.bbox.size.y
}

fn long(part: &Part) -> f64 {
    part.bbox.size.x.max(part.bbox.size.y)
}

fn short(part: &Part) -> f64 {
    part.bbox.size.x.min(part.bbox.size.y)
}

/// The legs of a part as high as tables are, if it has nothing else below its top.
fn legs_of(part: &Part, structure: &Structure, params: &DetectionParams) -> Option<Vec<Point2<f64>>> {
    let height = structure.height(&part.bbox.center()) + 0.5 * part.bbox.size.z;
    let is_table = (TABLE_HEIGHTS_M.0..=TABLE_HEIGHTS_M.1).contains(&height)
        && long(part) <= MOST_TABLE_M.0
        && short(part) <= MOST_TABLE_M.1;
    if !is_table {
        return None;
    }
    let low: Vec<Point3<f32>> =
        part.points.iter().filter(|p| structure.height(&p.cast()) < LEG_SHARE * height).copied().collect();
    let clusters = dbscan(&low, &DbscanParams { eps_m: params.cluster_eps_m, min_points: 1 }).ok()?;
    let leg = |members: &Vec<usize>| {
        let leg = upright_box_trimmed(&members.iter().map(|i| low[*i]).collect::<Vec<_>>(), 0.0)?;
        (leg.size.x.max(leg.size.y) <= LEG_M).then(|| leg.center().xy())
    };
    let legs: Option<Vec<Point2<f64>>> = clusters.indices().iter().map(leg).collect();
    legs.filter(|legs| (1..=TABLE_LEGS).contains(&legs.len()))
}

fn belong_together(a: &OrientedBox3, b: &OrientedBox3, params: &DetectionParams) -> bool {
    let grown = |b: &OrientedBox3| {
        let mut b = *b;
        b.size.x += params.voxel_size_m;
        b.size.y += params.voxel_size_m;
        b
    };
    let (a, b) = (grown(a), grown(b));
    let area = |b: &OrientedBox3| b.size.x * b.size.y;
    let shared = convex_intersection_area(&a.footprint(), &b.footprint());
    let gap = (a.center().z - b.center().z).abs() - 0.5 * (a.size.z + b.size.z);
    shared >= SHARED * area(&a).min(area(&b)) && gap <= MAX_GAP_M && a.size.x.max(b.size.x) <= params.max_size_m
}

fn is_object(part: &Part, structure: &Structure, params: &DetectionParams) -> bool {
    let (long, short) = (part.bbox.size.x.max(part.bbox.size.y), part.bbox.size.x.min(part.bbox.size.y));
    let center = part.bbox.center();
    let top = structure.height(&center) + 0.5 * part.bbox.size.z;
    let sides = 2.0 * (long + short) * part.bbox.size.z / params.voxel_size_m.powi(2);
    if part.points.len() < params.min_points
        || (part.points.len() as f64) < params.min_coverage * sides
        || long < params.min_size_m
        || long > params.max_size_m
        || top < params.min_height_m
    {
        return false;
    }
    // A thin sheet along a wall is what the wall's plane did not take, a high one by itself a piece of wall.
    let v = params.voxel_size_m;
    let beside_wall = short <= 3.0 * v && structure.wall_distance(&center) <= 3.0 * v;
    let piece_of_wall = short <= 1.5 * v && part.bbox.size.z > 1.2 || short <= v && long > 10.0 * v;
    !beside_wall && !piece_of_wall
}

/// Lets the box reach down to the floor: what is seen of an object ends where something hides it, or at the
/// floor's margin. Only what hangs on a wall hangs.
fn stand(part: &mut Proposal, structure: &Structure) {
    let center = part.bbox.center();
    let bottom = structure.height(&center) - 0.5 * part.bbox.size.z;
    let at_wall = structure.wall_distance(&center) < 0.5 * part.bbox.size.x.min(part.bbox.size.y) + 0.15;
    if bottom <= 0.0 || (at_wall && bottom > 0.6) {
        return;
    }
    let yaw = part.bbox.t_frame_box.rotation.euler_angles().2;
    let mut size = part.bbox.size;
    size.z += bottom;
    part.bbox = OrientedBox3::upright(Point3::new(center.x, center.y, center.z - 0.5 * bottom), size, yaw);
}

/// Lets a box whose back is parallel and close to a wall reach the wall: the back itself went with the wall.
fn lean(part: &mut Proposal, structure: &Structure) {
    let b = &part.bbox;
    let center = b.center();
    for axis in 0..2 {
        let across = (b.t_frame_box.rotation * Vector3::ith(axis, 1.0)).xy();
        for wall in
            structure.walls.iter().filter(|w| w.is_beside(&center) && w.normal.dot(&across).abs() > PARALLEL_COS)
        {
            let distance = wall.distance(&center);
            let gap = distance.abs() - 0.5 * b.size[axis];
            if gap > 0.0 && gap <= MAX_LEAN_M {
                let towards = wall.normal * -distance.signum();
                let shift = towards * (0.5 * gap);
                let mut bbox = *b;
                bbox.size[axis] += gap;
                bbox.t_frame_box.translation.vector += Vector3::new(shift.x, shift.y, 0.0);
                part.bbox = bbox;
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::structure::find_structure;
    use super::*;

    /// A floor, and tables of 1.2 x 0.6 m as they are seen from below their tops: legs and the edge, but for so much of its middle.
    fn tables(at: &[(f32, f32)], gap: f32) -> Vec<Point3<f32>> {
        let steps = |from: f32, to: f32| {
            let n = ((to - from) / 0.04).round() as i32;
            (0..=n).map(move |i| from + (to - from) * i as f32 / n as f32)
        };
        let mut points: Vec<Point3<f32>> =
            steps(-4.0, 4.0).flat_map(|x| steps(-4.0, 4.0).map(move |y| Point3::new(x, y, 0.0))).collect();
        for (x, y) in at {
            for (dx, dy) in [(-0.55, -0.25), (-0.55, 0.25), (0.55, -0.25), (0.55, 0.25)] {
                points.extend(steps(0.04, 0.72).map(|z| Point3::new(x + dx, y + dy, z)));
                points.extend(steps(0.04, 0.72).map(|z| Point3::new(x + dx + 0.04, y + dy, z)));
            }
            for edge in [(-0.6, -0.5 * gap), (0.5 * gap, 0.6)] {
                for dx in steps(edge.0, edge.1) {
                    points
                        .extend([-0.3, 0.3].iter().flat_map(|dy| [0.68, 0.72].map(|z| Point3::new(x + dx, y + dy, z))));
                }
            }
            for dx in [-0.6, 0.6] {
                points.extend(steps(-0.3, 0.3).flat_map(|dy| [0.68, 0.72].map(|z| Point3::new(x + dx, y + dy, z))));
            }
        }
        points
    }

    fn found(points: &[Point3<f32>]) -> Vec<OrientedBox3> {
        let params = DetectionParams::default();
        let structure = find_structure(points, &params).unwrap();
        propose(points, &structure, &params).unwrap().into_iter().map(|p| p.bbox).collect()
    }

    #[test]
    fn halves_of_a_table_are_one_and_tables_beside_each_other_are_two() {
        let one = found(&tables(&[(0.0, 0.0)], 0.5));
        assert_eq!(one.len(), 1, "{one:?}");
        assert!((one[0].size.x.max(one[0].size.y) - 1.2).abs() < 0.1, "{:?}", one[0].size);
        let two = found(&tables(&[(0.0, 0.0), (0.0, 0.9)], 0.0));
        assert_eq!(two.len(), 2, "{two:?}");
        assert!(two.iter().all(|b| (b.size.x.max(b.size.y) - 1.2).abs() < 0.1), "{two:?}");
    }
}
