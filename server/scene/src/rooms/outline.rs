//! The outer border of a room as a polygon.

use super::floor::Labels;
use nalgebra::{Point2, Vector2};

/// Corners that lie this near to the line between their neighbours are left out, in cells: steps of a slanted wall.
const FLAT_CELLS: f64 = 0.75;

/// Counter-clockwise, map frame, metres; `inside` is one of the room's cells. `marked` has a place for each cell, and is shared by all rooms.
pub(super) fn outer(labels: &Labels, room: usize, inside: usize, marked: &mut [bool]) -> Vec<Point2<f64>> {
    let Some(geometry) = labels.geometry else { return vec![] };
    let lowest = mark_part(labels, room, inside, marked);
    let is_room = |x: i64, y: i64| {
        let is_inside = x >= 0 && y >= 0 && x < labels.width as i64 && y < labels.height as i64;
        let cell = || y as usize * labels.width + x as usize;
        is_inside && marked[cell()] && labels.get(cell()) == Some(room)
    };
    // The lower edge of the lowest cell lies on the outer border.
    let start = ((lowest % labels.width) as i64, (lowest / labels.width) as i64);
    // Along edges of cells, the room to the left: corners are points between cells.
    let (mut at, mut heading) = (start, (1i64, 0i64));
    let mut corners = vec![];
    let most = 4 * labels.cells.len() + 8;
    for _ in 0..most {
        corners.push(at);
        at = (at.0 + heading.0, at.1 + heading.1);
        // The two cells ahead of the corner: left and right of the way on.
        let ahead = |side: i64| {
            // Cells around a corner (x, y): (x-1, y-1), (x, y-1), (x-1, y), (x, y).
            let left = (-heading.1, heading.0);
            let (dx, dy) = (heading.0 + side * left.0, heading.1 + side * left.1);
            is_room(at.0 + (dx - 1) / 2, at.1 + (dy - 1) / 2)
        };
        heading = match (ahead(1), ahead(-1)) {
            // Parts that touch in a corner alone are kept apart: turn left.
            (false, _) => (-heading.1, heading.0),
            (true, false) => heading,
            (true, true) => (heading.1, -heading.0),
        };
        if at == start && heading == (1, 0) {
            break;
        }
    }
    let points: Vec<Vector2<f64>> = corners.into_iter().map(|(x, y)| Vector2::new(x as f64, y as f64)).collect();
    simplified(&points).into_iter().map(|p| geometry.origin + p * geometry.resolution_m).collect()
}

/// Marks the cells of a room that hang together with one of them by edges; the first of them.
fn mark_part(labels: &Labels, room: usize, inside: usize, marked: &mut [bool]) -> usize {
    let around = labels.around();
    let (mut lowest, mut edge) = (inside, vec![inside]);
    marked[inside] = true;
    while let Some(i) = edge.pop() {
        lowest = lowest.min(i);
        let is_new = |j: &usize| labels.get(*j) == Some(room) && !std::mem::replace(&mut marked[*j], true);
        edge.extend(around.four(i).filter(is_new));
    }
    lowest
}

/// A closed line with fewer corners: Douglas and Peucker, 1973, of its two halves.
fn simplified(points: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let Some(first) = points.first() else { return vec![] };
    let far = (0..points.len()).max_by(|a, b| {
        let off = |i: usize| (points[i] - first).norm_squared();
        off(*a).total_cmp(&off(*b)).then(b.cmp(a))
    });
    let far = far.unwrap_or(0);
    let mut closed = points.to_vec();
    closed.push(*first);
    let mut keep = vec![false; closed.len()];
    (keep[0], keep[far]) = (true, true);
    let mut spans = vec![(0, far), (far, closed.len() - 1)];
    while let Some((a, b)) = spans.pop() {
        let off = |i: &usize| {
            let (from, along) = (closed[*i] - closed[a], closed[b] - closed[a]);
            let length = along.norm();
            if length > 0.0 { (along.x * from.y - along.y * from.x).abs() / length } else { from.norm() }
        };
        if let Some(most) = (a + 1..b).max_by(|i, j| off(i).total_cmp(&off(j)).then(j.cmp(i)))
            && off(&most) > FLAT_CELLS
        {
            keep[most] = true;
            spans.extend([(a, most), (most, b)]);
        }
    }
    (0..points.len()).filter(|i| keep[*i]).map(|i| points[i]).collect()
}
