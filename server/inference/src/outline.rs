//! What a file asks for, read before the library that runs models sees it.
//!
//! The library reads files safely, but takes as much memory and stack as they ask for (its page "Security and resource
//! usage"). So this reads the same file first, by `onnx.proto3` (ONNX IR version 10), without keeping weights: what could
//! nest (subgraphs, types of sequences) is refused, what is kept in memory is counted, and what is computed when the
//! model is loaded (constants and shapes) is bounded. What frames take is bounded by `work.rs`, once shapes are known: the
//! library infers them with 32 bits, which the numbers that sides are multiplied by here are too small to overflow.

use crate::InferenceError;
use crate::error::shortened;
use crate::protobuf::{Message, Value};
use std::collections::{HashMap, HashSet};

/// The most operators: large transformers have two thousand.
pub(crate) const MAX_OPERATORS: u64 = 4096;
/// The most fields of messages and numbers of packed ones, outside of raw weights: each may take some 200 bytes when it is
/// read. Detectors have some ten thousand.
const MAX_FIELDS: u64 = 1 << 18;
/// The most numbers of a tensor in the file, and of what follows from constants and shapes.
const MAX_CONSTANT: u64 = 1 << 24;

/// The most numbers of all that follows from constants and shapes.
const MAX_CONSTANTS: u64 = 1 << 26;
/// The longest side of a value.
pub(crate) const MAX_SIDE: u64 = 1 << 20;
/// The largest stride, window, padding, dilation or factor: a side of [`MAX_SIDE`] times that is less than 2^31.
const MAX_FACTOR: u64 = 1024;
/// The most inputs of an operator: together they have fewer than 2^31 rows.
const MAX_INPUTS: u64 = 1024;
/// Of small tensors of the file the numbers are looked at.
const SMALL: usize = 64;

/// `TensorProto.DataType`.
const FLOAT: u64 = 1;
const INT32: u64 = 6;
const INT64: u64 = 7;

const SIMPLIFY: &str = "export it with constants folded, as onnxsim does";

/// Operators, weights, inputs and outputs of a model.
#[derive(Debug, Default)]
pub(crate) struct Outline<'a> {
    /// Those that outputs follow from, each after what it needs.
    pub(crate) operators: Vec<Operator<'a>>,
    pub(crate) weights: HashMap<&'a str, Weight>,
    /// What follows from weights and shapes alone.
    pub(crate) constants: HashSet<&'a str>,
    /// Inputs that are no weights.
    pub(crate) inputs: Vec<&'a str>,
    pub(crate) outputs: Vec<&'a str>,
}

/// A tensor of the file.
#[derive(Debug, Default, Clone)]
pub(crate) struct Weight {
    pub(crate) shape: Vec<u64>,
    /// The largest magnitude among its numbers, infinite if they are many.
    largest: f64,
}

/// A node of the graph.
#[derive(Debug, Default)]
pub(crate) struct Operator<'a> {
    pub(crate) kind: &'a str,
    pub(crate) inputs: Vec<&'a str>,
    pub(crate) outputs: Vec<&'a str>,
    /// Numbers under its window, if it has one.
    pub(crate) window: u64,
    /// The tensor that it holds.
    tensor: Option<Weight>,
    domain: &'a str,
}

impl<'a> Outline<'a> {
    /// Reads a file. The operators that it is made of are not looked at.
    pub(crate) fn read(bytes: &'a [u8]) -> Result<Self, InferenceError> {
        let mut reader = Reader { num_fields: 0 };
        let mut graph = None;
        let mut model = Message::new(bytes);
        while let Some((field, value)) = reader.next(&mut model)? {
            if let (7, Value::Bytes(message)) = (field, value)
                && graph.replace(message).is_some()
            {
                return Err(message.malformed("a second graph"));
            }
        }
        let graph = graph.ok_or_else(|| model.malformed("the end, and no graph"))?;
        let mut outline = reader.graph(graph)?;
        outline.inputs.retain(|name| !outline.weights.contains_key(name));
        outline.drop_unused();
        outline.bound_constants()?;
        Ok(outline)
    }

