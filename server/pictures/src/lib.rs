//! Pictures of maps for people: map data in, images out.
//!
//! Comes in: grids, heights, meshes, clouds and voxels of `mapping`, and what is drawn over them. Goes out: an
//! [`RgbImage`], which [`encode_png`] makes a file of. A picture says by itself what it shows: it has a
//! title, size and resolution, a scale bar, the axes of the map frame (x to the right and y up where it is seen from above), and a
//! legend of what is really in it. The same input gives the same bytes, whatever the number of threads. No clock, no files, no
//! search: what is drawn is what was given.
//!
//! Background is white, text dark; colours are chosen so that people with any colour vision tell them apart (`colors.rs`).
//! A drawing has at least 900 pixels along its longer edge, a picture at most [`MAX_EDGE`]. Start with [`overview`].

mod canvas;
mod colors;
mod error;
mod image;
mod map;
mod panels;
mod sheet;
mod space;
mod text;

pub use error::PictureError;
pub use image::{ImageThing, things_in_image};
pub use map::{
    Changes, GridView, MapObject, MapRoom, Overlay, PathDrawing, PathEnd, PathQuantity, Zone, ZoneKind, ZoneMask,
    before_after, heights, occupancy, overview, path_picture, traversability,
};
pub use panels::side_by_side;
pub use space::{View, ViewFrom, cloud_view, mesh_view, voxels_slice, voxels_view};

use percept_geometry::RgbImage;

/// The longest edge of a picture, pixels.
pub const MAX_EDGE: usize = 4096;

/// The most cells of a grid that are looked at: 16384 x 16384.
pub const MAX_CELLS: usize = 1 << 28;

/// A picture as a PNG.
///
/// # Errors
/// `Encode`.
pub fn encode_png(image: &RgbImage) -> Result<Vec<u8>, PictureError> {
    percept_formats::images::encode_rgb_png(image).map_err(|e| PictureError::Encode(e.to_string()))
}
