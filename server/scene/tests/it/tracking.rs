//! Identity, motion and disappearance.

use nalgebra::{Point3, Vector3};
use percept_geometry::{ObjectClass, OrientedBox3, Pose, Timestamp, se3};
use percept_scene::{
    Object, ObjectChangeKind, ObjectId, ObjectState, Observation, SceneError, Tracker, TrackerParams, Visibility,
};
use proptest::prelude::*;

pub(crate) fn tracker() -> Tracker {
    Tracker::new(TrackerParams::default()).unwrap()
}

pub(crate) fn seen_as(class: ObjectClass, center: [f64; 3], size: [f64; 3]) -> Observation {
    let bbox = OrientedBox3::upright(Point3::from(center), Vector3::from(size), 0.0);
    Observation { class, confidence: 0.8, bbox, num_points: 500, is_moving: false, is_seen: true }
}

fn person(x: f64, y: f64) -> Observation {
    seen_as(ObjectClass::Person, [x, y, 0.85], [0.5, 0.5, 1.7])
}

pub(crate) fn chair(x: f64, y: f64) -> Observation {
    seen_as(ObjectClass::Chair, [x, y, 0.45], [0.5, 0.5, 0.9])
}

pub(crate) fn at(tenths: i64) -> Timestamp {
    Timestamp(tenths * 100_000_000)
}

pub(crate) fn hidden(_: &OrientedBox3) -> Visibility {
    Visibility::Unseen
}

pub(crate) fn object(tracker: &Tracker, id: u64) -> Object {
    tracker.objects().into_iter().find(|o| o.id == ObjectId(id)).unwrap()
}

#[test]
fn a_thing_is_listed_when_seen_twice() {
    let mut t = tracker();
    assert!(t.update(at(0), &[chair(1.0, 2.0)], &hidden).is_empty() && t.objects().is_empty());
    let changes = t.update(at(1), &[chair(1.0, 2.0)], &hidden);
    assert_eq!((changes[0].id, changes[0].kind), (ObjectId(0), ObjectChangeKind::Appeared));
    let o = object(&t, 0);
    assert_eq!((o.first_seen, o.last_seen, o.observation_count), (at(0), at(1), 2));
    assert_eq!((o.class, o.state), (ObjectClass::Chair, ObjectState::Static));
    // A chance detection goes without a trace.
    t.update(at(2), &[chair(9.0, 9.0)], &hidden);
    t.update(at(100), &[], &hidden);
    t.update(at(101), &[chair(9.0, 9.0)], &hidden);
    assert_eq!(t.objects().len(), 1);
}

#[test]
fn identity_survives_being_hidden() {
    let mut t = tracker();
    for i in 0..5 {
        t.update(at(i), &[chair(1.0, 2.0), chair(3.0, 2.0)], &hidden);
    }
    for i in 5..500 {
        t.update(at(i), &[chair(3.0, 2.0)], &hidden);
    }
    assert!(t.update(at(500), &[chair(1.05, 2.0), chair(3.0, 2.0)], &hidden).is_empty());
    assert_eq!(t.objects().len(), 2);
    assert_eq!(object(&t, 0).last_seen, at(500));
    assert_eq!(object(&t, 0).observation_count, 6);
}

#[test]
fn people_who_cross_keep_their_identity() {
    let mut t = tracker();
    // They pass each other at 0.3 m, 1 m/s each, ten frames a second: at the crossing their boxes overlap.
    for i in 0..60 {
        let x = 0.1 * i as f64;
        t.update(at(i), &[person(x, 0.0), person(6.0 - x, 0.3)], &hidden);
    }
    assert_eq!(t.objects().len(), 2);
    let (a, b) = (object(&t, 0), object(&t, 1));
    assert!((a.bbox.center().x - 5.9).abs() < 0.05 && (b.bbox.center().x - 0.1).abs() < 0.05);
    assert_eq!((a.state, b.state), (ObjectState::Moving, ObjectState::Moving));
    assert!((a.velocity_mps - Vector3::new(1.0, 0.0, 0.0)).norm() < 0.05);
    assert!((b.velocity_mps + Vector3::new(1.0, 0.0, 0.0)).norm() < 0.05);
}