    /// Drops operators that no output follows from: they are never run.
    fn drop_unused(&mut self) {
        let mut needed: HashSet<&str> = self.outputs.iter().copied().collect();
        let mut kept: Vec<Operator<'a>> = Vec::with_capacity(self.operators.len());
        for operator in std::mem::take(&mut self.operators).into_iter().rev() {
            if operator.outputs.iter().any(|name| needed.contains(name)) {
                needed.extend(&operator.inputs);
                kept.push(operator);
            }
        }
        kept.reverse();
        self.operators = kept;
    }

    /// Bounds what follows from weights and shapes alone, as that is computed when the model is loaded.
    fn bound_constants(&mut self) -> Result<(), InferenceError> {
        let mut known: HashMap<&str, Size> = self.inputs.iter().map(|&name| (name, Size::Changing)).collect();
        known.extend(self.weights.iter().map(|(&name, w)| (name, Size::Constant(num_numbers(&w.shape)))));
        let held = self.operators.iter().filter_map(|o| Some((*o.outputs.first()?, o.tensor.as_ref()?)));
        let given: HashMap<&str, &Weight> = held.chain(self.weights.iter().map(|(&name, w)| (name, w))).collect();
        let mut total = 0u64;
        for operator in &self.operators {
            operator.check_factors(&given)?;
            let mut sizes = Vec::with_capacity(operator.inputs.len());
            for name in operator.inputs.iter().filter(|name| !name.is_empty()) {
                let Some(&size) = known.get(name) else {
                    let (what, name) = ("an input that nothing before it makes,", shortened(name, 64));
                    return Err(InferenceError::Unsupported { what, name, remedy: "give operators in their order" });
                };
                sizes.push(size);
            }
            let size = operator.constant_size(&sizes)?;
            for name in operator.outputs.iter().filter(|name| !name.is_empty()) {
                // Else it would not be clear which of the two was looked at here.
                if known.insert(name, size).is_some() {
                    return Err(unsupported("a name that is given twice,", name, "give each value a name of its own"));
                }
            }
            if let Size::Constant(size) = size {
                self.constants.extend(&operator.outputs);
                total = total.saturating_add(size.saturating_mul(operator.outputs.len() as u64));
                at_most("numbers of all constants", total, MAX_CONSTANTS, SIMPLIFY)?;
            }
        }
        Ok(())
    }
}

/// What is known of a value without knowing shapes.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Size {
    /// It follows from weights and shapes, and has at most so many numbers.
    Constant(u64),
    /// It follows from the image.
    Changing,
}

