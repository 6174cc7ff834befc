//! How to cover.

use crate::PlanError;

/// Which way lanes lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CoverageDirection {
    /// The one of the two below that gives the shorter path.
    #[default]
    Shorter,
    /// Lanes along the map's x axis.
    AlongX,
    /// Lanes along the map's y axis.
    AlongY,
}

/// How to cover.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoverageParams {
    /// The tool covers a disc of this width around the base, metres; 0.01 to 100.
    pub tool_width_m: f64,
    /// Share of the tool's width by which neighbouring lanes overlap at least; 0 to 0.9.
    pub overlap: f64,
    /// Share of what can be covered at which it is enough; above 0, at most 1.
    pub enough: f64,
    /// Which way lanes lie.
    pub direction: CoverageDirection,
}

impl Default for CoverageParams {
    /// For a small cleaning robot.
    fn default() -> Self {
        Self { tool_width_m: 0.4, overlap: 0.1, enough: 0.99, direction: CoverageDirection::Shorter }
    }
}

impl CoverageParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), PlanError> {
        let check = |field, value: f64, min: f64, max: f64, remedy| {
            let inside = value >= min && value <= max;
            if inside { Ok(()) } else { Err(PlanError::InvalidParam { field, value, remedy }) }
        };
        check("coverage.tool_width_m", self.tool_width_m, 0.01, 100.0, "choose 0.01 to 100")?;
        check("coverage.overlap", self.overlap, 0.0, 0.9, "choose 0 to 0.9")?;
        check("coverage.enough", self.enough, 1e-9, 1.0, "choose above 0 and at most 1")
    }
}
