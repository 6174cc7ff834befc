//! Floors drawn by hand, divided.

use nalgebra::{Point2, Point3, Vector3};
use percept_geometry::{GridGeometry, OrientedBox3};
use percept_scene::rooms::{Floor, RoomId, RoomKind, RoomParams, Rooms, find_rooms};

/// Cells of 0.1 m. Of the drawing a character is 0.5 m wide and high: `#` wall, `.` free, space unknown, `t` a thing that is seen as occupied. The first row is the
/// one with the largest y.
struct Drawn {
    width: usize,
    height: usize,
    cells: Vec<i8>,
}

const FINE: usize = 5;

fn drawn(rows: &[&str]) -> Drawn {
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
    fn divided(&self, things: &[OrientedBox3], keyframes: &[(u64, [f64; 2])]) -> Rooms {
        let geometry = GridGeometry::new(0.1, Point2::origin());
        let floor = Floor { geometry, width: self.width, height: self.height, cells: &self.cells };
        let keyframes: Vec<_> = keyframes.iter().map(|(n, p)| (*n, Point2::from(*p))).collect();
        find_rooms(&floor, things, &keyframes, &RoomParams::default()).unwrap()
    }
}

/// Two rooms of 4 m x 3 m, a door of 1 m between them, and a corridor below that both open to.
const FLAT: [&str; 13] = [
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
    let _ = Vector3::<f64>::zeros();
    let _ = Point3::<f64>::origin();
}
