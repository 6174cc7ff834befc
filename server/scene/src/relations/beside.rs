//! What stands next to what, and near: in one room, in sight of each other.

use super::{Placed, Relation, RelationFrame, RelationKind, RelationParams};
use crate::overlap;
use crate::rooms::Rooms;
use std::collections::{BTreeMap, BTreeSet};

/// Relations of things that stand beside each other. `pairs` are places in `things` of those within reach of each other; `is_stacked`
/// tells of a pair that shares ground in another way, and says more.
pub(crate) fn beside(
    things: &[Placed],
    pairs: &[(usize, usize)],
    is_stacked: impl Fn(usize, usize) -> bool,
    rooms: &Rooms,
    params: &RelationParams,
) -> Vec<Relation> {
    let mut near = BTreeMap::<usize, Vec<(f64, usize)>>::new();
    for (a, b) in pairs.iter().copied().filter(|(a, b)| !is_stacked(*a, *b)) {
        let (one, other) = (&things[a], &things[b]);
        let gap = overlap::gap(&one.bbox, &other.bbox);
        let is_elsewhere = one.room.is_some() && other.room.is_some() && one.room != other.room;
        if gap > params.max_distance_m || is_elsewhere || !rooms.is_open_between(&one.bbox, &other.bbox) {
            continue;
        }
        near.entry(a).or_default().push((gap, b));
        near.entry(b).or_default().push((gap, a));
    }
    let mut listed = BTreeSet::new();
    for (a, others) in &mut near {
        others.sort_by(|p, q| p.0.total_cmp(&q.0).then(things[p.1].id.cmp(&things[q.1].id)));
        listed.extend(others.iter().take(params.num_near).map(|(_, b)| (*a.min(b), *a.max(b))));
    }
    let relation = |(a, b): &(usize, usize)| {
        let (a, b) = (&things[*a], &things[*b]);
        let distance_m = overlap::gap(&a.bbox, &b.bbox);
        let kind = if distance_m <= params.next_to_m { RelationKind::NextTo } else { RelationKind::Near };
        let (subject, object) = (a.id.min(b.id), a.id.max(b.id));
        let strength = 1.0 - distance_m / params.max_distance_m;
        Relation { subject, kind, object, frame: RelationFrame::Any, strength, distance_m, stamp: None }
    };
    listed.iter().map(relation).collect()
}
