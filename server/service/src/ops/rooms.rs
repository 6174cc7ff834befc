//! Rooms of a session, what people call them, and the way to one.

use super::navigation::{Plan, PlanRequest, plan};
use crate::session::annotations::RoomName;
use crate::{Error, Result, Service, reason};
use nalgebra::{Point2, Point3};
use percept_geometry::{KeyframeId, Pose, Timestamp};
use percept_mapping::MappingError;
use percept_pipeline::Snapshot;
use percept_planning::PlanError;
use percept_scene::rooms::{Door, Room, RoomId, Rooms, Route, RouteStep};
use percept_scene::{Directions, NodeId, RelationFilter, RoomNode, SceneGraph};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Characters of a room's name, at most.
const MAX_NAME_CHARS: usize = 64;
/// Rooms with names in a session, at most.
const MAX_NAMES: usize = 10_000;

/// A level divided into rooms, with what they are called.
#[derive(Debug, Clone)]
pub struct SessionRooms {
    /// Rooms, doors, places.
    pub rooms: Arc<Rooms>,
    /// Rooms as nodes of the scene graph: with their names and uses; as `rooms` has them.
    pub nodes: Vec<RoomNode>,
    /// Numbers of the objects in each, as `rooms` has them.
    pub objects: Vec<Vec<u64>>,
    /// Version of the map.
    pub map_version: u64,
}

/// Which room somebody means.
#[derive(Debug, Clone, PartialEq)]
pub enum RoomWanted {
    /// By number.
    Id(RoomId),
    /// By name, upper and lower case alike.
    Name(String),
}

/// A room on the way.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelledStep {
    /// The room.
    pub room: RoomId,
    /// What it is called, or may be.
    pub label: String,
    /// To the next room; none in the last one.
    pub door: Option<Door>,
}

/// The way to a room.
#[derive(Debug, Clone)]
pub struct RoomRoute {
    /// Rooms on the way, the start's first; none if no place in the room can be reached.
    pub steps: Vec<LabelledStep>,
    /// From place to place, metres.
    pub length_m: f64,
    /// Where to, map frame, metres.
    pub goal: Point2<f64>,
    /// The path, or why there is none.
    pub plan: Plan,
}

impl Service {
    /// The rooms of a session's map.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `GRID_TOO_LARGE`.
    pub async fn rooms(&self, session: &str) -> Result<SessionRooms> {
        let session_now = self.session(session).await?;
        let (snapshot, meta) = (session_now.snapshot(), session_now.meta());
        let max_cells = self.limits.max_planning_cells;
        self.compute.query(&self.asker(session)?, move || listed(&snapshot, &meta.room_names, max_cells)).await?
    }

    /// Calls a room by a name; an empty one takes its name from it. The room as it is then.
    ///
    /// # Errors
    /// As [`Service::rooms`]; `ROOM_NOT_FOUND`, `DISPLAY_NAME_INVALID`, `TOO_MANY_ROOM_NAMES`.
    pub async fn name_room(&self, session: &str, id: RoomId, name: &str) -> Result<SessionRooms> {
        if name.chars().count() > MAX_NAME_CHARS || name.chars().any(char::is_control) {
            let message = format!("the name has more than {MAX_NAME_CHARS} characters, or control characters");
            return Err(Error::invalid(reason::DISPLAY_NAME_INVALID, "name", message));
        }
        let found = self.rooms(session).await?;
        let room = found.rooms.get(id).ok_or_else(|| unknown(id.0))?;
        let pin = pinned(&*self.snapshot(session).await?, room, name);
        let rooms = Arc::clone(&found.rooms);
        let session_now = self
            .registry
            .change(session, move |session, meta| {
                let snapshot = session.snapshot();
                let is_of_room =
                    |n: &RoomName| place_of(&snapshot, n).and_then(|p| rooms.at(&p)).is_some_and(|r| r.id == id);
                meta.room_names.retain(|n| !is_of_room(n));
                if let Some(pin) = pin.clone().filter(|pin| !pin.name.is_empty()) {
                    if meta.room_names.len() >= MAX_NAMES {
                        let message = format!("{MAX_NAMES} rooms have names, the limit; take some away");
                        return Err(Error::exhausted(reason::TOO_MANY_ROOM_NAMES, "name", message));
                    }
                    meta.room_names.push(pin);
                }
                Ok(None)
            })
            .await?;
        let (snapshot, meta, max_cells) = (session_now.snapshot(), session_now.meta(), self.limits.max_planning_cells);
        self.compute.query(&self.asker(session)?, move || listed(&snapshot, &meta.room_names, max_cells)).await?
    }

