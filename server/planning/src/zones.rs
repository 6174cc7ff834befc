//! Areas in which a robot may not be, or not be fast.

use crate::PlanError;
use crate::polygon::crosses;
use nalgebra::{Point2, Vector2};
use percept_mapping::DenseGrid;

/// What holds in a zone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ZoneKind {
    /// An obstacle: no part of the robot may enter.
    KeepOut,
    /// The base drives no faster there, and a metre counts as more in proportion.
    SpeedLimit {
        /// Share of `SpeedLimits::max_speed_mps`, above 0 and at most 1.
        share: f64,
    },
}

/// An area of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct Zone {
    /// Corners in order, map frame, metres; three or more. A cell is in it that it touches (`KeepOut`), or whose centre it
    /// holds (`SpeedLimit`).
    pub polygon: Vec<Point2<f64>>,
    /// What holds there.
    pub kind: ZoneKind,
}

/// What the values of a mask mean, as in nav2's costmap filters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MaskKind {
    /// Cells at or above `occupied_probability` are keep-out; others are not.
    KeepOut,
    /// Of a value from 1 to 100, `base + multiplier * value` is per cent of `SpeedLimits::max_speed_mps`. The value 0, unknown, and
    /// what comes to 0 or less or to 100 or more: no limit. What comes to less than 1 per cent counts as 1.
    SpeedLimit {
        /// Per cent at the value 0.
        base: f64,
        /// Per cent more for each step of the value.
        multiplier: f64,
    },
}

impl MaskKind {
    /// The value itself is per cent of full speed.
    pub const PERCENT: Self = Self::SpeedLimit { base: 0.0, multiplier: 1.0 };

    /// The share of full speed at a value of a speed mask; none: no limit.
    pub fn speed_share(&self, value: u8) -> Option<f64> {
        let Self::SpeedLimit { base, multiplier } = self else { return None };
        let percent = base + multiplier * f64::from(value);
        let limits = value > 0 && percent > 0.0 && percent < 100.0;
        limits.then_some((percent / 100.0).max(LEAST_SHARE))
    }
}

/// Zones as a grid of values, in the map frame: its cells need not lie on those of the map.
#[derive(Debug, Clone, Copy)]
pub struct Mask<'a> {
    /// Values, 0 to 100 or -1.
    pub grid: &'a DenseGrid,
    /// Their meaning.
    pub kind: MaskKind,
}

/// Slower than this share of full speed is refused: a zone that none should enter is a keep-out zone.
const LEAST_SHARE: f64 = 0.01;

impl Zone {
    /// The corners of the smallest box along the axes that holds it.
    pub(crate) fn bounds(&self) -> (Point2<f64>, Point2<f64>) {
        let corners = &self.polygon;
        let low = corners.iter().fold(corners[0], |low, c| low.inf(c));
        (low, corners.iter().fold(corners[0], |high, c| high.sup(c)))
    }

    /// Whether its edge touches the square of this size with its lowest corner at `low`.
    pub(crate) fn edge_touches(&self, low: &Point2<f64>, size: f64) -> bool {
        let (corners, size) = (&self.polygon, Vector2::repeat(size));
        let edge = |i: usize| (corners[i], corners[(i + 1) % corners.len()] - corners[i]);
        (0..corners.len()).map(edge).any(|(a, along)| crosses(&a, &along, low, &(low + size)))
    }

    /// Checks the polygon and the share.
    ///
    /// # Errors
    /// `InvalidParam`: `zones.polygon` (number of corners, or the coordinate that is not finite), `zones.share`.
    pub fn validate(&self) -> Result<(), PlanError> {
        let refuse = |field, value, remedy| Err(PlanError::InvalidParam { field, value, remedy });
        if self.polygon.len() < 3 || self.polygon.len() > 10_000 {
            return refuse("zones.polygon", self.polygon.len() as f64, "give 3 to 10000 corners");
        }
        if let Some(bad) = self.polygon.iter().flat_map(|c| c.iter()).find(|v| !v.is_finite()) {
            return refuse("zones.polygon", *bad, "give finite coordinates in metres");
        }
        match self.kind {
            ZoneKind::SpeedLimit { share } if !(LEAST_SHARE..=1.0).contains(&share) => {
                refuse("zones.share", share, "choose 0.01 to 1")
            }
            _ => Ok(()),
        }
    }
}
