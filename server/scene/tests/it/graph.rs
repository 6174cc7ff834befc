//! Relations and the graph of them.

use nalgebra::{Point3, Vector3};
use percept_geometry::{ObjectClass, OrientedBox3, Pose, Timestamp, se3};
use percept_scene::rooms::Rooms;
use percept_scene::{
    Directions, NodeId, Object, ObjectId, ObjectState, Related, Relation, RelationFilter, RelationFrame, RelationKind,
    RelationParams, SceneError, SceneGraph, SceneView,
};
use proptest::prelude::*;
use std::collections::BTreeMap;

pub(crate) fn thing(id: u64, class: ObjectClass, center: [f64; 3], size: [f64; 3]) -> Object {
    Object {
        id: ObjectId(id),
        class,
        confidence: 0.9,
        class_probabilities: vec![],
        annotation: percept_scene::Annotation::default(),
        history: vec![],
        bbox: OrientedBox3::upright(Point3::from(center), Vector3::from(size), 0.0),
        state: ObjectState::Static,
        velocity_mps: Vector3::zeros(),
        velocity_variance: 0.0,
        first_seen: Timestamp(0),
        last_seen: Timestamp(1),
        observation_count: 2,
        num_points: 100,
    }
}

fn cube(id: u64, x: f64, y: f64) -> Object {
    thing(id, ObjectClass::Box, [x, y, 0.25], [0.5; 3])
}

fn graph(t_map_base: &Pose, objects: &[Object]) -> SceneGraph {
    in_rooms(t_map_base, objects, &Rooms::default())
}

fn in_rooms(t_map_base: &Pose, objects: &[Object], rooms: &Rooms) -> SceneGraph {
    let names = BTreeMap::new();
    let params = RelationParams::default();
    let related = &Related::of(objects, rooms, &params);
    let view = SceneView {
        stamp: Timestamp(7),
        map_version: 3,
        t_map_base,
        objects,
        rooms,
        related,
        names: &names,
        since: None,
    };
    SceneGraph::build(&view, &params, Some(Directions::Robot), &RelationFilter::default())
}

fn edge(graph: &SceneGraph, subject: u64, kind: RelationKind, object: u64) -> Option<Relation> {
    let (subject, object) = (NodeId::Object(ObjectId(subject)), NodeId::Object(ObjectId(object)));
    graph.edges.iter().find(|e| (e.subject, e.kind, e.object) == (subject, kind, object)).copied()
}

#[test]
fn left_and_right_turn_round_with_the_viewer() {
    // Two boxes ahead of the viewer at the origin; 0 is on the left (+y).
    let objects = [cube(0, 3.0, 1.0), cube(1, 3.0, -1.0)];
    let there = graph(&Pose::identity(), &objects);
    let left = edge(&there, 0, RelationKind::LeftOf, 1).unwrap();
    assert_eq!(left.frame, RelationFrame::Robot { stamp: Timestamp(7) });
    assert!((left.strength - (1.0 - 1.5 / 5.0)).abs() < 1e-12 && (left.distance_m - 1.5).abs() < 1e-12);
    assert!(edge(&there, 1, RelationKind::RightOf, 0).is_some());
    assert!(edge(&there, 0, RelationKind::RightOf, 1).is_none());
    assert!(edge(&there, 0, RelationKind::Behind, 1).is_none());
    // From the other side.
    let back = graph(&se3::from_xy_yaw(6.0, 0.0, std::f64::consts::PI), &objects);
    assert!(edge(&back, 0, RelationKind::RightOf, 1).is_some() && edge(&back, 0, RelationKind::LeftOf, 1).is_none());
}

