//! Rooms that look alike, one of which the map does not know: a robot that is in it may be said to be in the other for as long as it stays,
//! and no longer; and nothing of the map is changed meanwhile.

use crate::plan::{Plan, RANGE_M, drive, frames, pipeline, tour};
use percept_geometry::{Pose, se3};
use percept_mapping::Occupancy as _;
use percept_mapping::given::{GivenOptions, GivenView, views_of_grid};
use percept_pipeline::Pipeline;

/// The map of a tour of `rooms` as views of its grid; base to the tour's map at its first frame is the identity.
pub(crate) fn views_of_tour(rooms: &[usize], plan: &Plan) -> (Vec<GivenView>, Pose) {
    let way = tour(rooms);
    let mut first = pipeline();
    frames(plan, &way).for_each(|f| drop(first.process(&f).unwrap()));
    first.settle();
    let grid = first.snapshot().layers.occupancy.dense(usize::MAX).unwrap();
    let options = GivenOptions { range_max_m: RANGE_M, sensor_height_m: 0.3 };
    let (x, y, yaw) = way[0];
    (views_of_grid(&grid, &options).unwrap().views, se3::from_xy_yaw(x, y, yaw))
}

/// A session that begins with it, and base to world where it begins.
fn with_map_of(rooms: &[usize], plan: &Plan) -> (Pipeline, Pose) {
    let (views, t_world_map) = views_of_tour(rooms, plan);
    let mut second = pipeline();
    second.take_given(views, None).unwrap();
    (second, t_world_map)
}

/// What is said of each frame: how far off, metres, none where it is lost; and the keyframes that there are then.
fn errors(
    pipeline: &mut Pipeline,
    t_world_map: &Pose,
    plan: &Plan,
    way: &[(f64, f64, f64)],
) -> Vec<(Option<f64>, usize)> {
    let told = frames(plan, way).zip(way).map(|(frame, (x, y, _))| {
        let pose = pipeline.process(&frame).unwrap().pose.unwrap();
        let at = (t_world_map * pose.t_map_base).translation.vector;
        let off = pose.state.is_tracking().then(|| (at.x - x).hypot(at.y - y));
        (off, pipeline.snapshot().keyframes.len())
    });
    told.collect()
}

#[test]
fn a_robot_in_a_room_that_is_not_mapped_is_not_kept_in_the_one_that_looks_like_it_and_draws_nothing_there() {
    let (mut pipeline, t_world_map) = with_map_of(&[0, 1, 3], &Plan::of_rooms(true));
    let plan = Plan::of_rooms(false);
    // To and fro in the third room, out into the corridor, into the fourth one, the second and the first.
    let mut stations = vec![(15.0, 3.0), (14.7, 4.5), (15.0, 3.0), (14.7, 4.5), (15.0, 3.0), (15.0, 1.0)];
    stations.extend([
        (20.0, 1.0),
        (21.0, 3.0),
        (21.0, 1.0),
        (9.0, 1.0),
        (9.0, 4.0),
        (9.0, 1.0),
        (3.0, 1.0),
        (3.0, 4.0),
    ]);
    let way = drive(&stations);
    let given = pipeline.snapshot().keyframes.len();
    let (told, keyframes): (Vec<_>, Vec<_>) = errors(&mut pipeline, &t_world_map, &plan, &way).into_iter().unzip();
    let is_wrong = |e: &Option<f64>| e.is_some_and(|e| e > 0.5);
    let last_wrong = told.iter().rposition(is_wrong).map_or(0, |i| i + 1);
    // It is known before the fourth room is left again.
    let (_, y, _) = way[last_wrong];
    assert!(last_wrong < 420 && y < 8.0, "wrong until frame {last_wrong}");
    assert!(told.iter().skip(last_wrong).flatten().all(|e| *e < 0.15));
    assert!(told.last().unwrap().is_some(), "it is found in the end");
    assert!(told.iter().filter(|e| e.is_some() && !is_wrong(e)).count() > 200);
    assert!(keyframes[..=last_wrong].iter().all(|n| *n == given), "it has drawn where it was not");
    assert!(keyframes.last().is_some_and(|n| *n > given), "it maps once it is certain");
}

#[test]
fn a_robot_that_wakes_where_nobody_has_mapped_is_found_soon_after_it_comes_into_the_map() {
    // The fourth room and its end of the corridor are known, and the first one; not the third, where it wakes.
    let (mut pipeline, t_world_map) = with_map_of(&[0, 3], &Plan::of_rooms(true));
    let plan = Plan::of_rooms(false);
    let way = drive(&[(15.0, 3.0), (14.7, 4.5), (13.2, 5.5), (15.0, 3.0), (15.0, 1.0), (20.0, 1.0), (21.0, 3.0)]);
    let told = errors(&mut pipeline, &t_world_map, &plan, &way);
    let right = |(e, _): &(Option<f64>, usize)| e.is_some_and(|e| e < 0.15);
    let out_of_the_room = way.iter().position(|at| at.1 < 1.05).unwrap();
    let found = told.iter().rposition(|e| !right(e)).map_or(0, |i| i + 1);
    assert!(found < out_of_the_room + 120, "{found} after {out_of_the_room}");
}
