//! What placing a depth image finds beside its pose.

use super::frame::Frame;
use super::moving::Moving;
use super::surfels::View;
use percept_geometry::Covariance6;
use std::sync::Arc;

/// The model as it was seen from where a frame was expected, and the frame in it.
#[derive(Debug)]
pub(crate) struct ViewFound {
    pub(super) view: View,
    /// With what moves by itself marked as not valid.
    pub(super) frame: Arc<Frame>,
    pub(super) moving: Moving,
    /// Of where the frame was placed, right perturbation in the camera.
    pub(super) covariance: Covariance6,
}