#[test]
fn the_nearer_one_is_in_front_and_ahead_of_the_robot() {
    let objects = [cube(0, 2.0, 0.0), cube(1, 4.0, 0.0)];
    let g = graph(&Pose::identity(), &objects);
    assert!(edge(&g, 0, RelationKind::InFrontOf, 1).is_some() && edge(&g, 1, RelationKind::Behind, 0).is_some());
    let ahead = |e: &&Relation| e.object == NodeId::Robot && e.kind == RelationKind::InFrontOf;
    assert_eq!(g.edges.iter().filter(ahead).count(), 2);
    let turned = graph(&se3::from_xy_yaw(0.0, 0.0, std::f64::consts::PI), &objects);
    let behind = |e: &&Relation| e.object == NodeId::Robot && e.kind == RelationKind::Behind;
    assert_eq!(turned.edges.iter().filter(behind).count(), 2);
}

#[test]
fn gravity_decides_on_above_and_below() {
    let table = thing(0, ObjectClass::Table, [2.0, 0.0, 0.375], [1.6, 0.8, 0.75]);
    let cup = thing(1, ObjectClass::Box, [2.2, 0.1, 0.80], [0.1, 0.1, 0.1]);
    let lamp = thing(2, ObjectClass::Unknown, [2.0, 0.0, 2.0], [0.3, 0.3, 0.3]);
    // A robot that has tipped over sees the same.
    let tipped = Pose::rotation(Vector3::new(1.2, 0.0, 0.0));
    for pose in [Pose::identity(), tipped] {
        let g = graph(&pose, &[table.clone(), cup.clone(), lamp.clone()]);
        let on = edge(&g, 1, RelationKind::On, 0).unwrap();
        assert!((on.strength - 1.0).abs() < 1e-9 && on.frame == RelationFrame::Gravity);
        assert!(edge(&g, 2, RelationKind::Above, 0).is_some() && edge(&g, 0, RelationKind::Below, 2).is_some());
        assert!(edge(&g, 0, RelationKind::On, 1).is_none());
        assert!(edge(&g, 1, RelationKind::LeftOf, 0).is_none(), "what is on the table is not left of it");
    }
}

#[test]
fn a_box_in_a_shelf_is_inside_it() {
    let shelf = thing(0, ObjectClass::Shelf, [2.0, 0.0, 1.0], [1.0, 0.5, 2.0]);
    let held = thing(1, ObjectClass::Box, [2.0, 0.0, 1.0], [0.3; 3]);
    let g = graph(&Pose::identity(), &[shelf.clone(), held]);
    let inside = edge(&g, 1, RelationKind::Inside, 0).unwrap();
    assert!((inside.strength - 1.0).abs() < 1e-9);
    assert_eq!((inside.frame, inside.distance_m), (RelationFrame::Any, 0.0));
    assert!(edge(&g, 0, RelationKind::Inside, 1).is_none());
    let half_out = thing(1, ObjectClass::Box, [2.5, 0.0, 1.0], [0.3; 3]);
    assert!(edge(&graph(&Pose::identity(), &[shelf, half_out]), 1, RelationKind::Inside, 0).is_none());
}

#[test]
fn what_is_gone_or_too_far_is_not_related() {
    let mut gone = cube(1, 2.0, 1.0);
    gone.state = ObjectState::Gone;
    let g = graph(&Pose::identity(), &[cube(0, 2.0, 0.0), gone, cube(2, 20.0, 0.0)]);
    assert_eq!(
        g.nodes.iter().map(|n| n.id()).collect::<Vec<_>>(),
        [NodeId::Robot, NodeId::Object(ObjectId(0)), NodeId::Object(ObjectId(2))]
    );
    assert!(
        g.edges.iter().all(|e| e.subject != NodeId::Object(ObjectId(2)) && e.object != NodeId::Object(ObjectId(2)))
    );
    assert_eq!((g.stamp, g.map_version), (Timestamp(7), 3));
    let bad = RelationParams { max_distance_m: 0.0, ..RelationParams::default() };
    assert!(matches!(bad.validate(), Err(SceneError::InvalidParam { field: "max_distance_m", .. })));
    assert!(RelationParams::default().validate().is_ok());
}

#[test]
fn graphviz_text_lists_nodes_and_edges() {
    let dot = graph(&Pose::identity(), &[cube(0, 3.0, 1.0), cube(1, 3.0, -1.0)]).to_dot();
    assert!(dot.starts_with("digraph scene {\n") && dot.ends_with("}\n"));
    assert!(dot.contains("object_0 [shape=box, label=\"box 0\\n0.90\"];"));
    assert!(dot.contains("object_0 -> object_1 [label=\"left_of 0.70\", style=dashed];"));
    assert_eq!(dot.matches('{').count(), 1);
}

