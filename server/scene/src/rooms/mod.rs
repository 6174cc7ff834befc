//! Rooms, the doors between them, and places to be: the free space of a level, cut where it is narrow.
//!
//! [`find_rooms`] takes a grid and gives [`Rooms`]. What stands free in a room is taken for floor ([`clutter`]); what is left is cut
//! where two wide parts meet between jambs ([`watershed`]); cuts become [`Door`]s ([`doors`]), parts [`Room`]s ([`outline`], [`kind`]).
//! [`places`] lays a graph of places over what a robot can drive on, along which [`Rooms::route`] leads from room to room.
//!
//! Source: rooms as basins of the distance transform that meet in narrow passages: Thrun, "Learning metric-topological maps for indoor
//! mobile robot navigation", 1998 (critical points of the Voronoi graph); compared with others by Bormann et al., "Room
//! segmentation: survey, implementation, and analysis", 2016. Places as in Hughes et al., "Hydra", 2022.

mod cleared;
mod clutter;
mod doors;
mod floor;
mod kind;
mod outline;
mod places;
mod route;
mod watershed;

pub use floor::Floor;
pub use kind::RoomKind;
pub use places::{Place, PlaceId, PlaceLink};
pub use route::{Route, RouteStep};

use crate::{SceneError, within};
use floor::Labels;
use nalgebra::Point2;
use percept_geometry::{OrientedBox3, clearance_in_cells};
use serde::{Deserialize, Serialize};

/// What makes a room. Lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RoomParams {
    /// A passage this wide or narrower may be a doorway, 0.3 to 10. Wider ones are openings inside a room.
    pub door_max_m: f64,
    /// On both sides of a doorway there is room for a circle so many times as wide, 1 to 10.
    pub door_ratio: f64,
    /// Least free floor of a room, square metres, 0.1 to 1000.
    pub area_min_m2: f64,
    /// What stands free and is no longer than this is furniture, 0 to 10, not a wall.
    pub furniture_max_m: f64,
    /// Places are about so far from each other, 0.3 to 20.
    pub place_spacing_m: f64,
    /// A place, and the way to the next one, keep so far from obstacles, 0 to 5: half a robot's width.
    pub place_clearance_m: f64,
}

impl Default for RoomParams {
    /// Door leaves are 0.7 to 1.0 m wide, two of them up to 1.6 m (DIN 18101 and EN 12519 have no wider ones indoors).
    fn default() -> Self {
        Self {
            door_max_m: 1.6,
            door_ratio: 1.25,
            area_min_m2: 2.0,
            furniture_max_m: 1.0,
            place_spacing_m: 1.5,
            place_clearance_m: 0.2,
        }
    }
}

impl RoomParams {
    /// Checks the bounds.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and what it has to be.
    pub fn validate(&self) -> Result<(), SceneError> {
        within("door_max_m", self.door_max_m, 0.3, 10.0, "from 0.3 to 10")?;
        within("door_ratio", self.door_ratio, 1.0, 10.0, "from 1 to 10")?;
        within("area_min_m2", self.area_min_m2, 0.1, 1000.0, "from 0.1 to 1000")?;
        within("furniture_max_m", self.furniture_max_m, 0.0, 10.0, "from 0 to 10")?;
        within("place_spacing_m", self.place_spacing_m, 0.3, 20.0, "from 0.3 to 20")?;
        within("place_clearance_m", self.place_clearance_m, 0.0, 5.0, "from 0 to 5")
    }
}

/// Identity of a room: that of the first keyframe taken in it, times [`RoomId::PER_KEYFRAME`]. So it stays while the map grows and is
/// corrected. A room that was only looked into has the number of the nearest keyframe, and one of the numbers after it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RoomId(pub u64);

impl RoomId {
    /// Numbers that a keyframe gives to rooms: its own, and those seen from it.
    pub const PER_KEYFRAME: u64 = 1024;

    /// Whether the robot was in it.
    pub fn was_entered(self) -> bool {
        self.0.is_multiple_of(Self::PER_KEYFRAME)
    }
}

impl std::fmt::Display for RoomId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// A room or a corridor.
#[derive(Debug, Clone, PartialEq)]
pub struct Room {
    /// Identity.
    pub id: RoomId,
    /// By its shape.
    pub kind: RoomKind,
    /// Where it is widest, map frame, metres.
    pub center: Point2<f64>,
    /// Radius of the largest circle that fits, metres.
    pub radius_m: f64,
    /// Floor, furniture's included, square metres.
    pub area_m2: f64,
    /// Its outer border, counter-clockwise, map frame, metres; at least 3 corners, the first one not repeated.
    pub outline: Vec<Point2<f64>>,
}

/// A doorway.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Door {
    /// The rooms that it joins, the smaller id first.
    pub rooms: (RoomId, RoomId),
    /// In its middle, map frame, metres.
    pub center: Point2<f64>,
    /// Between its jambs, metres.
    pub width_m: f64,
    /// From one jamb to the other, radians from the map's x axis, in -pi/2 to pi/2: one passes across.
    pub angle_rad: f64,
}

/// A level divided into rooms.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rooms {
    /// Ascending by id.
    pub rooms: Vec<Room>,
    /// Ascending by their rooms, then by place.
    pub doors: Vec<Door>,
    /// Places to be, by number.
    pub places: Vec<Place>,
    /// Ways between neighbouring places, ascending.
    pub links: Vec<PlaceLink>,
    labels: Labels,
}

