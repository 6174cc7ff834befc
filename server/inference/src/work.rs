//! What a run takes, counted before the first one.

use crate::InferenceError;
use crate::error::shortened;
use crate::outline::{MAX_SIDE, Operator, Outline, at_most, num_numbers};
use rten::{Dimension, Model};
use std::collections::HashMap;

/// The most numbers of a value, and of all values of a run. YOLOv8x at 640 x 640 has 8 and 150 million; that many are 128
/// MB, and 1 GB if all were kept at once.
const MAX_VALUE: u64 = 1 << 25;
const MAX_VALUES: u64 = 1 << 28;
/// What a sum of products has at most where the library keeps no shape to tell it.
const UNKNOWN_TERMS: u64 = 8192;
/// Through how many operators a value that was fused away is followed.
const MAX_FUSED: usize = 8;

const SMALLER: &str = "choose a smaller model or input";

/// How much a run does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Work {
    /// Multiplications and additions in convolutions, products of matrices and windows.
    pub(crate) multiply_adds: u64,
    /// Numbers of all values.
    pub(crate) numbers: u64,
}

impl Work {
    /// Counts it for a model that was loaded with all shapes inferred; `outline` is of the same file.
    ///
    /// # Errors
    /// `TooLarge`; `Unsupported` if a shape is not known.
    pub(crate) fn of(model: &Model, outline: &Outline<'_>, max_multiply_adds: u64) -> Result<Self, InferenceError> {
        let shapes = Shapes::new(model, outline);
        let mut out = Self::default();
        for operator in &outline.operators {
            let is_kept = |name: &&&str| !name.is_empty() && !outline.constants.contains(**name);
            for name in operator.outputs.iter().filter(is_kept) {
                let Some(numbers) = shapes.numbers(name) else {
                    let (what, name) = ("a value of unknown shape,", shortened(name, 64));
                    let remedy = "export it with fixed shapes and without control flow";
                    return Err(InferenceError::Unsupported { what, name, remedy });
                };
                let longest = shapes.shape(name).and_then(|shape| shape.into_iter().max()).unwrap_or(0);
                at_most("along a side of a value", longest, MAX_SIDE, SMALLER)?;
                at_most("numbers of a value", numbers, MAX_VALUE, SMALLER)?;
                out.numbers = out.numbers.saturating_add(numbers);
                let more = numbers.saturating_mul(shapes.terms(operator));
                out.multiply_adds = out.multiply_adds.saturating_add(more);
            }
        }
        at_most("numbers of all values", out.numbers, MAX_VALUES, SMALLER)?;
        at_most("multiplications", out.multiply_adds, max_multiply_adds, SMALLER)?;
        Ok(out)
    }
}

struct Shapes<'a> {
    model: &'a Model,
    outline: &'a Outline<'a>,
    /// The first operator that uses a value.
    users: HashMap<&'a str, &'a Operator<'a>>,
}

impl<'a> Shapes<'a> {
    fn new(model: &'a Model, outline: &'a Outline<'a>) -> Self {
        let used = |operator: &'a Operator<'a>| operator.inputs.iter().map(move |&name| (name, operator));
        // The last of equal keys stays.
        Self { model, outline, users: outline.operators.iter().rev().flat_map(used).collect() }
    }

    fn shape(&self, name: &str) -> Option<Vec<u64>> {
        if let Some(weight) = self.outline.weights.get(name) {
            return Some(weight.shape.clone());
        }
        let fixed = |side: Dimension| match side {
            Dimension::Fixed(side) => Some(side as u64),
            Dimension::Symbolic(_) => None,
        };
        self.model.node_info(self.model.find_node(name)?)?.shape()?.into_iter().map(fixed).collect()
    }

    /// How many numbers a value has. One that was fused away had as many as what was made of it.
    fn numbers(&self, name: &'a str) -> Option<u64> {
        let mut name = name;
        for _ in 0..MAX_FUSED {
            if let Some(shape) = self.shape(name) {
                return Some(num_numbers(&shape));
            }
            name = self.users.get(name)?.outputs.first()?;
        }
        None
    }

    /// How many products each number of an operator's output is the sum of; 1 for those that have none.
    fn terms(&self, operator: &Operator<'_>) -> u64 {
        let input = |i: usize| operator.inputs.get(i).and_then(|name| self.shape(name));
        let side = |i: usize, from_end: usize| input(i).and_then(|shape| shape.iter().rev().nth(from_end).copied());
        match operator.kind {
            // Weights are out x in x window.
            "Conv" => input(1).map_or(UNKNOWN_TERMS, |shape| num_numbers(shape.get(1..).unwrap_or_default())),
            // Weights are in x out x window: no more than in x window.
            "ConvTranspose" => {
                input(1).map_or(UNKNOWN_TERMS, |shape| num_numbers(&shape) / shape.get(1).map_or(1, |&out| out.max(1)))
            }
            "Gemm" | "MatMul" => {
                let terms = [side(0, 0), side(0, 1).filter(|_| operator.kind == "Gemm"), side(1, 1)];
                terms.into_iter().flatten().max().unwrap_or(UNKNOWN_TERMS)
            }
            kind if kind.starts_with("Reduce") || matches!(kind, "ArgMax" | "ArgMin" | "GlobalAveragePool") => {
                input(0).map_or(UNKNOWN_TERMS, |shape| num_numbers(&shape))
            }
            _ => operator.window,
        }
    }
}
