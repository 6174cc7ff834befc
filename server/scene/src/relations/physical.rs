//! What rests on what, is in it, under it, over it.

use super::{Placed, Relation, RelationFrame, RelationKind, RelationParams};
use crate::overlap;
use percept_geometry::ObjectClass;

/// Share of the smaller footprint from which one thing stands under another: a chair that is pushed in by a third.
const UNDER: f64 = 0.3;

/// The relations of two things that share ground, both ways; none if neither holds the other, or is over it.
pub(crate) fn stacked(a: &Placed, b: &Placed, params: &RelationParams) -> Vec<Relation> {
    for (subject, object) in [(a, b), (b, a)] {
        let found = one_way(subject, object, params);
        if !found.is_empty() {
            return found;
        }
    }
    vec![]
}

fn one_way(subject: &Placed, object: &Placed, params: &RelationParams) -> Vec<Relation> {
    let distance_m = overlap::gap(&subject.bbox, &object.bbox);
    let relation = |subject: &Placed, kind, object: &Placed, strength: f64| {
        let frame = if kind == RelationKind::Inside { RelationFrame::Any } else { RelationFrame::Gravity };
        let (subject, object) = (subject.id, object.id);
        Relation { subject, kind, object, frame, strength: strength.min(1.0), distance_m, stamp: None }
    };
    let shared = overlap::shared_footprint(&subject.bbox, &object.bbox);
    if shared <= 0.0 {
        return vec![];
    }
    let (bottom, top) = overlap::z_range(&subject.bbox);
    let (_, object_top) = overlap::z_range(&object.bbox);
    let share = shared / overlap::footprint_area(&subject.bbox).min(overlap::footprint_area(&object.bbox));
    let height = bottom - object_top;
    if height.abs() <= params.contact_m {
        let contact = 1.0 - height.abs() / params.contact_m;
        let strength = shared / overlap::footprint_area(&subject.bbox) * contact;
        let on = relation(subject, RelationKind::On, object, strength);
        return vec![on, relation(object, RelationKind::Supports, subject, strength)];
    }
    if height > 0.0 {
        let strength = share * (1.0 - distance_m / params.max_distance_m);
        let above = relation(subject, RelationKind::Above, object, strength);
        return vec![above, relation(object, RelationKind::Below, subject, strength)];
    }
    let inside = 2.0 * overlap::share_of(&subject.bbox, &object.bbox) - 1.0;
    match room_in(object.class) {
        RoomIn::Within if inside > 0.0 && subject.bbox.volume() < object.bbox.volume() => {
            vec![relation(subject, RelationKind::Inside, object, inside)]
        }
        RoomIn::Beneath if share >= UNDER && top < object_top + params.contact_m && subject.class != object.class => {
            vec![relation(subject, RelationKind::Under, object, share)]
        }
        _ => vec![],
    }
}

/// Where there is room in a thing's box for another thing.
enum RoomIn {
    /// Between its sides.
    Within,
    /// Between its legs.
    Beneath,
    Nowhere,
}

fn room_in(class: Option<ObjectClass>) -> RoomIn {
    match class {
        Some(ObjectClass::Shelf | ObjectClass::Box | ObjectClass::Unknown) => RoomIn::Within,
        Some(ObjectClass::Table) => RoomIn::Beneath,
        _ => RoomIn::Nowhere,
    }
}