impl Operator<'_> {
    /// Checks that what multiplies or widens sides is given in the file and small.
    fn check_factors(&self, given: &HashMap<&str, &Weight>) -> Result<(), InferenceError> {
        let factors: &[(usize, u64)] = match self.kind {
            "Pad" => &[(1, MAX_FACTOR)],
            "Resize" => &[(2, MAX_FACTOR), (3, MAX_SIDE)],
            _ => &[],
        };
        for &(i, limit) in factors {
            let Some(name) = self.inputs.get(i).filter(|name| !name.is_empty()) else { continue };
            let Some(weight) = given.get(name) else {
                return Err(unsupported("a computed size,", name, SIMPLIFY));
            };
            let actual = if weight.largest.is_nan() { u64::MAX } else { weight.largest as u64 };
            at_most("as a padding, size or factor", actual, limit, "choose a smaller one")?;
        }
        Ok(())
    }

    fn constant_size(&self, inputs: &[Size]) -> Result<Size, InferenceError> {
        // A shape is a constant even if what has it is none.
        if matches!(self.kind, "Shape" | "Size") {
            return Ok(Size::Constant(64));
        }
        let mut sizes = Vec::with_capacity(inputs.len());
        for input in inputs {
            let Size::Constant(size) = input else { return Ok(Size::Changing) };
            sizes.push(*size);
        }
        let size = match self.kind {
            "Constant" => self.tensor.as_ref().map_or(MAX_FIELDS, |w| num_numbers(&w.shape)),
            // Of these the values say how much there will be, not the sizes.
            "ConstantOfShape" | "Expand" | "Pad" | "Range" | "Resize" | "Conv" | "ConvTranspose" | "MaxPool"
            | "AveragePool" => {
                let (what, name) = ("a constant made by", self.kind.to_owned());
                return Err(InferenceError::Unsupported { what, name, remedy: SIMPLIFY });
            }
            "Concat" => sizes.iter().fold(0, |sum: u64, &s| sum.saturating_add(s)),
            // No more than there was.
            "Reshape" | "Transpose" | "Cast" | "Unsqueeze" | "Squeeze" | "Slice" | "Split" | "Flatten" | "Identity"
            | "Clip" | "DequantizeLinear" => sizes.first().copied().unwrap_or(1),
            // Each with each.
            _ => sizes.iter().fold(1, |product: u64, &s| product.saturating_mul(s.max(1))),
        };
        match at_most("numbers of a constant", size, MAX_CONSTANT, SIMPLIFY) {
            Ok(()) => Ok(Size::Constant(size)),
            Err(error) => Err(error),
        }
    }
}

/// How many numbers a tensor of this shape has.
pub(crate) fn num_numbers(shape: &[u64]) -> u64 {
    // A side of 0 makes nothing of all, however large the others are: those count.
    shape.iter().fold(1, |product: u64, &side| product.saturating_mul(side.max(1)))
}

pub(crate) fn at_most(what: &'static str, actual: u64, limit: u64, remedy: &'static str) -> Result<(), InferenceError> {
    if actual <= limit { Ok(()) } else { Err(InferenceError::TooLarge { what, actual, limit, remedy }) }
}

/// Counts what is read.
struct Reader {
    num_fields: u64,
}

