//! What people say of objects outlives what is detected, and can be taken back; what was is remembered.

use crate::tracking::{at, chair, hidden, object, seen_as, tracker};
use nalgebra::{Point3, Vector3};
use percept_geometry::{ObjectClass, OrientedBox3, Pose, se3};
use percept_scene::{
    Correction, CorrectionError, Object, ObjectChangeKind, ObjectId, ObjectState, Tracker, TrackerParams, Visibility,
};

fn plant() -> ObjectClass {
    ObjectClass::parse("plant").unwrap()
}

/// A chair (0) and a table (1), seen for half a second.
fn room() -> Tracker {
    let mut t = tracker();
    see(&mut t, 0, 5);
    t
}

fn see(t: &mut Tracker, from: i64, to: i64) {
    let table = seen_as(ObjectClass::Table, [4.0, 2.0, 0.4], [1.6, 0.8, 0.8]);
    for i in from..to {
        t.update(at(i), &[chair(1.0, 2.0), table], &hidden);
    }
}

/// As a server that was started again has them.
fn restored(t: &Tracker) -> Tracker {
    let stored = serde_json::to_string(&t.objects()).unwrap();
    let objects: Vec<Object> = serde_json::from_str(&stored).unwrap();
    Tracker::restore(TrackerParams::default(), &objects, t.next_id()).unwrap()
}

fn ids(t: &Tracker) -> Vec<u64> {
    t.listed().iter().map(|o| o.id.0).collect()
}

#[test]
fn a_class_that_a_person_gave_stays_whatever_is_detected() {
    let mut t = room();
    let changes = t.annotate(ObjectId(0), Correction::Class(Some(plant()))).unwrap();
    let to = ObjectChangeKind::Reclassified { from: ObjectClass::Chair, to: plant() };
    assert_eq!((changes.len(), changes[0].kind), (1, to));
    for t in [&mut t.clone(), &mut restored(&t)] {
        see(t, 5, 50);
        let o = object(t, 0);
        assert_eq!((o.class, o.confidence), (plant(), 1.0));
        assert_eq!(o.class_probabilities[0].0, ObjectClass::Chair, "what the machine thinks is kept beside it");
        t.annotate(ObjectId(0), Correction::Class(None)).unwrap();
        assert_eq!(object(t, 0).class, ObjectClass::Chair);
        assert!(object(t, 0).annotation.is_empty());
    }
}

#[test]
fn what_is_deleted_is_not_told_again_until_its_place_was_empty() {
    let mut t = room();
    let changes = t.annotate(ObjectId(0), Correction::Delete).unwrap();
    assert_eq!((changes[0].id, changes[0].kind), (ObjectId(0), ObjectChangeKind::Forgotten));
    let mut t = restored(&t);
    for i in 5..50 {
        assert!(t.update(at(i), &[chair(1.0, 2.0)], &hidden).is_empty());
    }
    assert_eq!(ids(&t), [1]);
    // Taken back.
    let mut undone = t.clone();
    undone.annotate(ObjectId(0), Correction::Restore).unwrap();
    assert_eq!(ids(&undone), [0, 1]);
    // Its place is seen through, and another chair is put there.
    let empty = |b: &OrientedBox3| if b.center().x < 2.0 { Visibility::SeenThrough } else { Visibility::Unseen };
    for i in 50..80 {
        assert!(t.update(at(i), &[], &empty).is_empty(), "nobody hears of what they deleted");
    }
    t.update(at(80), &[chair(1.0, 2.0)], &hidden);
    t.update(at(81), &[chair(1.0, 2.0)], &hidden);
    assert_eq!(ids(&t), [1, 2]);
}

