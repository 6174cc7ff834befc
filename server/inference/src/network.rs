//! A model that takes one image, loaded within limits.

use crate::error::shortened;
use crate::operators::operators;
use crate::outline::{Outline, at_most};
use crate::work::Work;
use crate::{InferenceError, InferenceThreads};
use rten::{DataType, Dimension, Model, ModelOptions, NodeId, ShapeInferenceMode, Value, ValueType, ValueView};
use rten_tensor::prelude::*;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Of the thread that loads: the library goes through chains of operators by recursion, some hundred bytes each.
const LOADING_STACK: usize = 32 << 20;
/// The most outputs.
const MAX_OUTPUTS: u64 = 8;

/// How large a model may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ModelLimits {
    /// The largest file, bytes. Loaded it takes about three times as much at worst.
    pub max_bytes: usize,
    /// The longest edge of the input, pixels.
    pub max_input_px: usize,
    /// The most multiplications and additions of a run, which bound its time: a core does some 10 to 50 thousand million a
    /// second.
    pub max_multiply_adds: u64,
}

impl Default for ModelLimits {
    /// 64 MB, 1280 pixels; fifty thousand million multiplications, as YOLOv8m at 640 x 640 has forty.
    fn default() -> Self {
        Self { max_bytes: 64 << 20, max_input_px: 1280, max_multiply_adds: 50_000_000_000 }
    }
}

/// What a run gives: numbers, row-major, and their shape.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tensor {
    pub(crate) shape: Vec<usize>,
    pub(crate) data: Vec<f32>,
}

/// A loaded model.
pub(crate) struct Network {
    model: Model,
    input: NodeId,
    outputs: Vec<NodeId>,
    threads: InferenceThreads,
    /// Columns and rows of the input.
    pub(crate) input_px: [usize; 2],
    pub(crate) work: Work,
    pub(crate) num_bytes: usize,
}

impl Network {
    /// Loads a model and runs it once on a black image; what that gave comes back, too.
    pub(crate) fn load(
        bytes: &[u8],
        limits: &ModelLimits,
        threads: &InferenceThreads,
    ) -> Result<(Self, Vec<Tensor>), InferenceError> {
        at_most(
            "bytes",
            bytes.len() as u64,
            limits.max_bytes as u64,
            "choose a smaller model, or weights of fewer bits",
        )?;
        let outline = Outline::read(bytes)?;
        at_most("outputs", outline.outputs.len() as u64, MAX_OUTPUTS, "export it with the last ones alone")?;
        if outline.outputs.is_empty() {
            let (what, name) = ("a graph without outputs,", String::new());
            return Err(InferenceError::Unsupported { what, name, remedy: "export it with its outputs" });
        }
        on_large_stack(|| {
            let model = guarded("loaded", || {
                let mut options = ModelOptions::with_ops(operators());
                options.shape_inference(ShapeInferenceMode::Strict).prepack_weights(true);
                options.load(bytes.to_vec())
            })?;
            let (input, input_px) = input_of(&model, limits)?;
            let work = Work::of(&model, &outline, limits.max_multiply_adds)?;
            let (outputs, threads) = (model.output_ids().to_vec(), threads.clone());
            let network = Self { model, input, outputs, threads, input_px, work, num_bytes: bytes.len() };
            // Here, as the order of the operators is found by the first run and kept.
            let first = network.run(&vec![0.0; 3 * input_px[0] * input_px[1]])?;
            Ok((network, first))
        })
    }

    /// What it takes at most, about: weights as they are and once more as they are multiplied, and the values of a run.
    pub(crate) fn memory_bytes(&self) -> u64 {
        2 * self.num_bytes as u64 + 4 * self.work.numbers
    }

    /// Runs it on an input of 1 x 3 x H x W numbers.
    pub(crate) fn run(&self, input: &[f32]) -> Result<Vec<Tensor>, InferenceError> {
        let [width, height] = self.input_px;
        let outputs = guarded("run", || {
            let view = ValueView::from_shape([1, 3, height, width], input).map_err(|e| e.to_string())?;
            let options = Some(self.threads.options());
            self.model.run(vec![(self.input, view.into())], &self.outputs, options).map_err(|e| e.to_string())
        })?;
        outputs.iter().map(tensor).collect()
    }
}

impl std::fmt::Debug for Network {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Network").field("input_px", &self.input_px).field("work", &self.work).finish_non_exhaustive()
    }
}

fn tensor(value: &Value) -> Result<Tensor, InferenceError> {
    match value.as_tensor_view::<f32>() {
        Some(view) => Ok(Tensor { shape: view.shape().to_vec(), data: view.to_vec() }),
        None => {
            Err(InferenceError::OutputMismatch { expected: "numbers (float32)", actual: value.dtype().to_string() })
        }
    }
}

