//! Floors drawn by hand, divided.

use crate::graph::thing;
use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{GridGeometry, ObjectClass, OrientedBox3, Timestamp};
use percept_scene::rooms::{Floor, RoomId, RoomKind, RoomParams, Rooms, find_rooms};
use percept_scene::{
    Node, NodeId, ObjectId, Related, RelationFilter, RelationKind, RelationParams, SceneGraph, SceneView,
};
use proptest::prelude::*;
use std::collections::BTreeMap;

/// Cells of 0.1 m. Of the drawing a character is 0.5 m wide and high: `#` wall, `.` free, space unknown, `t` a thing that is seen as occupied. The first row is the
/// one with the largest y.
pub(crate) struct Drawn {
    width: usize,
    height: usize,
    cells: Vec<i8>,
}

const FINE: usize = 5;

pub(crate) fn drawn(rows: &[&str]) -> Drawn {
    let (width, height) = (rows[0].len() * FINE, rows.len() * FINE);
    let value = |c: u8| match c {
        b'#' | b't' => 100,
        b'.' => 0,
        _ => -1,
    };
    let cell = |x: usize, y: usize| value(rows[rows.len() - 1 - y / FINE].as_bytes()[x / FINE]);
    let cells = (0..height).flat_map(|y| (0..width).map(move |x| cell(x, y))).collect();
    Drawn { width, height, cells }
}

impl Drawn {
    pub(crate) fn divided(&self, things: &[OrientedBox3], keyframes: &[(u64, [f64; 2])]) -> Rooms {
        let geometry = GridGeometry::new(0.1, Point2::origin());
        let floor = Floor { geometry, width: self.width, height: self.height, cells: &self.cells };
        let keyframes: Vec<_> = keyframes.iter().map(|(n, p)| (*n, Point2::from(*p))).collect();
        find_rooms(&floor, things, &keyframes, &RoomParams::default()).unwrap()
    }
}

/// Two rooms of 4 m x 3 m, a door of 1 m between them, and a corridor below that both open to.
pub(crate) const FLAT: [&str; 13] = [
    "###################",
    "#........#........#",
    "#........#........#",
    "#.................#",
    "#.................#",
    "#........#........#",
    "#........#........#",
    "###..#########..###",
    "#.................#",
    "#.................#",
    "#.................#",
    "###################",
    "                   ",
];

#[test]
fn rooms_are_cut_at_doors_and_a_corridor_is_told_from_them() {
    let rooms = drawn(&FLAT).divided(&[], &[(3, [2.0, 4.5]), (7, [6.0, 1.7]), (9, [2.2, 4.4])]);
    assert_eq!(rooms.rooms.len(), 3, "{:?}", rooms.rooms);
    let at = |x: f64, y: f64| rooms.at(&Point2::new(x, y)).unwrap();
    let (left, right, corridor) = (at(2.0, 4.5), at(7.0, 4.5), at(6.0, 1.7));
    assert_eq!((left.kind, right.kind, corridor.kind), (RoomKind::Room, RoomKind::Room, RoomKind::Corridor));
    assert_eq!(left.id, RoomId(3 * RoomId::PER_KEYFRAME));
    assert_eq!(corridor.id, RoomId(7 * RoomId::PER_KEYFRAME));
    assert!(left.id.was_entered() && !right.id.was_entered());
    assert!((left.area_m2 - 12.0).abs() < 1.1 && (corridor.area_m2 - 12.75).abs() < 1.1, "{:?}", rooms.rooms);
    assert_eq!(rooms.doors.len(), 3, "{:?}", rooms.doors);
    let door = rooms.doors.iter().find(|d| d.rooms == (left.id, right.id)).unwrap();
    assert!((door.width_m - 1.0).abs() < 0.11 && (door.center - Point2::new(4.75, 4.5)).norm() < 0.3, "{door:?}");
    // The wall, and so the line from jamb to jamb, runs along y.
    assert!(door.angle_rad.abs() > 1.4);
    // Through the door is shorter than by the corridor.
    let route = rooms.route(&Point2::new(2.0, 4.5), right.id).unwrap();
    assert_eq!(route.steps.iter().map(|s| s.room).collect::<Vec<_>>(), [left.id, right.id]);
    assert!(route.length_m > 3.0 && route.length_m < 7.5, "{}", route.length_m);
    let corridor_end = rooms.route(&Point2::new(2.0, 4.5), corridor.id).unwrap();
    assert_eq!(corridor_end.steps.len(), 2);
    assert_eq!(corridor_end.steps[0].door.map(|d| rooms.doors[d].rooms), Some((left.id, corridor.id)));
}

