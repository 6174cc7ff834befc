//! Doorways: where two rooms touch, between jambs.

use super::cleared::{Cleared, Kind};
use super::floor::Labels;
use super::{Door, Floor, Room};
use nalgebra::{Point2, Vector2};
use std::collections::BTreeMap;

/// Jambs are as far from the middle of a door as whatever is nearest, or so much farther, metres: what is not known, behind a jamb,
/// begins before it.
const SLACK_M: f64 = 0.25;
/// What is narrower is no door but a gap in what is known of a wall, metres: a person is 0.5 m wide.
const NARROWEST_M: f64 = 0.5;
/// A door's middle is where its clearance is at least this share of the largest.
const MIDDLE: f32 = 0.8;
/// Cosine of the least angle between the directions to both jambs: 120 degrees. Walls that meet in a corner are 90 apart.
const OPPOSITE: f64 = -0.5;

/// The two cells of walls that a passage runs between, the nearest that lie opposite of each other. None if it has a wall on one side only,
/// or none.
pub(super) fn jambs(floor: &Floor<'_>, cleared: &Cleared, clearance: &[f32], at: usize) -> Option<[usize; 2]> {
    let reach = f64::from(clearance[at]) + 1.0 + SLACK_M / floor.resolution_m();
    let cells = reach.ceil() as isize;
    let (x, y) = ((at % floor.width) as isize, (at / floor.width) as isize);
    let mut beside: Vec<(f64, Vector2<f64>, usize)> = vec![];
    for (dx, dy) in (-cells..=cells).flat_map(|dy| (-cells..=cells).map(move |dx| (dx, dy))) {
        let (x, y) = (x + dx, y + dy);
        if x < 0 || y < 0 || x >= floor.width as isize || y >= floor.height as isize {
            continue;
        }
        let i = y as usize * floor.width + x as usize;
        let off = Vector2::new(dx as f64, dy as f64);
        if cleared.kinds[i] == Kind::Wall && off.norm() <= reach {
            beside.push((off.norm(), off.normalize(), i));
        }
    }
    // The nearest, and the nearest of those across from it; the same of both if several are as near.
    beside.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
    let pairs = beside.iter().flat_map(|a| {
        let across = beside.iter().filter(move |b| a.1.dot(&b.1) <= OPPOSITE);
        across.map(move |b| (a.0 + b.0 + a.1.dot(&b.1), [a.2, b.2]))
    });
    pairs.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))).map(|(_, ends)| ends)
}

/// All doors of rooms that are numbered as `labels` has them.
pub(super) fn between(
    floor: &Floor<'_>,
    cleared: &Cleared,
    clearance: &[f32],
    labels: &Labels,
    rooms: &[Room],
) -> Vec<Door> {
    let around = floor.around();
    let mut borders = BTreeMap::<(usize, usize), Vec<usize>>::new();
    for i in 0..labels.cells.len() {
        let Some(own) = labels.get(i).filter(|_| cleared.is_open(i)) else { continue };
        let others = around.eight(i).filter(|j| cleared.is_open(*j)).filter_map(|j| labels.get(j));
        let mut others: Vec<usize> = others.filter(|other| *other != own).collect();
        others.sort_unstable();
        others.dedup();
        others.into_iter().for_each(|other| borders.entry((own.min(other), own.max(other))).or_default().push(i));
    }
    let mut doors = vec![];
    for ((a, b), cells) in borders {
        let mut is_border = vec![false; labels.cells.len()];
        cells.iter().for_each(|i| is_border[*i] = true);
        for part in parts(floor, &is_border, &cells) {
            let widest = part.iter().copied().max_by(|a, b| clearance[*a].total_cmp(&clearance[*b]).then(b.cmp(a)));
            let Some(at) = widest else { continue };
            // Where the border lies askew, the jambs of its middle may do, too: the nearest to each other of those around there.
            let off = |[a, b]: &[usize; 2]| (floor.center(*a) - floor.center(*b)).norm();
            let middle = part.iter().filter(|i| clearance[**i] >= MIDDLE * clearance[at]);
            let ends = middle.filter_map(|i| jambs(floor, cleared, clearance, *i));
            let ends = ends.min_by(|p, q| off(p).total_cmp(&off(q)).then(p.cmp(q)));
            let rooms = (rooms[a].id.min(rooms[b].id), rooms[a].id.max(rooms[b].id));
            let door = door(floor, ends, (at, clearance[at]), rooms);
            if door.width_m >= NARROWEST_M {
                doors.push(door);
            }
        }
    }
    let place = |d: &Door| (d.center.x, d.center.y);
    doors.sort_by(|a, b| {
        let (p, q) = (place(a), place(b));
        a.rooms.cmp(&b.rooms).then(p.0.total_cmp(&q.0)).then(p.1.total_cmp(&q.1))
    });
    doors
}

/// Cells of a border that hang together.
fn parts(floor: &Floor<'_>, is_border: &[bool], cells: &[usize]) -> Vec<Vec<usize>> {
    let around = floor.around();
    let (mut seen, mut parts) = (std::collections::BTreeSet::new(), vec![]);
    for start in cells {
        if !seen.insert(*start) {
            continue;
        }
        let (mut part, mut at) = (vec![*start], 0);
        while let Some(i) = part.get(at).copied() {
            at += 1;
            part.extend(around.eight(i).filter(|j| is_border[*j] && seen.insert(*j)));
        }
        parts.push(part);
    }
    parts
}

fn door(
    floor: &Floor<'_>,
    jambs: Option<[usize; 2]>,
    (at, clearance): (usize, f32),
    rooms: (super::RoomId, super::RoomId),
) -> Door {
    let half = 0.5 * floor.resolution_m();
    let Some([a, b]) = jambs.map(|ends| ends.map(|i| floor.center(i))) else {
        let width_m = 2.0 * f64::from(clearance) * floor.resolution_m();
        return Door { rooms, center: floor.center(at), width_m, angle_rad: 0.0 };
    };
    let across = b - a;
    let angle = across.y.atan2(across.x);
    let angle_rad = match angle {
        a if a > std::f64::consts::FRAC_PI_2 => a - std::f64::consts::PI,
        a if a <= -std::f64::consts::FRAC_PI_2 => a + std::f64::consts::PI,
        a => a,
    };
    // Jambs begin at the edges of their cells.
    let width_m = (across.norm() - 2.0 * half).max(0.0);
    Door { rooms, center: Point2::from((a.coords + b.coords) * 0.5), width_m, angle_rad }
}