/// The one input, and its columns and rows.
fn input_of(model: &Model, limits: &ModelLimits) -> Result<(NodeId, [usize; 2]), InferenceError> {
    let told = |id: &NodeId| {
        let info = model.node_info(*id);
        let name = shortened(info.as_ref().and_then(|i| i.name()).unwrap_or("?"), 32);
        let shape = info.as_ref().and_then(|i| i.shape()).map_or("of any shape".to_owned(), |s| told_shape(&s));
        let kind = info.and_then(|i| i.dtype()).map_or(String::new(), |d| format!(" ({d})"));
        format!("{name} {shape}{kind}")
    };
    let all = || shortened(&model.input_ids().iter().take(8).map(told).collect::<Vec<_>>().join(", "), 200);
    let mismatch =
        || InferenceError::InputMismatch { actual: if model.input_ids().is_empty() { "(none)".into() } else { all() } };
    let [id] = model.input_ids() else { return Err(mismatch()) };
    let info = model.node_info(*id).ok_or_else(mismatch)?;
    let shape = info.shape().ok_or_else(mismatch)?;
    let [Dimension::Fixed(1), Dimension::Fixed(3), Dimension::Fixed(height), Dimension::Fixed(width)] = shape[..]
    else {
        return Err(mismatch());
    };
    if info.dtype().is_some_and(|kind| kind != ValueType::Tensor(DataType::Float)) || width == 0 || height == 0 {
        return Err(mismatch());
    }
    let longest = width.max(height) as u64;
    at_most("pixels along an edge of the input", longest, limits.max_input_px as u64, "export it for smaller images")?;
    Ok((*id, [width, height]))
}

fn told_shape(shape: &[Dimension]) -> String {
    let side = |side: &Dimension| match side {
        Dimension::Fixed(side) => side.to_string(),
        Dimension::Symbolic(name) => shortened(name, 16),
    };
    shape.iter().take(8).map(side).collect::<Vec<_>>().join(" x ")
}

/// Does it; an error or panic of the library becomes an error.
fn guarded<T, E: ToString>(step: &'static str, work: impl FnOnce() -> Result<T, E>) -> Result<T, InferenceError> {
    let reason = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(done)) => return Ok(done),
        Ok(Err(error)) => error.to_string(),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a fault of the library").to_owned()
        }
    };
    Err(InferenceError::Failed { step, reason: shortened(&reason, 200) })
}

fn on_large_stack<T: Send>(work: impl FnOnce() -> Result<T, InferenceError> + Send) -> Result<T, InferenceError> {
    let failed = |reason: &str| InferenceError::Failed { step: "loaded", reason: reason.to_owned() };
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().name("model".into()).stack_size(LOADING_STACK);
        let thread = thread.spawn_scoped(scope, work).map_err(|e| failed(&e.to_string()))?;
        thread.join().unwrap_or_else(|_| Err(failed("a fault of the library")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Written by `tests/small_models.py`, which told the figures, ONNX Runtime's: shape, numbers, sum of magnitudes.
    #[test]
    fn small_models_give_what_onnx_runtime_gives() {
        let grid = &include_bytes!("../../../tests/fuzz/seeds/onnx/grid.onnx")[..];
        let yolo = &include_bytes!("../../../tests/fuzz/seeds/onnx/yolo.onnx")[..];
        let attention = &include_bytes!("../../../tests/fuzz/seeds/onnx/attention.onnx")[..];
        let cases = [
            (grid, vec![1, 7, 4, 4], [0.83054, 0.66274, -2.216332, -0.604717, 0.073531f32], 95.3276),
            (yolo, vec![1, 6, 16], [0.065657, -0.063204, 0.159567, 0.495354, 0.445218], 29.2209),
            (attention, vec![1, 6, 4], [0.352958, -0.184727, 2.202824, 0.023157, -0.191388], 10.1713),
        ];
        let image: Vec<f32> = (0..768).map(|i| (i * 37 % 101) as f32 / 101.0).collect();
        for (model, shape, numbers, magnitude) in cases {
            let (network, _) = Network::load(model, &ModelLimits::default(), &InferenceThreads::new(1)).unwrap();
            let out = network.run(&image).unwrap().remove(0);
            let n = out.data.len();
            let found = [0, 1, n / 2, n - 2, n - 1].map(|i| out.data[i]);
            assert_eq!(out.shape, shape);
            assert!(found.iter().zip(numbers).all(|(a, b)| (a - b).abs() < 1e-5), "{shape:?}: {found:?}");
            assert!((out.data.iter().map(|v| v.abs()).sum::<f32>() - magnitude).abs() < 1e-3);
        }
    }
}
