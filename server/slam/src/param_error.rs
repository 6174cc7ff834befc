//! What is wrong with a parameter.

/// A parameter that cannot be used: the facts, for the caller to put into words.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: {value} is not {requirement}; {remedy}")]
pub struct ParamError {
    /// Field with its path inside the crate's parameters, e.g. `rgbd.max_depth_m`.
    pub field: &'static str,
    /// The value as given.
    pub value: f64,
    /// What it has to be.
    pub requirement: &'static str,
    /// What to do instead.
    pub remedy: &'static str,
}

/// Checks `min <= value <= max`, finite.
pub(crate) fn check_range(
    field: &'static str,
    value: f64,
    (min, max): (f64, f64),
    requirement: &'static str,
    remedy: &'static str,
) -> Result<(), ParamError> {
    if value >= min && value <= max { Ok(()) } else { Err(ParamError { field, value, requirement, remedy }) }
}
