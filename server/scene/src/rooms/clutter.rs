//! A level without what stands in its rooms.

use super::cleared::{Cleared, Kind};
use super::{Floor, RoomParams};
use percept_geometry::{OrientedBox3, clearance_in_cells};

/// Holes in what is known, up to this large, are floor if free cells surround them, square metres: under a table, behind a chair.
const HOLE_M2: f64 = 1.0;
/// Cells around a thing's box that still are it: what it is made of lies in its sides.
const SIDES_CELLS: f64 = 1.0;

/// What stands no farther apart than this is one, metres.
const JOINED_M: f64 = 0.25;

/// Strips of floor narrower than this, between what is not known, are what single beams showed, metres.
const GLIMPSE_M: f64 = 0.5;

/// Takes furniture out: known things that hardly stand at walls, and what stands free and is small.
pub(super) fn cleared(floor: &Floor<'_>, things: &[OrientedBox3], params: &RoomParams) -> Cleared {
    let mut is_thing = vec![false; floor.cells.len()];
    let grown = SIDES_CELLS * floor.resolution_m();
    things.iter().flat_map(|t| floor.under(t, grown)).for_each(|i| is_thing[i] = true);
    let mut kinds: Vec<Kind> = (0..floor.cells.len())
        .map(|i| match () {
            () if floor.is_free(i) => Kind::Open,
            () if floor.is_occupied(i) && is_thing[i] => Kind::Thing,
            () if floor.is_occupied(i) => Kind::Wall,
            () => Kind::Unknown,
        })
        .collect();
    // What mostly is things is without them what is left: a wall between four doors, with shelves along it, is one.
    for part in standing_parts(floor, &kinds) {
        let is_thing = |i: &&usize| kinds[**i] == Kind::Thing;
        if 2 * part.iter().filter(is_thing).count() > part.len() {
            let things: Vec<usize> = part.iter().filter(is_thing).copied().collect();
            things.into_iter().for_each(|i| kinds[i] = Kind::Open);
        }
    }
    for part in standing_parts(floor, &kinds) {
        if extent_m(floor, &part) <= params.furniture_max_m {
            part.into_iter().for_each(|i| kinds[i] = Kind::Open);
        }
    }
    let around = floor.around();
    let unknown: Vec<bool> = kinds.iter().map(|k| *k == Kind::Unknown).collect();
    let largest = (HOLE_M2 / floor.resolution_m().powi(2)) as usize;
    for part in around.parts(&unknown) {
        let rim = || part.iter().flat_map(|i| around.four(*i)).filter(|j| !unknown[*j]);
        let open = rim().filter(|j| kinds[*j] == Kind::Open).count();
        if part.len() <= largest && 2 * open > rim().count() {
            part.iter().for_each(|i| kinds[*i] = Kind::Open);
        }
    }
    let mut cleared = Cleared { kinds };
    forget_glimpses(&mut cleared, floor);
    cleared
}

/// What single beams showed through gaps, glass and doors ajar is not known to be floor.
fn forget_glimpses(cleared: &mut Cleared, floor: &Floor<'_>) {
    let clearance = clearance_in_cells(&cleared.closed(), floor.width, floor.height);
    let half = 0.5 * GLIMPSE_M / floor.resolution_m();
    let is_wide: Vec<bool> = clearance.iter().map(|c| f64::from(*c) >= half).collect();
    let around = floor.around();
    // A corner of a room lies farther from the circle that fits into it.
    let kept = around.grown(&is_wide, (1.5 * half).ceil() as usize);
    let narrow: Vec<bool> = (0..kept.len()).map(|i| cleared.is_open(i) && !kept[i]).collect();
    for part in around.parts(&narrow) {
        let rim = |kind: Kind| part.iter().flat_map(|i| around.four(*i)).filter(|j| cleared.kinds[*j] == kind).count();
        if rim(Kind::Unknown) > rim(Kind::Wall) + rim(Kind::Thing) {
            part.iter().for_each(|i| cleared.kinds[*i] = Kind::Unknown);
        }
    }
}

/// What stands, in parts that are one. A wall that was seen from afar is a row of dots.
fn standing_parts(floor: &Floor<'_>, kinds: &[Kind]) -> Vec<Vec<usize>> {
    let around = floor.around();
    let standing: Vec<bool> = kinds.iter().map(|k| matches!(k, Kind::Wall | Kind::Thing)).collect();
    let grown = around.grown(&standing, (0.5 * JOINED_M / floor.resolution_m()).round() as usize);
    let mut parts = around.parts(&grown);
    parts.iter_mut().for_each(|part| part.retain(|i| standing[*i]));
    parts
}

/// Diagonal of the rectangle around cells, metres.
fn extent_m(floor: &Floor<'_>, cells: &[usize]) -> f64 {
    let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
    for i in cells {
        for (axis, v) in [i % floor.width, i / floor.width].into_iter().enumerate() {
            (low[axis], high[axis]) = (low[axis].min(v), high[axis].max(v));
        }
    }
    let side = |axis: usize| (high[axis] + 1 - low[axis]) as f64 * floor.resolution_m();
    side(0).hypot(side(1))
}