impl Rooms {
    /// The room at a point of the map; none on walls, outside, and where nothing is known.
    pub fn at(&self, p: &Point2<f64>) -> Option<&Room> {
        self.labels.at(p).and_then(|i| self.rooms.get(i))
    }

    /// The room that a thing stands in: that of most of the floor it covers and of a hand around it.
    pub fn of(&self, thing: &OrientedBox3) -> Option<&Room> {
        self.labels.most_of(thing).and_then(|i| self.rooms.get(i))
    }

    /// Whether no wall stands between two things: the line between their middles runs over the floor of rooms, but where it is in one of
    /// them. True where nothing is known of rooms.
    pub fn is_open_between(&self, a: &OrientedBox3, b: &OrientedBox3) -> bool {
        self.rooms.is_empty() || self.labels.is_open_between(a, b)
    }

    /// A room by id.
    pub fn get(&self, id: RoomId) -> Option<&Room> {
        self.rooms.binary_search_by_key(&id, |r| r.id).ok().map(|i| &self.rooms[i])
    }

    /// Cells of each room, by its place in `rooms`, as row-major numbers of the floor's cells.
    pub fn cells_of(&self, index: usize) -> impl Iterator<Item = usize> {
        self.labels.cells_of(index)
    }
}

/// Divides a level into rooms. `things` stand in them: their sides are no jambs. `keyframes` are numbers and positions, ascending by
/// number: they give rooms their identity.
///
/// Takes time in the number of cells times its logarithm: 1 s for three million.
///
/// # Errors
/// `InvalidParam` from the parameters, and for a floor whose shape is not that of its cells.
pub fn find_rooms(
    floor: &Floor<'_>,
    things: &[OrientedBox3],
    keyframes: &[(u64, Point2<f64>)],
    params: &RoomParams,
) -> Result<Rooms, SceneError> {
    params.validate()?;
    floor.validate()?;
    let cleared = clutter::cleared(floor, things, params);
    let clearance = clearance_in_cells(&cleared.closed(), floor.width, floor.height);
    let mut basins = watershed::divide(floor, &cleared, &clearance, params);
    basins.drop_small((params.area_min_m2 / floor.resolution_m().powi(2)) as usize, &clearance);
    let (labels, peaks) = basins.finished(floor, &cleared);
    let centers: Vec<Point2<f64>> = peaks.iter().map(|i| floor.center(*i)).collect();
    let ids = identities(&labels, &centers, keyframes);
    let enclosed = labels.enclosed(&cleared, ids.len());
    let mut order: Vec<usize> = (0..ids.len()).filter(|i| ids[*i].was_entered() || enclosed[*i] >= ENCLOSED).collect();
    order.sort_by_key(|i| ids[*i]);
    let mut numbers = vec![None; ids.len()];
    order.iter().enumerate().for_each(|(new, old)| numbers[*old] = Some(new));
    let labels = labels.renumbered(&numbers);
    let (counts, extents) = (labels.counts(order.len()), labels.extents(order.len()));
    let mut marked = vec![false; floor.cells.len()];
    let room = |(new, old): (usize, &usize)| {
        let (area_m2, radius_m) = (
            counts[new] as f64 * floor.resolution_m().powi(2),
            f64::from(clearance[peaks[*old]]) * floor.resolution_m(),
        );
        let kind = RoomKind::of_shape(area_m2, labels.radius_within(new, extents[new]) * floor.resolution_m());
        let (id, center) = (ids[*old], centers[*old]);
        Room { id, kind, center, radius_m, area_m2, outline: outline::outer(&labels, new, peaks[*old], &mut marked) }
    };
    let rooms: Vec<Room> = order.iter().enumerate().map(room).collect();
    let doors = doors::between(floor, &cleared, &clearance, &labels, &rooms);
    let (places, links) = places::lay(floor, &labels, &rooms, &doors, params);
    Ok(Rooms { rooms, doors, places, links, labels })
}

/// Of a room that was only looked into, at least so much of the border is wall: what was seen through a window is no room.
const ENCLOSED: f64 = 0.5;
/// A keyframe this near to another room may fall to either, metres.
const ON_THE_SILL_M: f64 = 0.5;

/// Ids of rooms, by number.
fn identities(labels: &Labels, centers: &[Point2<f64>], keyframes: &[(u64, Point2<f64>)]) -> Vec<RoomId> {
    let resolution = labels.geometry.map_or(1.0, |g| g.resolution_m);
    let steps = labels.steps_from_others();
    // In it for sure, or at its door.
    let (mut surely, mut perhaps) = (vec![None; centers.len()], vec![None; centers.len()]);
    for (number, p) in keyframes {
        let Some((cell, room)) = labels.index(p).and_then(|i| Some((i, labels.get(i)?))) else { continue };
        perhaps[room] = perhaps[room].or(Some(*number));
        if f64::from(steps[cell]) * resolution >= ON_THE_SILL_M {
            surely[room] = surely[room].or(Some(*number));
        }
    }
    let mut seen_from = std::collections::BTreeMap::<u64, u64>::new();
    let id = |(room, center): (usize, &Point2<f64>)| {
        if let Some(number) = surely[room].or(perhaps[room]) {
            return RoomId(number * RoomId::PER_KEYFRAME);
        }
        let off = |k: &(u64, Point2<f64>)| (k.1 - center).norm();
        let from = keyframes.iter().min_by(|a, b| off(a).total_cmp(&off(b))).map_or(0, |k| k.0);
        let more = seen_from.entry(from).or_default();
        *more += 1;
        RoomId(from * RoomId::PER_KEYFRAME + *more)
    };
    centers.iter().enumerate().map(id).collect()
}
