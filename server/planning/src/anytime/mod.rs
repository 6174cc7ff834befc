//! A path at once, and better ones for as long as there is time.
//!
//! Comes in: what [`plan_path`](crate::plan_path) takes, and how loosely to begin. Goes out: each better path as it is found,
//! with the bound on its cost that is proven by then. Over cells alone: what is steered has its own bound. Start with
//! [`plan_anytime`]; [`search()`] is what it does on a grid. [`plan_path`](crate::plan_path) itself does so if it may be stopped.

mod plan;
mod search;

pub(crate) use plan::best_in_time;
pub use plan::plan_anytime;
pub use search::{AnytimeEnd, AnytimePath, AnytimeRequest, search};

use crate::PlanError;

/// How the bound on a path's cost comes down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnytimeParams {
    /// The first path costs at most so many times the least; 1 to 100. More: the first is found sooner.
    pub first_bound: f64,
    /// By how much the bound comes down from one search to the next; 0.01 to 100.
    pub bound_step: f64,
}

impl Default for AnytimeParams {
    /// As in Likhachev et al. 2003, section 4.1, with larger steps: each search costs at least a look at all that is open.
    fn default() -> Self {
        Self { first_bound: 3.0, bound_step: 0.5 }
    }
}

impl AnytimeParams {
    /// Checks every field.
    ///
    /// # Errors
    /// `InvalidParam` naming field, value and remedy.
    pub fn validate(&self) -> Result<(), PlanError> {
        let check = |field, value: f64, min: f64, remedy| {
            let inside = value >= min && value <= 100.0;
            if inside { Ok(()) } else { Err(PlanError::InvalidParam { field, value, remedy }) }
        };
        check("anytime.first_bound", self.first_bound, 1.0, "choose 1 to 100")?;
        check("anytime.bound_step", self.bound_step, 0.01, "choose 0.01 to 100")
    }
}
