//! How long questions and updates take in a large scene: `many_things [THINGS] [ROOMS]`, 10000 and 500 unless said otherwise.
//!
//! Rooms of 5 m x 5 m in a grid with a door to the next, things spread over them on a raster. Printed are medians and the 99th
//! percentile of what one thread takes, milliseconds: dividing the floor, the graph as a whole, questions to it, lists of objects, and an
//! update of the tracker by what one keyframe sees of one room.

#![allow(clippy::unwrap_used, reason = "a benchmark")]

use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{Aabb3, GridGeometry, ObjectClass, OrientedBox3, Pose, Timestamp};
use percept_scene::rooms::{Floor, RoomParams, find_rooms};
use percept_scene::{
    NodeId, ObjectFilter, ObjectId, Observation, Related, RelationFilter, RelationKind, RelationParams, SceneGraph,
    SceneView, Tracker, TrackerParams, Visibility,
};
use std::collections::BTreeMap;
use std::hint::black_box;
use std::time::Instant;

const ROOM_M: f64 = 5.0;
const CELL_M: f64 = 0.1;

fn timed(name: &str, times: usize, mut work: impl FnMut(usize)) {
    let mut ms: Vec<f64> = (0..times)
        .map(|i| {
            let begun = Instant::now();
            work(i);
            begun.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    ms.sort_by(f64::total_cmp);
    println!("{name:>44}  {:8.3}  {:8.3}", ms[times / 2], ms[(times * 99 / 100).min(times - 1)]);
}

fn main() {
    let mut given = std::env::args().skip(1).map(|a| a.parse::<usize>().unwrap());
    let (things, rooms) = (given.next().unwrap_or(10_000), given.next().unwrap_or(500));
    let columns = (rooms as f64).sqrt().ceil() as usize;
    let rows = rooms.div_ceil(columns);
    let per_room = things.div_ceil(rooms);
    // A floor with walls of two cells, and doors of 1 m.
    let side = (ROOM_M / CELL_M) as usize;
    let (width, height) = (columns * side + 2, rows * side + 2);
    let is_wall = |x: usize, y: usize| {
        let (u, v) = (x % side, y % side);
        let door = |along: usize| (20..30).contains(&along);
        let is_rim = x < 2 || y < 2 || x + 2 >= width || y + 2 >= height;
        is_rim || (u < 2 && !door(v)) || (v < 2 && !door(u))
    };
    let cells: Vec<i8> = (0..width * height).map(|i| if is_wall(i % width, i / width) { 100 } else { 0 }).collect();
    let classes = [ObjectClass::Table, ObjectClass::Chair, ObjectClass::Shelf, ObjectClass::Box, ObjectClass::Cylinder];
    let seen = |room: usize| {
        let (x, y) = ((room % columns) as f64 * ROOM_M, (room / columns) as f64 * ROOM_M);
        let across = (per_room as f64).sqrt().ceil() as usize;
        let step = (ROOM_M - 1.0) / across as f64;
        (0..per_room)
            .map(|k| {
                let at = Point3::new(x + 0.7 + (k % across) as f64 * step, y + 0.7 + (k / across) as f64 * step, 0.4);
                let bbox = OrientedBox3::upright(at, Vector3::new(0.5 * step, 0.4 * step, 0.8), 0.0);
                Observation {
                    class: classes[k % 5],
                    confidence: 0.8,
                    bbox,
                    num_points: 300,
                    is_moving: false,
                    is_seen: true,
                }
            })
            .collect::<Vec<_>>()
    };
    let mut tracker = Tracker::new(TrackerParams { max_objects: 2 * things, ..TrackerParams::default() }).unwrap();
    let hidden = |_: &OrientedBox3| Visibility::Unseen;
    let mut stamp = 0i64;
    for room in 0..rooms {
        for _ in 0..2 {
            stamp += 500_000_000;
            tracker.update(Timestamp(stamp), &seen(room), &hidden);
        }
    }
    let objects = tracker.objects();
    println!("{} objects, {rooms} rooms; ms: median, 99 %", objects.len());
    let floor = Floor { geometry: GridGeometry::new(CELL_M, Point2::origin()), width, height, cells: &cells };
    let boxes: Vec<OrientedBox3> = objects.iter().map(|o| o.bbox).collect();
    let divided = find_rooms(&floor, &boxes, &[], &RoomParams::default()).unwrap();
    println!("{} rooms found, {} doors", divided.rooms.len(), divided.doors.len());
    timed("the floor divided", 3, |_| {
        black_box(find_rooms(&floor, &boxes, &[], &RoomParams::default()).unwrap());
    });
    let params = RelationParams::default();
    timed("objects related to each other", 10, |_| {
        black_box(Related::of(&objects, &divided, &params));
    });
    let related = Related::of(&objects, &divided, &params);
    let mut moved = objects.clone();
    timed("the same after one was moved", 50, |i| {
        moved[i * 37 % things].bbox.t_frame_box.translation.vector.x += 0.05;
        black_box(related.renewed(&moved, &divided, &params));
    });
    let (t_map_base, names) = (Pose::translation(12.0, 12.0, 0.0), BTreeMap::new());
    let view = SceneView {
        stamp: Timestamp(stamp),
        map_version: 1,
        t_map_base: &t_map_base,
        objects: &objects,
        rooms: &divided,
        related: &related,
        names: &names,
        since: None,
    };
    let everything = RelationFilter::default();
    let graph = SceneGraph::build(&view, &params, None, &everything);
    println!("{} nodes, {} relations", graph.nodes.len(), graph.edges.len());
    timed("the whole graph, of what is related", 10, |_| {
        black_box(SceneGraph::build(&view, &params, None, &everything));
    });
    let which = RelationFilter {
        kinds: vec![RelationKind::InRoom],
        subject_class: Some(ObjectClass::Table),
        ..RelationFilter::default()
    };
    timed("which rooms have a table", 50, |_| {
        black_box(SceneGraph::build(&view, &params, None, &which));
    });
    let by = RelationFilter { subject: Some(NodeId::Object(ObjectId(4_321))), ..RelationFilter::default() };
    timed("what one thing has to do with others", 50, |_| {
        black_box(SceneGraph::build(&view, &params, None, &by));
    });
    let near = ObjectFilter { near: Some(Point3::new(30.0, 20.0, 0.5)), ..ObjectFilter::default() };
    timed("objects, nearest first", 50, |_| {
        black_box(near.of(&objects));
    });
    let region = Aabb3 { min: Point3::new(10.0, 10.0, 0.0), max: Point3::new(15.0, 15.0, 2.0) };
    let within = ObjectFilter { region: Some(region), text: "chair".to_owned(), ..ObjectFilter::default() };
    timed("chairs in a box", 50, |_| {
        black_box(within.of(&objects));
    });
    timed("a keyframe's update", 200, |i| {
        stamp += 500_000_000;
        black_box(tracker.update(Timestamp(stamp), &seen(i * 7 % rooms), &hidden));
    });
    timed("all objects listed", 20, |_| {
        black_box(tracker.objects());
    });
}
