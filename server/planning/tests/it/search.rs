//! The search on cells, where there is nothing to find.

use percept_geometry::Cell;
use percept_planning::{GridPath, shortest_path};

#[test]
fn a_path_is_refused_where_ends_are_blocked_or_outside() {
    let blocked = [false, true, false, false];
    let free = Cell::new(0, 0);
    for goal in [Cell::new(1, 0), Cell::new(2, 0), Cell::new(0, -1)] {
        let found = shortest_path(&blocked, 2, 2, free, goal, 10);
        assert_eq!(found, GridPath::Unreachable { expansions: 0 });
    }
    // No cutting of corners: around, not across.
    let GridPath::Found { cost, .. } = shortest_path(&blocked, 2, 2, free, Cell::new(1, 1), 10) else { panic!() };
    assert_eq!(cost, 2.0);
    assert_eq!(shortest_path(&blocked, 3, 2, free, free, 10), GridPath::Unreachable { expansions: 0 });
}
