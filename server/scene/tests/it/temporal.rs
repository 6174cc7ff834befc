//! What happened to things between two times.

use crate::graph::thing;
use crate::rooms::{FLAT, drawn};
use percept_geometry::{ObjectClass, Pose, Timestamp};
use percept_scene::rooms::{RoomId, Rooms};
use percept_scene::{
    Node, NodeId, Object, ObjectId, ObjectState, PastState, Related, RelationFilter, RelationKind as K, RelationParams,
    SceneGraph, SceneView,
};
use std::collections::BTreeMap;

fn s(seconds: f64) -> Timestamp {
    Timestamp((seconds * 1e9) as i64)
}

/// A chair whose past is known: where it was from a stamp on, and what it did.
fn chair(id: u64, past: &[(f64, ObjectState, [f64; 2])]) -> Object {
    let at = |p: [f64; 2]| thing(id, ObjectClass::Chair, [p[0], p[1], 0.4], [0.5, 0.5, 0.8]).bbox;
    let state = |(stamp, state, p): &(f64, ObjectState, [f64; 2])| PastState {
        stamp: s(*stamp),
        class: ObjectClass::Chair,
        state: *state,
        bbox: at(*p),
    };
    let history: Vec<PastState> = past.iter().map(state).collect();
    let last = history[history.len() - 1];
    let (first_seen, last_seen) = (history[0].stamp, last.stamp);
    Object {
        bbox: last.bbox,
        state: last.state,
        history,
        first_seen,
        last_seen,
        ..thing(id, ObjectClass::Chair, [0.0; 3], [1.0; 3])
    }
}

fn graph(objects: &[Object], rooms: &Rooms, since: Option<f64>) -> SceneGraph {
    filtered(objects, rooms, since, &RelationFilter::default())
}

fn filtered(objects: &[Object], rooms: &Rooms, since: Option<f64>, filter: &RelationFilter) -> SceneGraph {
    let (names, t_map_base, params) = (BTreeMap::new(), Pose::identity(), RelationParams::default());
    let (stamp, since) = (s(100.0), since.map(s));
    let related = &Related::of(objects, rooms, &params);
    let view =
        SceneView { stamp, map_version: 1, t_map_base: &t_map_base, objects, rooms, related, names: &names, since };
    SceneGraph::build(&view, &params, None, filter)
}

fn happened(graph: &SceneGraph) -> Vec<(u64, K, NodeId, f64)> {
    let edges = graph.edges.iter().filter_map(|e| {
        let NodeId::Object(id) = e.subject else { return None };
        Some((id.0, e.kind, e.object, e.stamp?.nanos() as f64 / 1e9))
    });
    let mut out: Vec<_> = edges.collect();
    out.sort_by(|a, b| a.3.total_cmp(&b.3).then((a.0, a.1).cmp(&(b.0, b.1))));
    out
}

#[test]
fn what_came_went_and_moved_is_told_with_room_time_and_order() {
    use ObjectState::{Gone, Moving, Static};
    let rooms = drawn(&FLAT).divided(&[], &[(3, [2.0, 4.5]), (7, [6.0, 1.7]), (9, [7.0, 4.4])]);
    let (left, right) = (NodeId::Room(RoomId(3 * 1024)), NodeId::Room(RoomId(9 * 1024)));
    let (here, there) = ([2.0, 4.5], [7.0, 4.5]);
    let objects = [
        chair(0, &[(1.0, Static, here)]),
        chair(1, &[(1.0, Static, here), (50.0, Gone, here)]),
        chair(2, &[(60.0, Static, there)]),
        chair(3, &[(1.0, Static, here), (70.0, Moving, [4.7, 4.5]), (80.0, Static, there)]),
        // Came and went.
        chair(4, &[(81.5, Static, there), (90.0, Gone, there)]),
        // Seen better.
        chair(5, &[(1.0, Static, here), (40.0, Static, [2.2, 4.5])]),
        // Went before.
        chair(6, &[(1.0, Static, here), (5.0, Gone, here)]),
    ];
    let told = graph(&objects, &rooms, Some(30.0));
    let object = |id| NodeId::Object(ObjectId(id));
    assert_eq!(
        happened(&told),
        [
            (1, K::DisappearedFrom, left, 50.0),
            (1, K::Before, object(2), 50.0),
            (2, K::AppearedIn, right, 60.0),
            (2, K::Before, object(3), 60.0),
            (3, K::MovedFrom, left, 80.0),
            (3, K::MovedTo, right, 80.0),
            (3, K::Before, object(4), 80.0),
            (4, K::AppearedIn, right, 81.5),
            (4, K::DisappearedFrom, right, 90.0),
        ]
    );
    let moved = told.edges.iter().find(|e| e.kind == K::MovedTo).unwrap();
    assert!((moved.distance_m - 5.0).abs() < 1e-9);
    // Who is gone is a node because it is told of, and is in no room.
    let nodes: Vec<NodeId> = told.nodes.iter().map(Node::id).filter(|id| matches!(id, NodeId::Object(_))).collect();
    assert_eq!(nodes, [0, 1, 2, 3, 4, 5].map(object));
    assert!(!told.edges.iter().any(|e| e.subject == object(1) && e.kind == K::InRoom));
    let filter = RelationFilter { kinds: vec![K::DisappearedFrom], room: Some(RoomId(3 * 1024)), ..Default::default() };
    assert_eq!(happened(&filtered(&objects, &rooms, Some(30.0), &filter)), [(1, K::DisappearedFrom, left, 50.0)]);
    // From later on less has happened, and nothing is told of it unless it is asked for.
    assert_eq!(happened(&graph(&objects, &rooms, Some(85.0))), [(4, K::DisappearedFrom, right, 90.0)]);
    assert!(happened(&graph(&objects, &rooms, Some(95.0))).is_empty());
    assert!(happened(&graph(&objects, &rooms, None)).is_empty());
    assert_eq!(graph(&objects, &rooms, None).nodes.len(), 1 + 4 + 3);
}

#[test]
fn what_happens_at_once_is_told_so_and_without_rooms_of_the_thing_itself() {
    let objects =
        [chair(0, &[(10.0, ObjectState::Static, [1.0, 0.0])]), chair(1, &[(11.0, ObjectState::Static, [3.0, 0.0])])];
    let object = |id| NodeId::Object(ObjectId(id));
    let wanted =
        [(0, K::AppearedIn, object(0), 10.0), (0, K::Together, object(1), 10.0), (1, K::AppearedIn, object(1), 11.0)];
    assert_eq!(happened(&graph(&objects, &Rooms::default(), Some(0.0))), wanted);
}
