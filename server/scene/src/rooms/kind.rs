//! What a room's shape says.

/// Rooms by their shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum RoomKind {
    /// As wide as long, or nearly.
    Room,
    /// Long and narrow: it leads from room to room.
    Corridor,
}

/// A corridor is at least so many times as long as wide, and at most so wide, metres: walkways of offices are 1.2 to 2.4 m wide, those
/// of hospitals and schools up to 3 m.
const LONG: f64 = 3.0;
const WIDEST_M: f64 = 3.2;

impl RoomKind {
    /// By area, and by the radius of the largest circle that fits, metres: a bend does not matter.
    pub(super) fn of_shape(area_m2: f64, radius_m: f64) -> Self {
        let width = 2.0 * radius_m;
        if width <= WIDEST_M && area_m2 >= LONG * width * width { Self::Corridor } else { Self::Room }
    }

    /// Lower-case name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Room => "room",
            Self::Corridor => "corridor",
        }
    }
}
