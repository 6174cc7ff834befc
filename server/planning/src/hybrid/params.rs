//! What can be tuned about planning for a robot that steers.

use crate::PlanError;

/// Parameters of [`Planner::Hybrid`](crate::Planner::Hybrid).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HybridParams {
    /// Least radius that the base drives, metres; 0.01 to 100.
    pub turning_radius_m: f64,
    /// Whether the robot may drive backwards.
    pub allow_reverse: bool,
    /// Cost of a metre backwards in metres forwards; 1 to 100.
    pub reverse_cost: f64,
    /// Cost of a change between forwards and backwards, metres; 0 to 100.
    pub direction_change_cost_m: f64,
    /// Cost of a metre on the tightest arc in metres straight; 1 to 100.
    pub turning_cost: f64,
    /// Headings that the search tells apart; 8 to 360.
    pub num_headings: usize,
    /// By how much of its cost the path may exceed the least one among the poses that the search tells apart, as far as its
    /// estimate (of the way over cells) is right; 0 to 10. More: quicker.
    pub tolerance: f64,
    /// Poses that may be expanded, once a path of up to twelve turning radii is found, by finer searches for a cheaper one; 0 (none) to
    /// 10,000,000.
    pub refine_expansions: usize,
}

impl Default for HybridParams {
    /// Costs near to those of nav2's Smac Hybrid-A*. On depot, `tolerance` 0.5 instead of 0.05 takes 300 expansions instead
    /// of 12,000, for paths of the same mean length once shortcuts are taken (`examples/hybrid.rs`). Of 57 pairs in small rooms
    /// (`examples/exhaustive.rs 60 0.04 96 2000 60`), where length alone counts, paths are within 3 % of the shortest for 55 at
    /// 2,000 `refine_expansions`, for all at 20,000; on depot, the 99th percentile of times is 22 ms at 0, 45 at 2,000.
    fn default() -> Self {
        Self {
            turning_radius_m: 0.8,
            allow_reverse: true,
            reverse_cost: 2.0,
            direction_change_cost_m: 0.3,
            turning_cost: 1.2,
            num_headings: 72,
            tolerance: 0.5,
            refine_expansions: 2000,
        }
    }
}

impl HybridParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), PlanError> {
        let check = |field, value: f64, min: f64, max: f64, remedy| {
            let inside = value >= min && value <= max;
            if inside { Ok(()) } else { Err(PlanError::InvalidParam { field, value, remedy }) }
        };
        check("hybrid.turning_radius_m", self.turning_radius_m, 0.01, 100.0, "choose 0.01 to 100")?;
        check("hybrid.reverse_cost", self.reverse_cost, 1.0, 100.0, "choose 1 to 100")?;
        check("hybrid.direction_change_cost_m", self.direction_change_cost_m, 0.0, 100.0, "choose 0 to 100")?;
        check("hybrid.turning_cost", self.turning_cost, 1.0, 100.0, "choose 1 to 100")?;
        check("hybrid.num_headings", self.num_headings as f64, 8.0, 360.0, "choose 8 to 360")?;
        check("hybrid.tolerance", self.tolerance, 0.0, 10.0, "choose 0 to 10")?;
        check("hybrid.refine_expansions", self.refine_expansions as f64, 0.0, 1e7, "choose 0 to 10000000")
    }
}
