//! Worlds: rooms, furniture and a person, generated from a seed, and everything that is true about them.

mod furniture;
pub(crate) mod layout;
mod occupancy;
mod person;

pub use layout::{Door, Room};
pub use occupancy::TrueOccupancy;

use crate::bvh::Bvh;
use crate::robot::route::{self, Route};
use crate::solid::{PlanarFrame, Solid};
use crate::{SimError, check};
use furniture::{KeepOut, Piece};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use percept_geometry::{Aabb3, ObjectClass, OrientedBox3};
use person::Person;
use serde::{Deserialize, Serialize};

/// What kind of world to generate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldParams {
    /// Seed of layout, furniture and person.
    pub seed: u64,
    /// Rooms, 1 to 256, in a grid that is as square as it can be; doors join all neighbours.
    pub rooms: usize,
    /// Smallest width and depth of a room, metres, 4.2 to 12.
    pub room_min_m: f64,
    /// Largest width and depth of a room, metres, up to 12.
    pub room_max_m: f64,
    /// Pieces of furniture wished for per square metre, 0 to 1; those that find no place are left out.
    pub furniture_per_m2: f64,
    /// Free space between the middle of the robot's lane and furniture, metres, 0.3 to 0.6.
    pub lane_clearance_m: f64,
    /// Whether a person walks in one of the rooms (which is then at least 5.6 m wide and deep).
    pub person: bool,
    /// One empty corridor of this length, metres, 12 to 500, and of the smallest width of a room, instead of rooms.
    pub corridor_m: Option<f64>,
}

impl Default for WorldParams {
    fn default() -> Self {
        Self {
            seed: 1,
            rooms: 4,
            room_min_m: 4.4,
            room_max_m: 6.0,
            furniture_per_m2: 0.35,
            lane_clearance_m: 0.5,
            person: true,
            corridor_m: None,
        }
    }
}

impl WorldParams {
    /// Checks bounds.
    ///
    /// # Errors
    /// `OutOfRange` naming the field.
    pub fn validate(&self) -> Result<(), SimError> {
        check("rooms", self.rooms as f64, 1.0, 256.0, "between 1 and 256")?;
        check("room_min_m", self.room_min_m, 4.2, 12.0, "between 4.2 and 12")?;
        check("room_max_m", self.room_max_m, self.room_min_m, 12.0, "between room_min_m and 12")?;
        check("furniture_per_m2", self.furniture_per_m2, 0.0, 1.0, "between 0 and 1")?;
        check("corridor_m", self.corridor_m.unwrap_or(12.0), 12.0, 500.0, "between 12 and 500")?;
        check("lane_clearance_m", self.lane_clearance_m, 0.3, 0.6, "between 0.3 and 0.6")
    }
}

/// An object as it truly is at a time, world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct TrueObject {
    /// Identity, the same at all times.
    pub id: u32,
    /// What it is.
    pub class: ObjectClass,
    /// Smallest upright box around it, along its own axes.
    pub bbox: OrientedBox3,
    /// Whether it moves.
    pub moving: bool,
}

/// What a ray met.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Metres from the ray's origin (times the direction's length).
    pub distance: f64,
    /// Outward unit normal, world frame.
    pub normal: Vector3<f64>,
    /// Shaded colour, 0..1.
    pub color: [f32; 3],
    /// Identity of the object; none for floor, ceiling and walls.
    pub object: Option<u32>,
}

/// A furnished place in which at most one person walks. Frame: z up, floor at z = 0, metres.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    rooms: Vec<Room>,
    doors: Vec<Door>,
    pieces: Vec<Piece>,
    person: Option<Person>,
    solids: Vec<Solid>,
    bvh: Bvh,
    route: Route,
}

impl World {
    /// Generates the world of these parameters.
    ///
    /// # Errors
    /// `OutOfRange` naming a parameter.
    pub fn generate(params: &WorldParams) -> Result<Self, SimError> {
        params.validate()?;
        let layout = layout::generate(params);
        // The lane comes first and furniture keeps clear of it, so that every world can be driven.
        let route = route::plan(&layout);
        let person = layout.person_room.map(|room| Person::in_room(params.seed, &layout.rooms[room]));
        let mut keep_out = vec![KeepOut { points: &route.points, clearance_m: params.lane_clearance_m }];
        if let Some(person) = &person {
            keep_out.push(KeepOut { points: &person.line, clearance_m: 0.6 });
        }
        let furnished = if params.corridor_m.is_some() { &[][..] } else { &layout.rooms[..] };
        let pieces: Vec<Piece> =
            furnished.iter().flat_map(|room| furniture::furnish(params, room, &keep_out)).collect();
        let mut solids = layout.solids;
        for (id, piece) in pieces.iter().enumerate() {
            solids.extend(piece.solids(id as u32));
        }
        let bvh = Bvh::build(&solids);
        Ok(Self { rooms: layout.rooms, doors: layout.doors, pieces, person, solids, bvh, route })
    }

