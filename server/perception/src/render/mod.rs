//! Pictures to look at: a cloud from above, from the front, from the side or in perspective, a depth image in colours.
//!
//! Comes in: a cloud or a depth image. Goes out: RGB pixels; files are made elsewhere. The view fits itself to where
//! nearly all points are, so that a few far ones do not shrink the rest; nearer points hide farther ones.

mod cloud;
mod colors;
mod depth;
mod view;

pub use cloud::{Coloring, RenderParams, render_cloud};
pub use depth::render_depth;
pub use view::View;