fn things() -> impl Strategy<Value = Vec<Object>> {
    let one = (prop::array::uniform3(-4.0..4.0f64), prop::array::uniform3(0.1..2.0f64), -3.0..3.0f64);
    prop::collection::vec(one, 0..8).prop_map(|list| {
        list.iter()
            .enumerate()
            .map(|(i, (center, size, yaw))| {
                let mut o = thing(i as u64, ObjectClass::Box, *center, *size);
                o.bbox = OrientedBox3::upright(Point3::from(*center), Vector3::from(*size), *yaw);
                o
            })
            .collect()
    })
}

proptest! {
    #[test]
    fn strength_falls_with_distance(near in 0.6..3.0f64, further in 0.01..3.0f64, angle in -3.0..3.0f64) {
        let at = |d: f64| graph(&Pose::identity(), &[cube(0, 0.0, 0.0), cube(1, d * angle.cos(), d * angle.sin())]);
        let (a, b) = (at(near + 0.3), at(near + 0.3 + further));
        for e in &b.edges {
            if e.subject == NodeId::Robot || e.object == NodeId::Robot {
                continue;
            }
            let is_beside = |kind| matches!(kind, RelationKind::NextTo | RelationKind::Near);
            let is_same = |f: &&Relation| f.kind == e.kind || is_beside(f.kind) && is_beside(e.kind);
            let before = a.edges.iter().filter(is_same).find(|f| (f.subject, f.object) == (e.subject, e.object));
            prop_assert!(before.is_some_and(|f| f.strength > e.strength));
        }
    }

    #[test]
    fn every_relation_has_its_converse_and_a_sound_strength(objects in things(), yaw in -3.0..3.0f64, by in 0usize..8) {
        let pose = se3::from_xy_yaw(0.5, -0.5, yaw);
        let g = graph(&pose, &objects);
        for e in &g.edges {
            prop_assert!(e.strength >= 0.1 && e.strength <= 1.0 && e.subject != e.object && e.distance_m >= 0.0);
            if e.object == NodeId::Robot || e.subject == NodeId::Robot {
                prop_assert!((e.subject == NodeId::Robot) == matches!(e.kind, RelationKind::Near | RelationKind::NextTo));
                continue;
            }
            let converse = match e.kind {
                RelationKind::On => RelationKind::Supports,
                RelationKind::Supports => RelationKind::On,
                RelationKind::LeftOf => RelationKind::RightOf,
                RelationKind::RightOf => RelationKind::LeftOf,
                RelationKind::Above => RelationKind::Below,
                RelationKind::Below => RelationKind::Above,
                RelationKind::InFrontOf => RelationKind::Behind,
                RelationKind::Behind => RelationKind::InFrontOf,
                _ => continue,
            };
            let other = g.edges.iter().find(|f| (f.subject, f.kind, f.object) == (e.object, converse, e.subject));
            prop_assert!(other.is_some_and(|f| (f.strength - e.strength).abs() < 1e-9));
        }
        let mut shuffled = objects.clone();
        shuffled.rotate_left(by.min(objects.len()));
        prop_assert_eq!(&graph(&pose, &shuffled), &g);
        // The whole scene moved with the viewer is the same scene.
        let t = se3::from_xy_yaw(3.0, -2.0, 1.1);
        let moved: Vec<Object> = objects.iter().map(|o| Object { bbox: o.bbox.transformed(&t), ..o.clone() }).collect();
        let h = graph(&(t * pose), &moved);
        for e in g.edges.iter().filter(|e| e.strength > 0.11) {
            let same = h.edges.iter().find(|f| (f.subject, f.kind, f.object) == (e.subject, e.kind, e.object));
            prop_assert!(same.is_some_and(|f| (f.strength - e.strength).abs() < 1e-6));
        }
    }
}