    /// The rooms, by index.
    pub fn rooms(&self) -> &[Room] {
        &self.rooms
    }

    /// The doors.
    pub fn doors(&self) -> &[Door] {
        &self.doors
    }

    /// Corner with the largest coordinates of the outer walls, metres; the smallest is the origin.
    pub fn extent(&self) -> Vector2<f64> {
        let far = self.rooms.iter().fold(Point2::origin(), |far: Point2<f64>, room| far.sup(&room.max));
        far.coords + Vector2::repeat(layout::WALL_M)
    }

    /// Every object at `t_s` seconds after the start, furniture first.
    pub fn objects_at(&self, t_s: f64) -> Vec<TrueObject> {
        let boxed = |id: usize, class, frame: &PlanarFrame, bounds: &Aabb3, moving| TrueObject {
            id: id as u32,
            class,
            bbox: OrientedBox3::upright(frame.to_world(&bounds.center()), bounds.size(), frame.yaw()),
            moving,
        };
        let mut out: Vec<TrueObject> = self
            .pieces
            .iter()
            .enumerate()
            .map(|(id, piece)| boxed(id, piece.class, &piece.frame, &piece.bounds(), false))
            .collect();
        if let Some(person) = &self.person {
            let (frame, bounds) = person.bounds(t_s);
            out.push(boxed(self.pieces.len(), ObjectClass::Person, &frame, &bounds, true));
        }
        out
    }

    /// Which cells of edge `resolution_m` walls and furniture reach into between the heights `band_m`
    /// (usually 0.1 to 1.8). The person is not in it.
    ///
    /// # Errors
    /// `OutOfRange` if the resolution is not between 0.005 and 1 m.
    pub fn occupancy(&self, resolution_m: f64, band_m: (f64, f64)) -> Result<TrueOccupancy, SimError> {
        check("resolution_m", resolution_m, 0.005, 1.0, "between 0.005 and 1")?;
        Ok(TrueOccupancy::of(&self.solids, resolution_m, band_m, self.extent()))
    }

    /// Distance of a world point from the nearest surface that stands still, metres.
    pub fn surface_distance(&self, p: &Point3<f64>) -> f64 {
        self.bvh.surface_distance(&self.solids, p)
    }

    /// As [`Self::surface_distance`], the person at `t_s` included.
    pub fn surface_distance_at(&self, p: &Point3<f64>, t_s: f64) -> f64 {
        let view = self.view(t_s);
        view.moving.iter().map(|s| s.distance(p).abs()).fold(self.surface_distance(p), f64::min)
    }

    /// The first thing that a ray meets at `t_s` within `limit` lengths of `direction`.
    pub fn cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>, t_s: f64, limit: f64) -> Option<Hit> {
        let view = self.view(t_s);
        let (distance, solid) = view.cast(origin, direction, limit)?;
        let (normal, color) = solid.appearance(&(origin + direction * distance));
        Some(Hit { distance, normal, color, object: solid.object })
    }

    /// The lane that the robot follows.
    pub(crate) fn route(&self) -> &Route {
        &self.route
    }

    /// The world as it stands at a time.
    pub(crate) fn view(&self, t_s: f64) -> View<'_> {
        let id = self.pieces.len() as u32;
        View { world: self, moving: self.person.iter().flat_map(|p| p.solids(t_s, id)).collect() }
    }
}

/// A world at one time: what stands still, and the solids of what moves where they are then.
pub(crate) struct View<'a> {
    world: &'a World,
    moving: Vec<Solid>,
}

impl View<'_> {
    /// The nearest solid on a ray within `limit`, and at what multiple of `direction`.
    pub(crate) fn cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>, limit: f64) -> Option<(f64, &Solid)> {
        let mut best = self
            .world
            .bvh
            .cast(&self.world.solids, origin, direction, limit)
            .map(|(t, i)| (t, &self.world.solids[i as usize]));
        for solid in &self.moving {
            if let Some(t) = solid.intersect(origin, direction)
                && t < best.map_or(limit, |b| b.0)
            {
                best = Some((t, solid));
            }
        }
        best
    }

    /// All solids, the moving ones last.
    pub(crate) fn solids(&self) -> impl Iterator<Item = &Solid> {
        self.world.solids.iter().chain(&self.moving)
    }
}