impl Reader {
    fn next<'a>(&mut self, message: &mut Message<'a>) -> Result<Option<(u64, Value<'a>)>, InferenceError> {
        self.count(1)?;
        message.next()
    }

    fn count(&mut self, more: u64) -> Result<(), InferenceError> {
        self.num_fields += more;
        at_most("fields", self.num_fields, MAX_FIELDS, "store weights as raw data")
    }

    /// A `GraphProto`.
    fn graph<'a>(&mut self, mut message: Message<'a>) -> Result<Outline<'a>, InferenceError> {
        let mut out = Outline::default();
        while let Some((field, value)) = self.next(&mut message)? {
            match (field, value) {
                (1, Value::Bytes(node)) => {
                    at_most("operators", out.operators.len() as u64 + 1, MAX_OPERATORS, "choose a smaller model")?;
                    out.operators.push(self.operator(node)?);
                }
                (5, Value::Bytes(tensor)) => {
                    let (name, weight) = self.tensor(tensor)?;
                    if out.weights.insert(name, weight).is_some() {
                        return Err(unsupported(
                            "a name that is given twice,",
                            name,
                            "give each value a name of its own",
                        ));
                    }
                }
                (11, Value::Bytes(value)) => out.inputs.push(self.value_info(value)?),
                (12, Value::Bytes(value)) => out.outputs.push(self.value_info(value)?),
                (13, Value::Bytes(value)) => {
                    self.value_info(value)?;
                }
                (15, _) => return Err(unsupported("weights", "sparse", "store them as raw data")),
                _ => {}
            }
        }
        Ok(out)
    }

    /// A `NodeProto`.
    fn operator<'a>(&mut self, mut message: Message<'a>) -> Result<Operator<'a>, InferenceError> {
        let mut out = Operator { window: 1, ..Operator::default() };
        while let Some((field, value)) = self.next(&mut message)? {
            let Value::Bytes(bytes) = value else { continue };
            match field {
                1 => out.inputs.push(bytes.text()?),
                2 => out.outputs.push(bytes.text()?),
                4 => out.kind = bytes.text()?,
                5 => self.attribute(bytes, &mut out)?,
                7 => out.domain = bytes.text()?,
                _ => {}
            }
        }
        at_most("inputs of an operator", out.inputs.len() as u64, MAX_INPUTS, "join fewer at a time")?;
        if !matches!(out.domain, "" | "ai.onnx") {
            return Err(unsupported(
                "an operator of the domain",
                out.domain,
                "export it with standard operators alone",
            ));
        }
        Ok(out)
    }

    /// An `AttributeProto`.
    fn attribute<'a>(&mut self, mut message: Message<'a>, of: &mut Operator<'a>) -> Result<(), InferenceError> {
        let (mut name, mut numbers, mut floats) = ("", vec![], 0);
        while let Some((field, value)) = self.next(&mut message)? {
            match (field, value) {
                (1, Value::Bytes(bytes)) => name = bytes.text()?,
                (3 | 8, Value::Number(number)) => numbers.push(number as i64),
                (5, Value::Bytes(tensor)) => of.tensor = Some(self.tensor(tensor)?.1),
                (6 | 11, _) => return Err(unsupported("an operator with a graph of its own,", of.kind, "unroll it")),
                (10 | 14 | 15 | 22 | 23, _) => {
                    return Err(unsupported(
                        "an attribute of a kind that detectors have none of,",
                        name,
                        "export it without",
                    ));
                }
                (7, Value::Fixed(_)) => floats += 1,
                (7 | 8, Value::Bytes(mut packed)) => {
                    self.count(packed.bytes.len() as u64)?;
                    floats += packed.bytes.len() as u64;
                    while field == 8 && !packed.bytes.is_empty() {
                        numbers.push(packed.varint()? as i64);
                    }
                }
                _ => {}
            }
        }
        let largest = numbers.iter().map(|n| n.unsigned_abs()).max().unwrap_or(0);
        match name {
            "kernel_shape" => of.window = numbers.iter().fold(1, |all: u64, n| all.saturating_mul(n.unsigned_abs())),
            "value_int" | "value_ints" | "value_float" | "value_floats" => {
                let largest = if floats > 0 { f64::INFINITY } else { largest as f64 };
                of.tensor = Some(Weight { shape: vec![(numbers.len() as u64).max(floats).max(1)], largest });
            }
            _ => {}
        }
        let limit = match name {
            "kernel_shape" | "strides" | "pads" | "dilations" | "output_padding" | "blocksize" => MAX_FACTOR,
            "output_shape" => MAX_SIDE,
            "group" if of.kind == "ConvTranspose" => MAX_FACTOR,
            _ => return Ok(()),
        };
        at_most("as a stride, window, padding or dilation", largest, limit, "choose a smaller one")
    }

    /// A `TensorProto`, and its name.
    fn tensor<'a>(&mut self, mut message: Message<'a>) -> Result<(&'a str, Weight), InferenceError> {
        let (mut name, mut shape, mut kind) = ("", vec![], 0);
        let (mut numbers, mut raw): (Vec<f64>, &[u8]) = (vec![], &[]);
        while let Some((field, value)) = self.next(&mut message)? {
            match (field, value) {
                (1, Value::Number(side)) => shape.push(side),
                (1, Value::Bytes(mut packed)) => {
                    self.count(packed.bytes.len() as u64)?;
                    while !packed.bytes.is_empty() {
                        shape.push(packed.varint()?);
                    }
                }
                (2, Value::Number(number)) => kind = number,
                (4, Value::Fixed(bytes)) => {
                    numbers.extend(bytes.first_chunk().map(|b| f64::from(f32::from_le_bytes(*b))))
                }
                (4, Value::Bytes(packed)) => {
                    let few = packed.bytes.chunks_exact(4).take(SMALL + 1).filter_map(|b| b.first_chunk());
                    numbers.extend(few.map(|b| f64::from(f32::from_le_bytes(*b))));
                }
                (5 | 7, Value::Number(number)) => numbers.push(number as i64 as f64),
                // As many numbers as bytes at most.
                (5 | 7 | 10 | 11, Value::Bytes(mut packed)) => {
                    self.count(packed.bytes.len() as u64)?;
                    while matches!(field, 5 | 7) && !packed.bytes.is_empty() {
                        numbers.push(packed.varint()? as i64 as f64);
                    }
                }
                (6, _) => return Err(unsupported("a tensor of", "texts", "export it without")),
                (8, Value::Bytes(bytes)) => name = bytes.text()?,
                (9, Value::Bytes(bytes)) => raw = bytes.bytes,
                (13, _) => return Err(unsupported("weights", "in another file", "export it with its weights inside")),
                _ => {}
            }
        }
        at_most("sides of a tensor", shape.len() as u64, 8, "export it with tensors of fewer dimensions")?;
        at_most("numbers of a tensor", num_numbers(&shape), MAX_CONSTANT, "choose a smaller model")?;
        if raw.len() <= 8 * SMALL {
            match kind {
                FLOAT => numbers.extend(
                    raw.chunks_exact(4).filter_map(|b| b.first_chunk()).map(|b| f64::from(f32::from_le_bytes(*b))),
                ),
                INT32 => numbers.extend(
                    raw.chunks_exact(4).filter_map(|b| b.first_chunk()).map(|b| f64::from(i32::from_le_bytes(*b))),
                ),
                INT64 => numbers
                    .extend(raw.chunks_exact(8).filter_map(|b| b.first_chunk()).map(|b| i64::from_le_bytes(*b) as f64)),
                _ => numbers.push(f64::INFINITY),
            }
        }
        let is_small = numbers.len() <= SMALL && raw.len() <= 8 * SMALL;
        let largest = if is_small { numbers.iter().map(|n| n.abs()).fold(0.0, f64::max) } else { f64::INFINITY };
        Ok((name, Weight { shape, largest }))
    }

    /// The name of a `ValueInfoProto`.
    fn value_info<'a>(&mut self, mut message: Message<'a>) -> Result<&'a str, InferenceError> {
        let mut name = "";
        while let Some((field, value)) = self.next(&mut message)? {
            match (field, value) {
                (1, Value::Bytes(bytes)) => name = bytes.text()?,
                (2, Value::Bytes(mut kind)) => {
                    while let Some((field, value)) = self.next(&mut kind)? {
                        match (field, value) {
                            (1, Value::Bytes(tensor)) => self.shape_fields(tensor)?,
                            (4 | 5 | 8 | 9, _) => {
                                return Err(unsupported("a value that is no tensor,", name, "export it without"));
                            }
                            _ => {}
                        }
                    }
                }
                _ => {}
            }
        }
        Ok(name)
    }

    /// Counts the fields of a `TypeProto.Tensor`: shape, dimensions, their fields.
    fn shape_fields(&mut self, mut tensor: Message<'_>) -> Result<(), InferenceError> {
        while let Some((field, value)) = self.next(&mut tensor)? {
            let (2, Value::Bytes(mut shape)) = (field, value) else { continue };
            while let Some((_, value)) = self.next(&mut shape)? {
                let Value::Bytes(mut side) = value else { continue };
                while self.next(&mut side)?.is_some() {}
            }
        }
        Ok(())
    }
}

fn unsupported(what: &'static str, name: &str, remedy: &'static str) -> InferenceError {
    InferenceError::Unsupported { what, name: shortened(name, 64), remedy }
}