#[test]
fn a_room_keeps_its_number_while_the_map_grows_and_moves() {
    let keyframes = [(3, [2.0, 4.5]), (5, [4.75, 4.5]), (7, [6.0, 1.7]), (9, [7.0, 4.4])];
    let whole = drawn(&FLAT).divided(&[], &keyframes);
    let at = |rooms: &Rooms, x: f64, y: f64| rooms.at(&Point2::new(x, y)).map(|r| r.id);
    // Before the right half was seen, and with a keyframe on the sill that falls to either side.
    let half: Vec<String> = FLAT.iter().map(|row| row.chars().take(10).chain("         ".chars()).collect()).collect();
    let half: Vec<&str> = half.iter().map(String::as_str).collect();
    let early = drawn(&half).divided(&[], &keyframes[..2]);
    assert_eq!(at(&early, 2.0, 4.5), at(&whole, 2.0, 4.5));
    let nudged = [(3, [2.1, 4.4]), (5, [4.9, 4.5]), (7, [6.0, 1.7]), (9, [7.0, 4.4])];
    assert_eq!(at(&drawn(&FLAT).divided(&[], &nudged), 7.0, 4.5), at(&whole, 7.0, 4.5));
    assert_eq!(at(&whole, 7.0, 4.5), Some(RoomId(9 * RoomId::PER_KEYFRAME)));
}

/// One room that two shelves reach into from both sides.
const SHELVES: [&str; 8] = [
    "#############",
    "#....tt.....#",
    "#....tt.....#",
    "#...........#",
    "#....tt.....#",
    "#....tt.....#",
    "#....tt.....#",
    "#############",
];

#[test]
fn shelves_do_not_make_a_door() {
    let shelf =
        |y: f64, depth: f64| OrientedBox3::upright(Point3::new(3.0, y, 0.9), Vector3::new(1.0, depth, 1.8), 0.0);
    let things = [shelf(3.0, 1.0), shelf(1.25, 1.5)];
    assert_eq!(drawn(&SHELVES).divided(&[], &[]).rooms.len(), 2, "as walls they do");
    let rooms = drawn(&SHELVES).divided(&things, &[]);
    assert_eq!((rooms.rooms.len(), rooms.doors.len()), (1, 0));
    assert_eq!(rooms.of(&things[0]).map(|r| r.id), rooms.of(&things[1]).map(|r| r.id));
    assert!((rooms.rooms[0].area_m2 - 5.5 * 3.0).abs() < 0.5, "what stands there is floor: {}", rooms.rooms[0].area_m2);
}

#[test]
fn a_room_around_a_large_table_is_no_corridor() {
    let rooms = drawn(&[
        "################",
        "#..............#",
        "#..............#",
        "#..............#",
        "#..............#",
        "#....######....#",
        "#....######....#",
        "#....######....#",
        "#..............#",
        "#..............#",
        "#..............#",
        "#..............#",
        "################",
    ])
    .divided(&[], &[]);
    assert_eq!(rooms.rooms.len(), 1);
    assert_eq!(rooms.rooms[0].kind, RoomKind::Room);
}

