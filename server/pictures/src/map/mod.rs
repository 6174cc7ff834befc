//! Layers that lie flat, seen from above: grids of occupancy, heights and traversability, and what is drawn over them.

mod before_after;
mod cells;
mod grid;
mod heights;
mod labels;
mod overview;
mod path;
mod traversability;
mod zones;

pub use before_after::{Changes, before_after};
pub use grid::GridView;
pub(crate) use grid::check_shape;
pub use heights::heights;
pub use overview::{MapObject, MapRoom, Overlay, occupancy, overview};
pub(crate) use overview::{grid_legend, open_grid};
pub use path::{PathDrawing, PathEnd, PathQuantity, path_picture};
pub use traversability::traversability;
pub use zones::{Zone, ZoneKind, ZoneMask};

pub(crate) use cells::{Block, CellLayout};