    /// The way to a room: from door to door, and the path along the ground. From a point of the map, or from where the robot is.
    ///
    /// # Errors
    /// As [`Service::rooms`] and [`Service::plan_path`]; `ROOM_NOT_FOUND`; `ROOM_NAME_AMBIGUOUS` if several rooms have it.
    pub async fn route_to_room(&self, session: &str, to: RoomWanted, start: Option<Point2<f64>>) -> Result<RoomRoute> {
        let session_now = self.session(session).await?;
        let (snapshot, meta) = (session_now.snapshot(), session_now.meta());
        let zones = super::zones::zones_of(&meta);
        let max_cells = self.limits.max_planning_cells;
        let work = move || {
            let found = listed(&snapshot, &meta.room_names, max_cells)?;
            let room = found.wanted(&to)?;
            let from = start.or_else(|| robot_at(&snapshot));
            let route = from.and_then(|from| found.rooms.route(&from, room.id));
            let last = route.as_ref().and_then(|r| r.places.last()).map(|p| found.rooms.places[p.0 as usize].position);
            let goal = last.unwrap_or(room.center);
            let options = super::navigation::PathOptions::default().in_zones(&zones);
            let plan = plan(&snapshot, &PlanRequest { start, goal, params: None, options }, max_cells)?;
            let steps = route.as_ref().map(|route| found.labelled(route)).unwrap_or_default();
            Ok(RoomRoute { steps, length_m: route.map_or(0.0, |r| r.length_m), goal, plan })
        };
        self.compute.query(&self.asker(session)?, work).await?
    }

    /// Robot, objects, rooms and their relations, as far as they are asked for; as they were at a time, in the rooms as they are now;
    /// with what happened since a time.
    ///
    /// # Errors
    /// As [`Service::rooms`]; `STAMP_BEFORE_TRAJECTORY`, `STAMP_AFTER_TRAJECTORY`; `OUT_OF_RANGE` for what is since after it is.
    pub async fn scene_graph(
        &self,
        session: &str,
        whose: Option<Directions>,
        filter: RelationFilter,
        (since, at): (Option<Timestamp>, Option<Timestamp>),
    ) -> Result<SceneGraph> {
        if let Some((since, at)) = since.zip(at).filter(|(since, at)| since > at) {
            let message = format!("since_ns is {}, after at_ns, {}; what happened lies between the two", since.0, at.0);
            return Err(Error::invalid(reason::OUT_OF_RANGE, "since_ns", message));
        }
        let session_now = self.session(session).await?;
        let (snapshot, meta) = (session_now.snapshot(), session_now.meta());
        let max_cells = self.limits.max_planning_cells;
        let work = move || {
            let then = |at| Ok::<_, Error>((at, super::transforms::pose_at(&snapshot, at)?.t_map_base));
            let at = at.map(then).transpose()?;
            let rooms = snapshot.rooms(max_cells).map_err(refused)?;
            let names = names(&snapshot, &meta.room_names, &rooms);
            snapshot.scene_graph(&names, whose, at, since, &filter, max_cells).map_err(refused)
        };
        self.compute.query(&self.asker(session)?, work).await?
    }
}

impl SessionRooms {
    fn labelled(&self, route: &Route) -> Vec<LabelledStep> {
        let label = |id: RoomId| self.nodes.iter().find(|n| n.room.id == id).map(RoomNode::label).unwrap_or_default();
        let step = |step: &RouteStep| LabelledStep {
            room: step.room,
            label: label(step.room),
            door: step.door.map(|i| self.rooms.doors[i]),
        };
        route.steps.iter().map(step).collect()
    }