#[test]
fn parts_are_told_within_their_whole() {
    let mut t = room();
    let changes = t.annotate(ObjectId(1), Correction::PartOf(ObjectId(0))).unwrap();
    assert_eq!(changes[1].kind, ObjectChangeKind::Merged { into: ObjectId(0) });
    let mut t = restored(&t);
    see(&mut t, 5, 30);
    let [whole] = &t.listed()[..] else { panic!("{:?}", t.listed()) };
    let corners = whole.bbox.corners();
    let (low, high) = corners.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p.x), h.max(p.x)));
    assert!((low - 0.75).abs() < 1e-6 && (high - 4.8).abs() < 1e-6, "{low} {high}");
    assert!((object(&t, 0).bbox.size.x - 0.5).abs() < 1e-6, "what is stored of it is its own box");
    t.annotate(ObjectId(1), Correction::Restore).unwrap();
    assert_eq!(ids(&t), [0, 1]);
    // Parts of what becomes a part go with it, and are free when it is deleted.
    see(&mut t, 30, 31);
    t.annotate(ObjectId(1), Correction::PartOf(ObjectId(0))).unwrap();
    t.annotate(ObjectId(0), Correction::Delete).unwrap();
    assert_eq!(ids(&t), [1]);
}

#[test]
fn a_thing_that_is_two_stays_two() {
    let mut t = room();
    let half = |x: f64| OrientedBox3::upright(Point3::new(x, 2.0, 0.4), Vector3::new(0.8, 0.8, 0.8), 0.0);
    let changes = t.annotate(ObjectId(1), Correction::Split(vec![half(3.6), half(4.4)])).unwrap();
    assert_eq!(changes.iter().map(|c| c.id.0).collect::<Vec<_>>(), [1, 2, 3]);
    let refuted = |_: &OrientedBox3| Visibility::Refuted;
    let mut t = restored(&t);
    for i in 5..60 {
        // Seen as one, and searched for in vain.
        t.update(at(i), &[seen_as(ObjectClass::Table, [4.0, 2.0, 0.4], [1.6, 0.8, 0.8])], &refuted);
    }
    let listed = t.listed();
    let pieces: Vec<_> = listed.iter().filter(|o| o.annotation.is_drawn).collect();
    assert_eq!(pieces.iter().map(|o| (o.id.0, o.class)).collect::<Vec<_>>(), [2, 3].map(|i| (i, ObjectClass::Table)));
    assert!((pieces[1].bbox.center().x - 4.4).abs() < 1e-9);
    assert!(!listed.iter().any(|o| o.id.0 == 1));
}

#[test]
fn what_was_split_is_one_again_when_it_is_restored() {
    let mut t = room();
    let half = |x: f64| OrientedBox3::upright(Point3::new(x, 2.0, 0.4), Vector3::new(0.8, 0.8, 0.8), 0.0);
    let before = ids(&t);
    t.annotate(ObjectId(1), Correction::Split(vec![half(3.6), half(4.4)])).unwrap();
    // A piece that was split itself, and one that another thing was made a part of.
    t.annotate(ObjectId(2), Correction::Split(vec![half(3.4), half(3.8)])).unwrap();
    t.annotate(ObjectId(0), Correction::PartOf(ObjectId(3))).unwrap();
    let mut t = restored(&t);
    let changes = t.annotate(ObjectId(1), Correction::Restore).unwrap();
    assert_eq!(changes.iter().map(|c| c.id.0).collect::<Vec<_>>(), [1, 3, 4, 5]);
    assert_eq!(ids(&t), before);
    for i in 5..10 {
        see(&mut t, i, i + 1);
    }
    assert_eq!(ids(&t), before);
    // Deleting it and bringing it back afterwards is as ever.
    t.annotate(ObjectId(1), Correction::Delete).unwrap();
    t.annotate(ObjectId(1), Correction::Restore).unwrap();
    assert_eq!(ids(&t), before);
}

