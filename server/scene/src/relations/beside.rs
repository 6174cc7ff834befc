//! What stands next to what, and near: in one room, in sight of each other.

use super::{Placed, Relation, RelationFrame, RelationKind, RelationParams};
use crate::overlap;
use crate::rooms::{RoomId, Rooms};
use std::collections::{BTreeMap, BTreeSet};

/// Things by the room that they stand in, ascending by x: of what stands in one room, nothing else is near.
pub(crate) struct ByRoom<'a> {
    things: &'a [Placed],
    /// Places in `things`.
    groups: BTreeMap<Option<RoomId>, Vec<usize>>,
    /// Half of the largest footprint's diagonal, metres.
    largest_m: f64,
}

impl<'a> ByRoom<'a> {
    pub(crate) fn new(things: &'a [Placed]) -> Self {
        let mut groups = BTreeMap::<Option<RoomId>, Vec<usize>>::new();
        (0..things.len()).for_each(|i| groups.entry(things[i].room).or_default().push(i));
        let x = |i: &usize| things[*i].bbox.center().x;
        groups.values_mut().for_each(|group| group.sort_by(|a, b| x(a).total_cmp(&x(b)).then(a.cmp(b))));
        Self { things, groups, largest_m: things.iter().map(radius_m).fold(0.0, f64::max) }
    }

    /// Things that may be near one: in its room, or where no room is known; with the least that the gap between the two can be.
    fn around(&self, thing: &Placed, max_distance_m: f64) -> Vec<(f64, usize)> {
        let (center, radius) = (thing.bbox.center().xy(), radius_m(thing));
        let reach = max_distance_m + radius + self.largest_m;
        let mut out = vec![];
        let groups =
            self.groups.iter().filter(|(room, _)| thing.room.is_none() || room.is_none() || **room == thing.room);
        for (_, group) in groups {
            let x = |i: &usize| self.things[*i].bbox.center().x;
            let first = group.partition_point(|i| x(i) < center.x - reach);
            for &i in group[first..].iter().take_while(|i| x(i) <= center.x + reach) {
                let other = &self.things[i];
                let least = (other.bbox.center().xy() - center).norm() - radius - radius_m(other);
                if least <= max_distance_m && other.id != thing.id {
                    out.push((least, i));
                }
            }
        }
        out.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        out
    }

    /// The nearest things in sight, with the gap between, metres: at most [`RelationParams::num_near`], nearest first, then by number. Of
    /// those that `is_stacked` tells of, more is said.
    fn nearest(
        &self,
        thing: &Placed,
        is_stacked: impl Fn(usize) -> bool,
        rooms: &Rooms,
        params: &RelationParams,
    ) -> Vec<(f64, usize)> {
        let mut best: Vec<(f64, usize)> = vec![];
        for (least, i) in self.around(thing, params.max_distance_m) {
            let is_full = best.len() >= params.num_near;
            if best.last().map_or(is_full, |worst| is_full && least > worst.0) {
                break;
            }
            let other = &self.things[i];
            let gap = overlap::gap(&thing.bbox, &other.bbox);
            if gap > params.max_distance_m || is_stacked(i) || !rooms.is_open_between(&thing.bbox, &other.bbox) {
                continue;
            }
            let at = best.partition_point(|b| (b.0, self.things[b.1].id) < (gap, other.id));
            best.insert(at, (gap, i));
            best.truncate(params.num_near);
        }
        best
    }
}

/// Half of a footprint's diagonal, metres.
fn radius_m(thing: &Placed) -> f64 {
    0.5 * thing.bbox.size.xy().norm()
}

/// Relations of the things that are asked for with what stands beside them; `stacked` are pairs of places that share ground in another way,
/// the smaller first.
pub(crate) fn beside(
    things: &[Placed],
    is_asked: impl Fn(&Placed) -> bool,
    stacked: &BTreeSet<(usize, usize)>,
    rooms: &Rooms,
    params: &RelationParams,
) -> Vec<Relation> {
    let by_room = ByRoom::new(things);
    let mut listed = BTreeMap::<(usize, usize), f64>::new();
    for (a, thing) in things.iter().enumerate().filter(|(_, thing)| is_asked(thing)) {
        let is_stacked = |b: usize| stacked.contains(&(a.min(b), a.max(b)));
        let nearest = by_room.nearest(thing, is_stacked, rooms, params);
        listed.extend(nearest.into_iter().map(|(gap, b)| ((a.min(b), a.max(b)), gap)));
    }
    listed.into_iter().map(|((a, b), gap)| relation(&things[a], &things[b], gap, params)).collect()
}

/// Relations of the robot with what stands beside it.
pub(crate) fn beside_robot(robot: &Placed, things: &[Placed], rooms: &Rooms, params: &RelationParams) -> Vec<Relation> {
    let nearest = ByRoom::new(things).nearest(robot, |_| false, rooms, params);
    nearest.into_iter().map(|(gap, i)| relation(robot, &things[i], gap, params)).collect()
}

fn relation(a: &Placed, b: &Placed, distance_m: f64, params: &RelationParams) -> Relation {
    let kind = if distance_m <= params.next_to_m { RelationKind::NextTo } else { RelationKind::Near };
    let (subject, object) = (a.id.min(b.id), a.id.max(b.id));
    let strength = 1.0 - distance_m / params.max_distance_m;
    Relation { subject, kind, object, frame: RelationFrame::Any, strength, distance_m, stamp: None }
}