#[test]
fn a_cross_of_walls_between_four_doors_is_no_furniture_whatever_stands_at_it() {
    let four = drawn(&[
        "#################",
        "#.......#.......#",
        "#.......#.......#",
        "#...............#",
        "#......t#t......#",
        "#......t#t......#",
        "#####..###..#####",
        "#......t#t......#",
        "#......t#t......#",
        "#...............#",
        "#.......#.......#",
        "#.......#.......#",
        "#################",
    ]);
    let shelf = |x: f64, y: f64| OrientedBox3::upright(Point3::new(x, y, 0.9), Vector3::new(0.5, 1.0, 1.8), 0.0);
    let things = [shelf(3.75, 4.0), shelf(4.75, 4.0), shelf(3.75, 2.5), shelf(4.75, 2.5)];
    let rooms = four.divided(&things, &[]);
    assert_eq!((rooms.rooms.len(), rooms.doors.len()), (4, 4), "{:?}", rooms.rooms);
}

#[test]
fn what_is_seen_through_a_window_is_no_room() {
    let seen = drawn(&[
        "          ......  ",
        "       .........  ",
        "#####............ ",
        "#..............   ",
        "#...#..........   ",
        "#...#   .......   ",
        "#...#             ",
        "#####             ",
    ]);
    let rooms = seen.divided(&[], &[(0, [1.0, 1.0])]);
    assert_eq!(rooms.rooms.len(), 1, "{:?}", rooms.rooms);
    assert!(rooms.rooms[0].area_m2 < 4.5);
}