#[test]
fn who_walks_behind_a_pillar_comes_out_the_same() {
    let mut t = tracker();
    for i in (0..30).filter(|i| !(12..20).contains(i)) {
        t.update(at(i), &[person(0.1 * i as f64, 0.0)], &hidden);
    }
    assert_eq!(t.objects().len(), 1);
    assert_eq!(object(&t, 0).observation_count, 22);
}

#[test]
fn who_stops_is_at_rest_again() {
    let mut t = tracker();
    let mut kinds = Vec::new();
    for i in 0..80i64 {
        let x = 0.1 * i.clamp(10, 40) as f64;
        kinds.extend(t.update(at(i), &[person(x, 0.0)], &hidden).iter().map(|c| c.kind));
    }
    kinds.retain(|k| *k != ObjectChangeKind::Updated);
    let expected = [ObjectChangeKind::Appeared, ObjectChangeKind::StartedMoving, ObjectChangeKind::Stopped];
    assert_eq!(kinds, expected);
    assert_eq!(object(&t, 0).velocity_mps, Vector3::zeros());
    assert!((object(&t, 0).bbox.center().x - 4.0).abs() < 0.02);
}

#[test]
fn a_box_that_grows_as_more_is_seen_does_not_move() {
    let mut t = tracker();
    let mut changes = Vec::new();
    for i in 0..30 {
        // A shelf of 3 m, uncovered from one end: the centre shifts by more than a metre.
        let length = (0.5 + 0.1 * i as f64).min(3.0);
        let mut shelf = seen_as(ObjectClass::Shelf, [0.5 * length, 0.0, 1.0], [length, 0.4, 2.0]);
        shelf.num_points = (1000.0 * length) as usize;
        changes.extend(t.update(at(i), &[shelf], &hidden));
    }
    assert!(changes.iter().all(|c| c.kind != ObjectChangeKind::StartedMoving));
    assert_eq!(t.objects().len(), 1);
    assert!((object(&t, 0).bbox.size.x - 3.0).abs() < 0.25, "{}", object(&t, 0).bbox.size);
}

#[test]
fn one_bad_box_does_not_move_a_thing() {
    let mut t = tracker();
    let mut changes = Vec::new();
    for i in 0..20 {
        let x = if i == 10 { 0.45 } else { 0.0 };
        changes.extend(t.update(at(i), &[chair(x, 0.0)], &hidden));
    }
    assert!(changes.iter().all(|c| c.kind != ObjectChangeKind::StartedMoving));
    assert_eq!(object(&t, 0).observation_count, 20);
    assert!(object(&t, 0).bbox.center().x.abs() < 1e-9);
}

#[test]
fn a_view_of_few_points_hardly_spoils_a_good_box() {
    let mut t = tracker();
    for i in 0..5 {
        t.update(at(i), &[seen_as(ObjectClass::Table, [0.0, 0.0, 0.4], [1.6, 0.8, 0.8])], &hidden);
    }
    let mut poor = seen_as(ObjectClass::Table, [0.3, 0.0, 0.4], [1.0, 0.8, 0.8]);
    poor.num_points = 20;
    t.update(at(5), &[poor], &hidden);
    assert!((object(&t, 0).bbox.size.x - 1.6).abs() < 0.05);
    assert_eq!(object(&t, 0).num_points, 500);
}

#[test]
fn what_is_seen_through_is_gone_and_may_come_back() {
    let mut t = tracker();
    for i in 0..3 {
        t.update(at(i), &[chair(1.0, 0.0)], &hidden);
    }
    let through = |_: &OrientedBox3| Visibility::SeenThrough;
    for i in 3..8 {
        // Three times seen through, but within the second in which the detector may have missed it.
        assert!(t.update(at(i), &[], &through).is_empty());
    }
    // A surface in its place in between: the count starts again.
    assert!(t.update(at(20), &[], &|_: &OrientedBox3| Visibility::Occupied).is_empty());
    for i in 21..23 {
        assert!(t.update(at(i), &[], &through).is_empty());
    }
    assert_eq!(t.update(at(23), &[], &through)[0].kind, ObjectChangeKind::Gone);
    assert_eq!((object(&t, 0).state, object(&t, 0).last_seen), (ObjectState::Gone, at(2)));
    assert!(t.update(at(24), &[], &through).is_empty());
    let back = t.update(at(25), &[chair(1.0, 0.1)], &hidden);
    assert_eq!((back[0].id, back[0].kind), (ObjectId(0), ObjectChangeKind::Reappeared));
    assert_eq!((object(&t, 0).state, object(&t, 0).bbox.center().y), (ObjectState::Static, 0.1));
}