    fn wanted(&self, wanted: &RoomWanted) -> Result<&Room> {
        let name = match wanted {
            RoomWanted::Id(id) => return self.rooms.get(*id).ok_or_else(|| unknown(id.0)),
            RoomWanted::Name(name) => name.to_lowercase(),
        };
        let mut called = self.nodes.iter().filter(|n| n.name.as_ref().is_some_and(|n| n.to_lowercase() == name));
        match (called.next(), called.next()) {
            (Some(one), None) => Ok(self.rooms.get(one.room.id).unwrap_or(&self.rooms.rooms[0])),
            (None, _) => {
                let message = format!("no room is called {name:?}; list the rooms");
                Err(Error::not_found(reason::ROOM_NOT_FOUND, "room_name", message))
            }
            (Some(_), Some(_)) => {
                let message = format!("several rooms are called {name:?}; give the room's number");
                Err(Error::invalid(reason::ROOM_NAME_AMBIGUOUS, "room_name", message))
            }
        }
    }
}

pub(super) fn unknown(id: u64) -> Error {
    let message = format!("room_id {id} does not exist in this session; list the rooms");
    Error::not_found(reason::ROOM_NOT_FOUND, "room_id", message)
}

pub(super) fn refused(e: MappingError) -> Error {
    match e {
        MappingError::RegionTooLarge { cells, limit } => {
            super::navigation::plan_error(PlanError::GridTooLarge { cells, limit })
        }
        other => Error::internal(other),
    }
}

pub(super) fn listed(snapshot: &Snapshot, called: &[RoomName], max_cells: usize) -> Result<SessionRooms> {
    let rooms = snapshot.rooms(max_cells).map_err(refused)?;
    let (names, all) = (names(snapshot, called, &rooms), RelationFilter::default());
    let graph = snapshot.scene_graph(&names, None, None, None, &all, max_cells).map_err(refused)?;
    let mut inside = BTreeMap::<RoomId, Vec<u64>>::new();
    for edge in &graph.edges {
        if let (NodeId::Object(object), NodeId::Room(room)) = (edge.subject, edge.object) {
            inside.entry(room).or_default().push(object.0);
        }
    }
    let node = |node| match node {
        percept_scene::Node::Room(room) => Some(room),
        _ => None,
    };
    let nodes: Vec<RoomNode> = graph.nodes.into_iter().filter_map(node).collect();
    let objects = nodes.iter().map(|n| inside.remove(&n.room.id).unwrap_or_default()).collect();
    Ok(SessionRooms { rooms, nodes, objects, map_version: snapshot.map_version })
}

/// What people call the rooms.
fn names(snapshot: &Snapshot, names: &[RoomName], rooms: &Rooms) -> BTreeMap<RoomId, String> {
    let named = |n: &RoomName| Some((rooms.at(&place_of(snapshot, n)?)?.id, n.name.clone()));
    names.iter().filter_map(named).collect()
}

/// Where a name is pinned, now.
fn place_of(snapshot: &Snapshot, name: &RoomName) -> Option<Point2<f64>> {
    let keyframe = snapshot.keyframes.get(usize::try_from(name.keyframe).ok()?)?;
    Some((keyframe.t_map_base * Point3::new(name.at[0], name.at[1], 0.0)).xy())
}

/// A name, pinned to where a room is widest, as the keyframe nearest to there sees it.
fn pinned(snapshot: &Snapshot, room: &Room, name: &str) -> Option<RoomName> {
    let off = |t: &Pose| (Point2::from(t.translation.vector.xy()) - room.center).norm();
    let nearest = snapshot.keyframes.iter().min_by(|a, b| off(&a.t_map_base).total_cmp(&off(&b.t_map_base)))?;
    let KeyframeId(keyframe) = nearest.id;
    let z = nearest.t_map_base.translation.vector.z;
    let at = nearest.t_map_base.inverse() * Point3::new(room.center.x, room.center.y, z);
    Some(RoomName { name: name.to_owned(), keyframe, at: [at.x, at.y] })
}

fn robot_at(snapshot: &Snapshot) -> Option<Point2<f64>> {
    super::navigation::known_pose(snapshot).map(|(p, _)| p)
}
