//! The lane: a closed line that leads through every door it needs and once around every room.

use crate::world::layout::{Layout, RING_INSET_M, Room};
use nalgebra::{Point2, Vector2};
use std::collections::VecDeque;

/// Distance between points of a line before smoothing, metres.
pub(crate) const STEP_M: f64 = 0.01;
/// Corners are rounded by a kernel of about this standard deviation, metres.
const ROUNDING_M: f64 = 0.35;

/// The robot's lane.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Route {
    /// A closed line in the world; the last point is followed by the first.
    pub(crate) points: Vec<Point2<f64>>,
    /// Points at which the robot may stop and look around, one a room, ascending.
    pub(crate) stops: Vec<usize>,
}

/// Plans the lane: rooms in serpentine order, by the fewest doors, then back to the first.
pub(crate) fn plan(layout: &Layout) -> Route {
    let walk = closed_walk(layout);
    let rings: Vec<Ring> = layout.rooms.iter().map(Ring::of).collect();
    let mut corners = Vec::new();
    let mut looks = Vec::new();
    let mut visited = vec![false; rings.len()];
    let start = 0.5 * rings[0].size.x;
    let (mut enter, mut first_sign) = (start, 1.0);
    for (i, &room) in walk.iter().enumerate() {
        let ring = &rings[room];
        corners.push(ring.point(enter));
        let next = walk.get(i + 1).copied();
        let door = next.and_then(|next| door_between(layout, room, next));
        let leave = door.map_or(start, |door| ring.project(&door));
        let ahead = (leave - enter).rem_euclid(ring.length());
        let mut sign = if ahead <= 0.5 * ring.length() { 1.0 } else { -1.0 };
        if next.is_none() && i > 0 {
            // The lap closes in the direction in which it began.
            sign = first_sign;
        }
        let mut length = if sign > 0.0 { ahead } else { ring.length() - ahead };
        if !visited[room] {
            looks.push(ring.point(enter + sign * 0.25 * ring.length()));
            length += ring.length();
        }
        visited[room] = true;
        if i == 0 {
            first_sign = sign;
        }
        ring.arc(enter, sign * length, &mut corners);
        if let (Some(door), Some(next)) = (door, next) {
            corners.push(door);
            enter = rings[next].project(&door);
        }
    }
    let points = smooth_closed(&corners, ROUNDING_M);
    let stops = nearest_in_order(&points, &looks);
    Route { points, stops }
}

/// For each target the index of the nearest point, first passage preferred, indices ascending.
fn nearest_in_order(points: &[Point2<f64>], targets: &[Point2<f64>]) -> Vec<usize> {
    let mut from = 0;
    let mut out = Vec::new();
    for target in targets {
        let mut best = (f64::INFINITY, from);
        for (i, p) in points.iter().enumerate().skip(from) {
            let d = (p - target).norm();
            if d < best.0 - 1e-6 {
                best = (d, i);
            } else if best.0 < 0.35 && d > best.0 + 0.5 {
                // Left the neighbourhood again: later passages are farther along.
                break;
            }
        }
        out.push(best.1);
        from = best.1 + 1;
    }
    out
}

/// Rooms in the order in which they are driven through, from room 0 to room 0.
fn closed_walk(layout: &Layout) -> Vec<usize> {
    let (n, columns) = (layout.rooms.len(), layout.columns);
    let mut order: Vec<usize> = (0..n).collect();
    for (row, chunk) in order.chunks_mut(columns).enumerate() {
        if row % 2 == 1 {
            chunk.reverse();
        }
    }
    let mut walk = vec![0];
    for &goal in order.iter().skip(1).chain([&0]) {
        let from = walk[walk.len() - 1];
        walk.extend(fewest_doors(layout, from, goal));
    }
    walk
}

/// Rooms after `from` up to `goal`, breadth first.
fn fewest_doors(layout: &Layout, from: usize, goal: usize) -> Vec<usize> {
    let mut came_from = vec![None; layout.rooms.len()];
    let mut queue = VecDeque::from([goal]);
    let mut seen = vec![false; layout.rooms.len()];
    seen[goal] = true;
    while let Some(room) = queue.pop_front() {
        for door in &layout.doors {
            let (a, b) = door.rooms;
            let other = if a == room {
                b
            } else if b == room {
                a
            } else {
                continue;
            };
            if !seen[other] {
                seen[other] = true;
                came_from[other] = Some(room);
                queue.push_back(other);
            }
        }
    }
    std::iter::successors(came_from[from], |&room| came_from[room]).collect()
}