#[test]
fn a_chair_carried_away_is_gone_there_and_new_elsewhere() {
    let mut t = tracker();
    for i in 0..3 {
        t.update(at(i), &[chair(1.0, 0.0)], &hidden);
    }
    for i in 3..14 {
        t.update(at(i), &[chair(4.0, 0.0)], &|_: &OrientedBox3| Visibility::SeenThrough);
    }
    assert_eq!(object(&t, 0).state, ObjectState::Gone);
    assert_eq!(object(&t, 1).state, ObjectState::Static);
}

#[test]
fn fragments_become_the_whole_and_keep_the_older_identity() {
    let mut t = tracker();
    let left = seen_as(ObjectClass::Box, [0.0, 0.0, 0.4], [0.5, 0.8, 0.8]);
    let right = seen_as(ObjectClass::Table, [1.0, 0.0, 0.4], [0.9, 0.8, 0.8]);
    for i in 0..4 {
        t.update(at(i), &[left, right], &hidden);
    }
    assert_eq!(t.objects().len(), 2);
    let mut whole = seen_as(ObjectClass::Table, [0.6, 0.0, 0.4], [1.7, 0.8, 0.8]);
    whole.num_points = 3000;
    let mut changes = Vec::new();
    for i in 4..20 {
        changes.extend(t.update(at(i), &[whole], &|_: &OrientedBox3| Visibility::Occupied));
    }
    let merged = changes.iter().find(|c| matches!(c.kind, ObjectChangeKind::Merged { .. })).unwrap();
    assert_eq!((merged.id, merged.kind), (ObjectId(1), ObjectChangeKind::Merged { into: ObjectId(0) }));
    assert_eq!(t.objects().len(), 1);
    assert_eq!(object(&t, 0).class, ObjectClass::Table);
    assert!(object(&t, 0).bbox.iou_upright(&whole.bbox) > 0.9);
}

#[test]
fn a_box_in_a_shelf_stays_a_thing_of_its_own_while_it_is_detected() {
    let mut t = tracker();
    let shelf = seen_as(ObjectClass::Shelf, [0.0, 0.0, 1.0], [1.0, 0.5, 2.0]);
    let inner = seen_as(ObjectClass::Box, [0.1, 0.0, 1.0], [0.3, 0.3, 0.3]);
    for i in 0..50 {
        let both = [shelf, inner];
        let seen: &[Observation] = if i % 3 == 0 { &both[..1] } else { &both };
        t.update(at(i), seen, &|_: &OrientedBox3| Visibility::Occupied);
    }
    assert_eq!(t.objects().len(), 2);
}

#[test]
fn class_follows_the_evidence_and_says_so() {
    let mut t = tracker();
    for i in 0..3 {
        t.update(at(i), &[seen_as(ObjectClass::Box, [0.0, 0.0, 0.4], [0.5, 0.5, 0.8])], &hidden);
    }
    let mut changes = Vec::new();
    for i in 3..9 {
        changes.extend(t.update(at(i), &[seen_as(ObjectClass::Chair, [0.0, 0.0, 0.4], [0.5, 0.5, 0.8])], &hidden));
    }
    let kind = ObjectChangeKind::Reclassified { from: ObjectClass::Box, to: ObjectClass::Chair };
    assert_eq!(changes.iter().map(|c| c.kind).collect::<Vec<_>>(), [kind]);
    assert!(object(&t, 0).confidence > 0.8);
}

#[test]
fn objects_move_with_the_map_and_are_found_again() {
    let mut t = tracker();
    for i in 0..3 {
        t.update(at(i), &[chair(1.0, 0.0)], &hidden);
    }
    let shift = se3::from_xy_yaw(5.0, 1.0, 0.3);
    t.correct(&|_, _| shift);
    let moved = shift * Point3::new(1.0, 0.0, 0.45);
    assert!((object(&t, 0).bbox.center() - moved).norm() < 1e-12);
    assert!(t.update(at(3), &[chair(moved.x, moved.y)], &hidden).is_empty());
    t.correct(&|_, _| Pose::identity());
    assert_eq!(t.objects().len(), 1);
}

