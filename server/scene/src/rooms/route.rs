//! The way from room to room.

use super::{PlaceId, RoomId, Rooms};
use nalgebra::Point2;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// A room on the way, and how it is left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RouteStep {
    /// The room.
    pub room: RoomId,
    /// The door to the next one, by its place in [`Rooms::doors`]; none in the last.
    pub door: Option<usize>,
}

/// A way over places.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// Rooms in order, at least one.
    pub steps: Vec<RouteStep>,
    /// Places in order, at least one.
    pub places: Vec<PlaceId>,
    /// From place to place, metres.
    pub length_m: f64,
}

/// Lengths are compared in thousandths of a metre: whole numbers have one order.
const PER_M: f64 = 1000.0;

impl Rooms {
    /// The shortest way over places from the one nearest to a point (map frame, metres) to a room: to the place where it is
    /// widest that can be reached. None if no place of the room can be reached, or there are no places.
    pub fn route(&self, from: &Point2<f64>, to: RoomId) -> Option<Route> {
        let start = self.nearest_place(from)?;
        let known = self.ways_from(start);
        let inside = self.places.iter().filter(|p| p.room == to && known.contains_key(&p.id.0));
        // Not in its door, if there is anything else.
        let goal = inside.min_by(|a, b| {
            let in_door = |p: &super::Place| p.door.is_some();
            in_door(a).cmp(&in_door(b)).then(b.clearance_m.total_cmp(&a.clearance_m)).then(a.id.cmp(&b.id))
        })?;
        let mut places = vec![goal.id];
        let mut at = goal.id.0;
        while at != start.0 {
            at = known[&at].1;
            places.push(PlaceId(at));
        }
        places.reverse();
        let length_m = known[&goal.id.0].0 as f64 / PER_M;
        Some(Route { steps: self.steps(&places), places, length_m })
    }

    /// Lengths of the shortest ways over links from a place to all that can be reached from it, itself among them, metres.
    pub(crate) fn lengths_from(&self, start: PlaceId) -> BTreeMap<PlaceId, f64> {
        self.ways_from(start).into_iter().map(|(place, (length, _))| (PlaceId(place), length as f64 / PER_M)).collect()
    }

    /// The same in thousandths of a metre, each with the place before it on the way.
    fn ways_from(&self, start: PlaceId) -> BTreeMap<u32, (u64, u32)> {
        let mut beside = BTreeMap::<u32, Vec<(u32, u64)>>::new();
        for link in &self.links {
            let (a, b, length) = (link.places.0.0, link.places.1.0, (link.length_m * PER_M).round() as u64);
            beside.entry(a).or_default().push((b, length));
            beside.entry(b).or_default().push((a, length));
        }
        let mut known = BTreeMap::<u32, (u64, u32)>::from([(start.0, (0, start.0))]);
        let mut open = BinaryHeap::from([Reverse((0u64, start.0))]);
        while let Some(Reverse((length, at))) = open.pop() {
            if known[&at].0 < length {
                continue;
            }
            for (next, step) in beside.get(&at).into_iter().flatten() {
                let there = length + step;
                if known.get(next).is_none_or(|(best, _)| there < *best) {
                    known.insert(*next, (there, at));
                    open.push(Reverse((there, *next)));
                }
            }
        }
        known
    }

    /// The place nearest to a point, in the same room if it lies in one.
    fn nearest_place(&self, p: &Point2<f64>) -> Option<PlaceId> {
        let room = self.at(p).map(|r| r.id);
        let key = |place: &super::Place| (room.is_some_and(|r| r != place.room), (place.position - p).norm());
        let nearer = |a: &&super::Place, b: &&super::Place| {
            let (a, b) = (key(a), key(b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
        };
        self.places.iter().min_by(nearer).map(|p| p.id)
    }

    fn steps(&self, places: &[PlaceId]) -> Vec<RouteStep> {
        let on_way: Vec<&super::Place> = places.iter().filter_map(|p| self.places.get(p.0 as usize)).collect();
        let mut steps: Vec<RouteStep> = vec![];
        let mut passed: Option<usize> = None;
        for place in on_way {
            passed = place.door.or(passed);
            match steps.last_mut() {
                Some(last) if last.room == place.room => {}
                Some(last) => {
                    last.door = self.door_between((last.room, place.room), passed, &place.position);
                    steps.push(RouteStep { room: place.room, door: None });
                    passed = place.door;
                }
                None => steps.push(RouteStep { room: place.room, door: None }),
            }
        }
        steps
    }

    /// The door that was passed, if it joins these rooms, else the nearest that does.
    fn door_between(&self, rooms: (RoomId, RoomId), passed: Option<usize>, at: &Point2<f64>) -> Option<usize> {
        let pair = (rooms.0.min(rooms.1), rooms.0.max(rooms.1));
        let joins = |i: &usize| self.doors[*i].rooms == pair;
        let off = |i: usize| (self.doors[i].center - at).norm();
        let nearest = (0..self.doors.len()).filter(joins).min_by(|a, b| off(*a).total_cmp(&off(*b)));
        passed.filter(joins).or(nearest)
    }
}