#[test]
fn what_cannot_be_is_refused_and_nothing_changes() {
    let mut t = room();
    let (zero, one) = (ObjectId(0), ObjectId(1));
    let before = t.objects();
    let boxed = |size: f64| OrientedBox3::upright(Point3::origin(), Vector3::repeat(size), 0.0);
    let lost = OrientedBox3::upright(Point3::new(f64::NAN, 0.0, 0.0), Vector3::repeat(1.0), 0.0);
    for (id, correction, why) in [
        (ObjectId(9), Correction::Delete, CorrectionError::Unknown(ObjectId(9))),
        (zero, Correction::PartOf(zero), CorrectionError::PartOfItself(zero)),
        (zero, Correction::PartOf(ObjectId(7)), CorrectionError::Unknown(ObjectId(7))),
        (zero, Correction::Split(vec![boxed(1.0)]), CorrectionError::Pieces(1)),
        (zero, Correction::Split(vec![boxed(1.0); 17]), CorrectionError::Pieces(17)),
        (zero, Correction::Split(vec![boxed(1.0), boxed(0.0)]), CorrectionError::Box(1)),
        (zero, Correction::Split(vec![lost, boxed(1.0)]), CorrectionError::Box(0)),
    ] {
        assert_eq!(t.annotate(id, correction), Err(why));
    }
    let inside = t.objects()[0].bbox;
    let away = OrientedBox3::upright(inside.center() + Vector3::new(500.0, 0.0, 0.0), Vector3::repeat(0.2), 0.0);
    let apart = t.annotate(zero, Correction::Split(vec![inside, away]));
    assert!(matches!(apart, Err(CorrectionError::Elsewhere { index: 1, off_m }) if off_m > 490.0), "{apart:?}");
    t.annotate(one, Correction::Delete).unwrap();
    assert_eq!(t.annotate(zero, Correction::PartOf(one)), Err(CorrectionError::NoWhole(one)));
    let halves = || Correction::Split(vec![boxed(1.0); 2]);
    assert_eq!(t.annotate(one, halves()), Err(CorrectionError::Deleted(one)), "what is no thing has no pieces");
    t.annotate(one, Correction::Restore).unwrap();
    assert_eq!(t.objects(), before);
}

#[test]
fn what_was_at_a_time_is_remembered_and_moves_with_the_map() {
    let mut t = room();
    // The chair is carried away at 1 s, to stand 3 m further from 2 s on.
    let empty = |b: &OrientedBox3| if b.center().x < 1.5 { Visibility::SeenThrough } else { Visibility::Unseen };
    for i in 10..30 {
        t.update(at(i), &[], &empty);
    }
    for i in 30..40 {
        t.update(at(i), &[chair(1.0, 2.0)], &hidden);
    }
    let chair_now = object(&t, 0);
    assert_eq!(chair_now.state, ObjectState::Static);
    assert_eq!(chair_now.at(at(4)).unwrap().state, ObjectState::Static);
    assert_eq!(chair_now.at(at(25)).unwrap().state, ObjectState::Gone);
    assert_eq!(chair_now.at(at(35)).unwrap(), chair_now);
    assert!(chair_now.at(at(-1)).is_none());
    // What is said of it now was not said then.
    let mut said = t.clone();
    said.annotate(ObjectId(0), Correction::Class(Some(plant()))).unwrap();
    let then = object(&said, 0).at(at(4)).unwrap();
    assert_eq!((then.class, then.annotation.class), (ObjectClass::Chair, None));
    assert!((0.5..1.0).contains(&then.confidence), "{}", then.confidence);
    let t_new_old = se3::from_xy_yaw(1.0, 0.0, 0.0);
    t.correct(&|_, _| t_new_old);
    assert!((object(&t, 0).at(at(4)).unwrap().bbox.center().x - 2.0).abs() < 1e-9);
    assert_eq!(restored(&t).objects(), t.objects());
    t.correct(&|_, _| Pose::identity());
}

#[test]
fn objects_of_earlier_versions_are_read() {
    let stored = r#"{"id":3,"class":"table","confidence":0.9,"class_probabilities":[0.01,0.9,0.05,0.01,0.01,0.01,0.01],
        "bbox":{"t_frame_box":{"rotation":[0,0,0,1],"translation":[1,2,0.4]},"size":[1.5,0.8,0.75]},"state":"static",
        "velocity_mps":[0,0,0],"first_seen":5,"last_seen":9,"observation_count":4,"num_points":300}"#;
    let object: Object = serde_json::from_str(stored).unwrap();
    assert_eq!(object.class_probabilities, [(ObjectClass::Table, 0.9), (ObjectClass::Chair, 0.05)]);
    let t = Tracker::restore(TrackerParams::default(), &[object], 4).unwrap();
    let known = &t.listed()[0];
    assert_eq!((known.class, known.history.len()), (ObjectClass::Table, 0));
    assert!((known.confidence - 0.9).abs() < 0.01);
    assert_eq!(known.at(percept_geometry::Timestamp(7)).unwrap().class, ObjectClass::Table);
}