#[test]
fn saved_objects_go_on_under_their_numbers() {
    let mut t = tracker();
    for i in 0..3 {
        t.update(at(i), &[chair(1.0, 0.0), person(4.0, 0.0)], &hidden);
    }
    let mut again = Tracker::restore(TrackerParams::default(), &t.objects(), t.next_id()).unwrap();
    for (a, b) in again.objects().iter().zip(t.objects()) {
        assert_eq!((a.id, a.class, a.bbox, a.observation_count), (b.id, b.class, b.bbox, b.observation_count));
        assert!((a.confidence - b.confidence).abs() < 1e-12);
    }
    for i in 3..5 {
        again.update(at(i), &[chair(1.0, 0.0), person(4.0, 0.0), chair(8.0, 0.0)], &hidden);
    }
    assert_eq!(again.objects().iter().map(|o| o.id.0).collect::<Vec<_>>(), [0, 1, 2]);
}

#[test]
fn at_the_limit_the_gone_make_room() {
    let params =
        TrackerParams { max_objects: 2, confirm_observations: 1, gone_observations: 1, ..TrackerParams::default() };
    let mut t = Tracker::new(params).unwrap();
    t.update(at(0), &[chair(0.0, 0.0), chair(2.0, 0.0), chair(4.0, 0.0)], &hidden);
    assert_eq!(t.objects().len(), 2);
    t.update(at(10), &[chair(2.0, 0.0)], &|_: &OrientedBox3| Visibility::SeenThrough);
    let changes = t.update(at(11), &[chair(2.0, 0.0), chair(6.0, 0.0)], &hidden);
    assert_eq!(
        changes.iter().map(|c| (c.id.0, c.kind)).collect::<Vec<_>>(),
        [(0, ObjectChangeKind::Forgotten), (2, ObjectChangeKind::Appeared)]
    );
}

#[test]
fn unusable_observations_and_parameters_do_no_harm() {
    let mut t = tracker();
    let mut bad = [chair(0.0, 0.0); 6];
    bad[0].bbox.size.x = f64::NAN;
    bad[1].bbox.size.y = 0.0;
    bad[2].confidence = 1.5;
    bad[4].bbox.size.x = 1e200;
    bad[5].bbox.t_frame_box.translation.vector.x = -1e300;
    bad[3].bbox.t_frame_box.translation.vector.z = f64::INFINITY;
    for i in 0..3 {
        assert!(t.update(at(i), &bad, &hidden).is_empty());
    }
    let bad = TrackerParams { min_iou: f64::NAN, ..TrackerParams::default() };
    assert!(matches!(Tracker::new(bad), Err(SceneError::InvalidParam { field: "min_iou", .. })));
    // Repeated and reversed stamps: no velocity comes of them.
    for stamp in [at(5), at(5), at(4), at(4)] {
        t.update(stamp, &[chair(0.0, 0.0)], &hidden);
    }
    assert_eq!((object(&t, 0).last_seen, object(&t, 0).state), (at(5), ObjectState::Static));
}

fn observations() -> impl Strategy<Value = Observation> {
    let numbers = (prop::array::uniform3(0.0..4.0f64), prop::array::uniform3(0.2..1.5f64), -3.0..3.0f64);
    (numbers, 0usize..7, 0.0..1.0f64, 0usize..2000).prop_map(|((center, size, yaw), class, confidence, num_points)| {
        let bbox = OrientedBox3::upright(Point3::from(center), Vector3::from(size), yaw);
        Observation {
            class: ObjectClass::BUILT_IN[class],
            confidence,
            bbox,
            num_points,
            is_moving: false,
            is_seen: true,
        }
    })
}