#[test]
fn bad_floors_and_parameters_are_named() {
    let geometry = GridGeometry::new(0.1, Point2::origin());
    let short = Floor { geometry, width: 3, height: 3, cells: &[0; 8] };
    let error = find_rooms(&short, &[], &[], &RoomParams::default()).unwrap_err();
    assert!(error.to_string().starts_with("cells: 8"), "{error}");
    let bad = RoomParams { door_max_m: f64::NAN, ..RoomParams::default() };
    let empty = Floor { geometry, width: 0, height: 0, cells: &[] };
    assert!(find_rooms(&empty, &[], &[], &bad).unwrap_err().to_string().starts_with("door_max_m"));
    let none = find_rooms(&empty, &[], &[], &RoomParams::default()).unwrap();
    assert_eq!((none.rooms.len(), none.doors.len(), none.places.len()), (0, 0, 0));
    assert!(none.at(&Point2::origin()).is_none() && none.route(&Point2::origin(), RoomId(0)).is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn any_floor_is_divided_into_parts_that_do_not_overlap(
        cells in prop::collection::vec(prop_oneof![4 => Just(0i8), 1 => Just(100), 1 => Just(-1)], 60 * 40),
        boxes in prop::collection::vec((0.0..6.0f64, 0.0..4.0f64, 0.1..2.0f64), 0..5),
    ) {
        let floor = Drawn { width: 60, height: 40, cells };
        let things: Vec<OrientedBox3> = boxes
            .iter()
            .map(|(x, y, size)| OrientedBox3::upright(Point3::new(*x, *y, 0.5), Vector3::repeat(*size), *x))
            .collect();
        let rooms = floor.divided(&things, &[(0, [1.0, 1.0]), (4, [5.0, 3.0])]);
        let cells: usize = (0..rooms.rooms.len()).map(|i| rooms.cells_of(i).count()).sum();
        let area: f64 = rooms.rooms.iter().map(|r| r.area_m2).sum();
        prop_assert!(cells <= 60 * 40 && (area - cells as f64 * 0.01).abs() < 1e-6);
        prop_assert!(rooms.rooms.windows(2).all(|w| w[0].id < w[1].id));
        prop_assert!(rooms.rooms.iter().all(|r| r.outline.len() >= 3 && r.radius_m > 0.0));
        for link in &rooms.links {
            let (a, b) = (rooms.places[link.places.0.0 as usize], rooms.places[link.places.1.0 as usize]);
            prop_assert!(link.length_m > 0.99 * (a.position - b.position).norm());
        }
        prop_assert_eq!(&floor.divided(&things, &[(0, [1.0, 1.0]), (4, [5.0, 3.0])]), &rooms);
    }
}

#[test]
fn relations_that_are_taken_over_are_those_that_would_be_found_anew() {
    let rooms = drawn(&FLAT).divided(&[], &[(3, [2.0, 4.5]), (7, [6.0, 1.7]), (9, [7.0, 4.4])]);
    let params = RelationParams::default();
    let spread = |i: u64, m: u64| (i.wrapping_mul(m) >> 7 & 0xffff) as f64 / 65536.0;
    let classes = [ObjectClass::Table, ObjectClass::Chair, ObjectClass::Shelf, ObjectClass::Box];
    let mut objects: Vec<_> = (0..60u64)
        .map(|i| {
            let at = [
                0.8 + 8.0 * spread(i, 40_503_761),
                0.8 + 5.0 * spread(i, 97_531_357),
                0.2 + 0.3 * spread(i, 7_919_333),
            ];
            thing(i, classes[i as usize % 4], at, [0.3, 0.25, 0.4])
        })
        .filter(|o| rooms.of(&o.bbox).is_some())
        .collect();
    let mut kept = Related::default();
    let (names, t_map_base) = (BTreeMap::new(), percept_geometry::se3::from_xy_yaw(2.0, 4.5, 0.0));
    for round in 0..60u64 {
        // One is moved, one changes its class, one goes; now and then one stands where no room is.
        let pick = |k: u64| (round * 7 + k) as usize % 40;
        objects[pick(0)].bbox.t_frame_box.translation.vector.x += if round % 3 == 0 { 0.3 } else { -0.2 };
        objects[pick(5)].class = classes[round as usize % 4];
        let gone = pick(11);
        objects[gone].state = match objects[gone].state {
            percept_scene::ObjectState::Static => percept_scene::ObjectState::Gone,
            _ => percept_scene::ObjectState::Static,
        };
        if round % 10 == 4 {
            objects[3].bbox.t_frame_box.translation.vector.y += 50.0;
        } else if round % 10 == 8 {
            objects[3].bbox.t_frame_box.translation.vector.y -= 50.0;
        }
        kept = kept.renewed(&objects, &rooms, &params);
        let graph = |related: &Related| {
            let view = SceneView {
                stamp: Timestamp(7),
                map_version: 3,
                t_map_base: &t_map_base,
                objects: &objects,
                rooms: &rooms,
                related,
                names: &names,
                since: None,
            };
            SceneGraph::build(&view, &params, None, &RelationFilter::default())
        };
        let anew = graph(&Related::of(&objects, &rooms, &params));
        assert!(anew.edges.len() > 40, "{}", anew.edges.len());
        assert_eq!(graph(&kept), anew, "{round}");
    }
}

#[test]
fn a_graph_says_which_room_things_are_in_and_nothing_through_walls() {
    let rooms = drawn(&FLAT).divided(&[], &[(3, [2.0, 4.5]), (7, [6.0, 1.7]), (9, [7.0, 4.4])]);
    let objects = [
        thing(0, ObjectClass::Table, [3.8, 5.5, 0.375], [1.2, 0.8, 0.75]),
        thing(1, ObjectClass::Chair, [3.8, 5.1, 0.35], [0.5, 0.5, 0.7]),
        // Behind the wall, half a metre away.
        thing(2, ObjectClass::Shelf, [5.3, 5.5, 0.9], [0.5, 0.9, 1.8]),
        thing(3, ObjectClass::Box, [3.7, 5.6, 0.85], [0.2, 0.2, 0.2]),
    ];
    let (left, corridor, right) = (RoomId(3 * 1024), RoomId(7 * 1024), RoomId(9 * 1024));
    let names = BTreeMap::from([(left, "Ada's \"office\"".to_owned())]);
    let t_map_base = percept_geometry::se3::from_xy_yaw(2.0, 4.5, 0.0);
    let view = SceneView {
        stamp: Timestamp(7),
        map_version: 3,
        t_map_base: &t_map_base,
        objects: &objects,
        rooms: &rooms,
        related: &Related::of(&objects, &rooms, &RelationParams::default()),
        names: &names,
        since: None,
    };
    let graph = SceneGraph::build(&view, &RelationParams::default(), None, &RelationFilter::default());
    let said: Vec<(NodeId, RelationKind, NodeId)> = graph.edges.iter().map(|e| (e.subject, e.kind, e.object)).collect();
    let object = |id| NodeId::Object(ObjectId(id));
    for (expected, holds) in [
        ((NodeId::Robot, RelationKind::InRoom, NodeId::Room(left)), true),
        ((object(0), RelationKind::InRoom, NodeId::Room(left)), true),
        ((object(2), RelationKind::InRoom, NodeId::Room(right)), true),
        ((object(1), RelationKind::Under, object(0)), true),
        ((object(3), RelationKind::On, object(0)), true),
        ((object(0), RelationKind::Supports, object(3)), true),
        ((object(0), RelationKind::NextTo, object(2)), false),
        ((object(0), RelationKind::Near, object(2)), false),
        ((NodeId::Robot, RelationKind::Near, object(0)), true),
        ((NodeId::Room(left), RelationKind::ConnectedTo, NodeId::Room(right)), true),
        ((NodeId::Room(corridor), RelationKind::ConnectedTo, NodeId::Room(right)), true),
    ] {
        assert_eq!(said.contains(&expected), holds, "{expected:?} of {said:?}");
    }
    assert!(graph.edges.iter().all(|e| e.kind != RelationKind::LeftOf && e.kind != RelationKind::Behind));
    let dot = graph.to_dot();
    assert!(dot.contains("subgraph cluster_3072 {") && dot.contains("Ada's \\\"office\\\""), "{dot}");
    // Which rooms have a table?
    let filter = RelationFilter {
        kinds: vec![RelationKind::InRoom],
        subject_class: Some(ObjectClass::Table),
        ..RelationFilter::default()
    };
    let found = SceneGraph::build(&view, &RelationParams::default(), None, &filter);
    assert_eq!(found.edges.len(), 1);
    assert_eq!(found.nodes.iter().map(Node::id).collect::<Vec<_>>(), [object(0), NodeId::Room(left)]);
    let in_right = RelationFilter { room: Some(right), ..RelationFilter::default() };
    assert!(
        SceneGraph::build(&view, &RelationParams::default(), None, &in_right).nodes.iter().all(|n| n.id() != object(0))
    );
}

/// What a robot at a point reaches, with the way there: the graph that is asked for that alone.
fn reached(rows: &[&str], t_map_base: [f64; 2], objects: &[percept_scene::Object]) -> Vec<(NodeId, f64)> {
    let things: Vec<OrientedBox3> = objects.iter().map(|o| o.bbox).collect();
    let rooms = drawn(rows).divided(&things, &[(3, [2.0, 4.5]), (7, [6.0, 1.7]), (9, [7.0, 4.4])]);
    let params = RelationParams::default();
    let view = SceneView {
        stamp: Timestamp(7),
        map_version: 3,
        t_map_base: &percept_geometry::se3::from_xy_yaw(t_map_base[0], t_map_base[1], 0.0),
        objects,
        rooms: &rooms,
        related: &Related::of(objects, &rooms, &params),
        names: &BTreeMap::new(),
        since: None,
    };
    let filter = RelationFilter { kinds: vec![RelationKind::ReachableFrom], ..RelationFilter::default() };
    let unasked = SceneGraph::build(&view, &params, None, &RelationFilter::default());
    assert!(unasked.edges.iter().all(|e| e.kind != RelationKind::ReachableFrom));
    let graph = SceneGraph::build(&view, &params, None, &filter);
    assert!(graph.edges.iter().all(|e| e.object == NodeId::Robot && e.strength == 1.0), "{:?}", graph.edges);
    graph.edges.iter().map(|e| (e.subject, e.distance_m)).collect()
}

#[test]
fn rooms_and_things_are_reachable_through_doors_and_over_free_floor_alone() {
    let (left, corridor, right) =
        (NodeId::Room(RoomId(3 * 1024)), NodeId::Room(RoomId(7 * 1024)), NodeId::Room(RoomId(9 * 1024)));
    let object = |id| NodeId::Object(ObjectId(id));
    let objects = [
        thing(0, ObjectClass::Chair, [3.0, 5.5, 0.4], [0.5, 0.5, 0.8]),
        thing(1, ObjectClass::Shelf, [7.0, 5.7, 0.9], [0.9, 0.4, 1.8]),
        // Where no room is.
        thing(2, ObjectClass::Box, [20.0, 5.0, 0.2], [0.4, 0.4, 0.4]),
    ];
    let ids = |reached: &[(NodeId, f64)]| reached.iter().map(|r| r.0).collect::<Vec<_>>();
    let all = reached(&FLAT, [2.0, 4.5], &objects);
    assert_eq!(ids(&all), [object(0), object(1), left, corridor, right]);
    let way = |id: NodeId| all.iter().find(|r| r.0 == id).unwrap().1;
    // The straight line to the chair's side is 1.0 m, to the shelf's, through the door, 4.7 m; ways over places and cells are longer
    // by what they turn.
    assert!(way(left) == 0.0 && (0.9..3.0).contains(&way(object(0))), "{all:?}");
    assert!((4.6..8.5).contains(&way(object(1))) && way(right) < way(object(1)), "{all:?}");

    // With both of its doors shut, nobody gets into the right room, nor out of it.
    let shut: Vec<String> = FLAT
        .iter()
        .enumerate()
        .map(|(row, line)| match row {
            3 | 4 => "#........#........#".to_owned(),
            7 => "###..##############".to_owned(),
            _ => (*line).to_owned(),
        })
        .collect();
    let shut: Vec<&str> = shut.iter().map(String::as_str).collect();
    assert_eq!(ids(&reached(&shut, [2.0, 4.5], &objects)), [object(0), left, corridor]);
    assert_eq!(ids(&reached(&shut, [7.0, 4.5], &objects)), [object(1), right]);
    // Who is in no room gets nowhere that is known.
    assert_eq!(reached(&FLAT, [20.0, 4.5], &objects), []);
}

/// A room of 4 m x 8 m; shelves from wall to wall across its middle.
const BARRED: [&str; 19] = [
    "##########",
    "#........#",
    "#........#",
    "#........#",
    "#........#",
    "#........#",
    "#........#",
    "#........#",
    "#........#",
    "#tttttttt#",
    "#........#",
    "#........#",
    "#........#",
    "#........#",
    "#........#",
    "#........#",
    "#........#",
    "#........#",
    "##########",
];

#[test]
fn what_stands_behind_furniture_that_leaves_no_way_is_not_reachable() {
    let object = |id| NodeId::Object(ObjectId(id));
    let objects = [
        thing(0, ObjectClass::Shelf, [2.5, 4.75, 0.5], [4.0, 0.5, 1.0]),
        thing(1, ObjectClass::Box, [2.5, 8.0, 0.2], [0.4, 0.4, 0.4]),
        thing(2, ObjectClass::Box, [2.5, 1.2, 0.2], [0.4, 0.4, 0.4]),
    ];
    let of = |y: f64| reached(&BARRED, [2.5, y], &objects).iter().map(|r| r.0).collect::<Vec<_>>();
    let (below, above) = (of(2.0), of(7.5));
    assert!(below.contains(&object(0)) && below.contains(&object(2)) && !below.contains(&object(1)), "{below:?}");
    assert!(above.contains(&object(1)) && !above.contains(&object(2)), "{above:?}");
}