fn door_between(layout: &Layout, a: usize, b: usize) -> Option<Point2<f64>> {
    layout.doors.iter().find(|d| d.rooms == (a.min(b), a.max(b))).map(|d| d.center)
}

/// The rectangle around a room that the robot drives along; positions on it are metres
/// counter-clockwise from its corner with the smallest coordinates.
struct Ring {
    min: Point2<f64>,
    size: Vector2<f64>,
}

impl Ring {
    fn of(room: &Room) -> Self {
        let inset = Vector2::repeat(RING_INSET_M);
        Self { min: room.min + inset, size: room.max - room.min - inset * 2.0 }
    }

    fn length(&self) -> f64 {
        2.0 * (self.size.x + self.size.y)
    }

    /// Where along the ring its four corners are.
    fn corners(&self) -> [f64; 4] {
        let (w, d) = (self.size.x, self.size.y);
        [0.0, w, w + d, 2.0 * w + d]
    }

    fn point(&self, s: f64) -> Point2<f64> {
        let [_, b, c, d] = self.corners();
        let s = s.rem_euclid(self.length());
        let offset = if s < b {
            Vector2::new(s, 0.0)
        } else if s < c {
            Vector2::new(self.size.x, s - b)
        } else if s < d {
            Vector2::new(self.size.x - (s - c), self.size.y)
        } else {
            Vector2::new(0.0, self.size.y - (s - d))
        };
        self.min + offset
    }

    /// The point of the ring straight ahead of a door.
    fn project(&self, door: &Point2<f64>) -> f64 {
        let q = door - self.min;
        let [_, b, c, d] = self.corners();
        if q.y < 0.0 {
            q.x
        } else if q.x > self.size.x {
            b + q.y
        } else if q.y > self.size.y {
            c + self.size.x - q.x
        } else {
            d + self.size.y - q.y
        }
    }

    /// Appends the corners passed and the end of a drive of `length` (negative: clockwise) from `s`.
    fn arc(&self, s: f64, length: f64, out: &mut Vec<Point2<f64>>) {
        let mut passed: Vec<f64> = (-3..=3)
            .flat_map(|lap| self.corners().map(|c| (c + f64::from(lap) * self.length() - s) * length.signum()))
            .filter(|&d| d > 1e-9 && d < length.abs() - 1e-9)
            .collect();
        passed.sort_by(f64::total_cmp);
        out.extend(passed.iter().map(|d| self.point(s + d * length.signum())));
        out.push(self.point(s + length));
    }
}

/// Points about `STEP_M` apart along the closed polygon, its corners rounded by three running means,
/// which together are nearly a Gaussian of standard deviation `sigma_m` with bounded reach.
pub(crate) fn smooth_closed(corners: &[Point2<f64>], sigma_m: f64) -> Vec<Point2<f64>> {
    let mut points = resample_closed(corners);
    let half = ((sigma_m / STEP_M).round() as usize).min(points.len() / 2 - 1);
    for _ in 0..3 {
        points = running_mean(&points, half);
    }
    points
}

fn resample_closed(corners: &[Point2<f64>]) -> Vec<Point2<f64>> {
    let edges: Vec<(Point2<f64>, Point2<f64>)> =
        (0..corners.len()).map(|i| (corners[i], corners[(i + 1) % corners.len()])).collect();
    let total: f64 = edges.iter().map(|(a, b)| (b - a).norm()).sum();
    let count = (total / STEP_M).round().max(8.0) as usize;
    let step = total / count as f64;
    let mut out = Vec::with_capacity(count);
    let mut passed = 0.0;
    for (a, b) in edges {
        let length = (b - a).norm();
        while out.len() < count && (out.len() as f64) * step < passed + length {
            let along = (out.len() as f64) * step - passed;
            out.push(a + (b - a) * (along / length));
        }
        passed += length;
    }
    out
}

/// The mean over `2 half + 1` neighbours on a closed line.
fn running_mean(points: &[Point2<f64>], half: usize) -> Vec<Point2<f64>> {
    let n = points.len();
    let at = |i: usize| points[i % n].coords;
    let mut sum: Vector2<f64> = (0..=2 * half).map(|k| at(n - half + k)).sum();
    (0..n)
        .map(|i| {
            let mean = Point2::from(sum / (2 * half + 1) as f64);
            sum += at(i + half + 1) - at(i + n - half);
            mean
        })
        .collect()
}