proptest! {
    #[test]
    fn the_order_of_detections_does_not_matter(
        frames in prop::collection::vec(prop::collection::vec(observations(), 0..8), 1..12),
        rotate in 0usize..8,
    ) {
        let (mut a, mut b) = (tracker(), tracker());
        // A place is seen through or not by where it is.
        let look = |b: &OrientedBox3| match (b.center().x * 7.0) as i64 % 3 {
            0 => Visibility::SeenThrough,
            1 => Visibility::Occupied,
            _ => Visibility::Unseen,
        };
        let mut ever = std::collections::BTreeSet::new();
        for (i, frame) in frames.iter().enumerate() {
            let mut other = frame.clone();
            other.reverse();
            let by = rotate.min(other.len());
            other.rotate_left(by);
            let changes = a.update(at(i as i64), frame, &look);
            prop_assert_eq!(&changes, &b.update(at(i as i64), &other, &look));
            for c in changes.iter().filter(|c| c.kind == ObjectChangeKind::Appeared) {
                prop_assert!(ever.insert(c.id), "an identity was given twice");
            }
            let objects = a.objects();
            prop_assert_eq!(&objects, &b.objects());
            for o in &objects {
                prop_assert!(ever.contains(&o.id));
                prop_assert!(o.bbox.center().iter().chain(o.bbox.size.iter()).all(|v| v.is_finite()));
                prop_assert!(o.bbox.size.min() > 0.0 && o.confidence > 0.0 && o.confidence <= 1.0);
                prop_assert!(o.first_seen <= o.last_seen);
            }
        }
    }

    #[test]
    fn noise_does_not_tear_resting_objects_apart(noise in prop::collection::vec(prop::array::uniform4(-0.05..0.05f64), 40)) {
        let mut t = tracker();
        for (i, n) in noise.iter().enumerate() {
            t.update(at(i as i64), &[chair(n[0], n[1]), chair(0.8 + n[2], n[3])], &hidden);
        }
        prop_assert_eq!(t.objects().len(), 2);
        prop_assert!(t.objects().iter().all(|o| o.state == ObjectState::Static));
        prop_assert!(object(&t, 0).bbox.center().x.abs() < 0.06);
        prop_assert!((object(&t, 1).bbox.center().x - 0.8).abs() < 0.06);
    }
}

#[test]
fn who_was_seen_to_move_is_moving_at_once_and_gone_once_out_of_sight() {
    let mut tracker = Tracker::new(TrackerParams::default()).unwrap();
    let at = |s: f64| Timestamp((s * 1e9) as i64);
    let walking = |x: f64| Observation { is_moving: true, ..person(x, 0.0) };
    for i in 0..4 {
        tracker
            .update(at(0.4 * f64::from(i)), &[walking(0.4 * f64::from(i)), chair(5.0, 5.0)], &|_| Visibility::Unseen);
    }
    let moving = tracker.objects();
    assert_eq!(moving.iter().filter(|o| o.state == ObjectState::Moving).count(), 1, "{moving:?}");
    // The robot looks elsewhere: neither is seen, nor seen through.
    let changes = tracker.update(at(5.0), &[], &|_| Visibility::Unseen);
    assert_eq!(changes.iter().filter(|c| c.kind == ObjectChangeKind::Gone).count(), 1);
    let states: Vec<ObjectState> = tracker.objects().iter().map(|o| o.state).collect();
    assert!(states.contains(&ObjectState::Static) && states.contains(&ObjectState::Gone), "{states:?}");
    // Who stands still is no longer moving.
    let mut tracker = Tracker::new(TrackerParams::default()).unwrap();
    tracker.update(at(0.0), &[walking(0.0)], &|_| Visibility::Unseen);
    for i in 1..10 {
        tracker.update(at(0.5 * f64::from(i)), &[person(0.1, 0.0)], &|_| Visibility::Unseen);
    }
    assert_eq!(tracker.objects()[0].state, ObjectState::Static);
}

/// A walk along x at 1.2 m/s, a frame each fifth of a second, past a chair that keyframes show each second.
fn walk(t: &mut Tracker, steps: std::ops::Range<i64>, is_seen: impl Fn(i64) -> bool) {
    for i in steps {
        let stamp = at(2 * i);
        let seen: Vec<Observation> = is_seen(i).then(|| person(0.24 * i as f64, 0.0)).into_iter().collect();
        t.update_passing(stamp, &seen, &hidden);
        if i % 5 == 0 {
            // Keyframes may show the person as well.
            t.update(stamp, &[chair(2.0, 1.0), person(0.24 * i as f64, 0.1)], &hidden);
        }
    }
}

#[test]
fn who_walks_by_is_one_person_with_a_velocity_and_gone_afterwards() {
    let mut t = tracker();
    walk(&mut t, 0..26, |_| true);
    let people: Vec<Object> = t.objects().into_iter().filter(|o| o.class == ObjectClass::Person).collect();
    let [walker] = &people[..] else { panic!("{people:?}") };
    assert_eq!(walker.state, ObjectState::Moving);
    assert!((walker.velocity_mps - Vector3::new(1.2, 0.0, 0.0)).norm() < 0.2, "{:?}", walker.velocity_mps);
    assert!(walker.velocity_variance > 0.0 && walker.velocity_variance < 1.0);
    assert!((walker.bbox.center().x - 6.0).abs() < 0.1);
    // Hidden for a second behind a pillar: the same person.
    walk(&mut t, 26..40, |i| i >= 31);
    assert_eq!(t.objects().iter().filter(|o| o.class == ObjectClass::Person).count(), 1);
    // For four seconds behind a wall: the only one who may have come out there.
    walk(&mut t, 40..70, |i| i >= 60);
    let people: Vec<u64> = t.objects().iter().filter(|o| o.class == ObjectClass::Person).map(|o| o.id.0).collect();
    assert_eq!(people, [walker.id.0]);
    // Out of the door.
    walk(&mut t, 70..90, |_| false);
    assert_eq!(object(&t, walker.id.0).state, ObjectState::Gone);
    assert_eq!(t.objects().iter().filter(|o| o.state != ObjectState::Gone).count(), 1, "the chair");
}

#[test]
fn two_people_who_cross_stay_who_they_are() {
    let mut t = tracker();
    for i in 0..30 {
        let x = 0.24 * i as f64;
        t.update_passing(at(2 * i), &[person(x, 0.4), person(7.0 - x, -0.4)], &hidden);
    }
    let velocity = |id: u64| object(&t, id).velocity_mps.x;
    let ids: Vec<u64> = t.objects().iter().map(|o| o.id.0).collect();
    assert_eq!(ids.len(), 2);
    let (right, left) = if velocity(ids[0]) > 0.0 { (ids[0], ids[1]) } else { (ids[1], ids[0]) };
    assert!(
        (object(&t, right).bbox.center().x - 6.96).abs() < 0.1 && (object(&t, left).bbox.center().x - 0.04).abs() < 0.1
    );
    assert!(velocity(right) > 0.9 && velocity(left) < -0.9);
}

#[test]
fn what_never_moves_in_free_space_is_not_told() {
    let mut t = tracker();
    for i in 0..100 {
        let jitter = 0.03 * (i % 3) as f64;
        assert!(
            t.update_passing(at(2 * i), &[seen_as(ObjectClass::Unknown, [1.0 + jitter, 2.0, 0.4], [0.3; 3])], &hidden)
                .is_empty()
        );
    }
    assert!(t.has_passing());
    for i in 100..110 {
        t.update_passing(at(2 * i), &[], &hidden);
    }
    assert!(!t.has_passing() && t.objects().is_empty());
}

#[test]
fn who_stands_sets_off_and_comes_to_rest_is_one_person_with_a_past() {
    let mut t = tracker();
    let stand = |t: &mut Tracker, steps: std::ops::Range<i64>, x: f64| {
        for i in steps {
            t.update_passing(at(2 * i), &[person(x, 0.0)], &hidden);
            if i % 5 == 0 {
                t.update(at(2 * i), &[person(x, 0.0)], &hidden);
            }
        }
    };
    for i in 0..3 {
        t.update(at(2 * i), &[person(0.0, 0.0)], &hidden);
    }
    stand(&mut t, 3..10, 0.0);
    for i in 10..20 {
        t.update_passing(at(2 * i), &[person(0.24 * (i - 10) as f64, 0.0)], &hidden);
    }
    assert_eq!(object(&t, 0).state, ObjectState::Moving);
    stand(&mut t, 20..45, 2.16);
    let now = object(&t, 0);
    assert_eq!((now.state, t.objects().len()), (ObjectState::Static, 1));
    assert!((now.bbox.center().x - 2.16).abs() < 0.05);
    assert!(now.at(at(4)).unwrap().bbox.center().x.abs() < 0.05);
    assert_eq!(now.at(at(34)).unwrap().state, ObjectState::Moving);
}
