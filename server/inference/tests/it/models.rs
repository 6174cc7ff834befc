//! Small models, written with the library's encoder of ONNX.

use percept_inference::{
    Detector, DetectorSpec, InferenceError, InferenceThreads, InputSpec, ModelLimits, OutputLayout,
};
use rten_onnx::onnx::{
    AttributeProto, AttributeType, DataType, Dimension, GraphProto, ModelProto, NodeProto, OperatorSetIdProto,
    TensorProto, TensorShapeProto, TypeProto, TypeProtoTensor, ValueInfoProto,
};

/// An attribute of whole numbers.
pub(crate) fn ints(name: &str, values: &[i64]) -> AttributeProto {
    let (name, r#type) = (Some(name.to_owned()), Some(AttributeType::INTS));
    AttributeProto { name, ints: values.to_vec(), r#type, ..AttributeProto::default() }
}

/// An attribute of one whole number.
pub(crate) fn int(name: &str, value: i64) -> AttributeProto {
    let (name, r#type) = (Some(name.to_owned()), Some(AttributeType::INT));
    AttributeProto { name, i: Some(value), r#type, ..AttributeProto::default() }
}

pub(crate) fn node(kind: &str, inputs: &[&str], output: &str, attribute: Vec<AttributeProto>) -> NodeProto {
    let input = inputs.iter().map(|&name| name.to_owned()).collect();
    NodeProto {
        op_type: Some(kind.to_owned()),
        name: Some(format!("make {output}")),
        input,
        output: vec![output.to_owned()],
        attribute,
        ..NodeProto::default()
    }
}

pub(crate) fn floats(name: &str, dims: &[i64], data: Vec<f32>) -> TensorProto {
    TensorProto {
        name: Some(name.to_owned()),
        dims: dims.to_vec(),
        data_type: Some(DataType::FLOAT),
        float_data: data,
        ..TensorProto::default()
    }
}

pub(crate) fn longs(name: &str, dims: &[i64], data: Vec<i64>) -> TensorProto {
    TensorProto {
        name: Some(name.to_owned()),
        dims: dims.to_vec(),
        data_type: Some(DataType::INT64),
        int64_data: data,
        ..TensorProto::default()
    }
}

/// A value of a shape; 0 is a side of any length.
pub(crate) fn value(name: &str, kind: DataType, shape: &[i64]) -> ValueInfoProto {
    let side = |&side: &i64| match side {
        0 => Dimension { dim_param: Some("n".to_owned()), ..Dimension::default() },
        _ => Dimension { dim_value: Some(side), ..Dimension::default() },
    };
    let shape = Some(TensorShapeProto { dim: shape.iter().map(side).collect() });
    let tensor_type = Some(TypeProtoTensor { elem_type: Some(kind), shape });
    ValueInfoProto { name: Some(name.to_owned()), r#type: Some(TypeProto { tensor_type, ..TypeProto::default() }) }
}

pub(crate) fn write(graph: GraphProto) -> Vec<u8> {
    let version = OperatorSetIdProto { domain: Some(String::new()), version: Some(13) };
    let model =
        ModelProto { ir_version: Some(8), graph: Some(graph), opset_import: vec![version], ..ModelProto::default() };
    model.write_buf().unwrap()
}

/// The attributes of a convolution by squares: the library asks for all of them.
pub(crate) fn squares(side: i64, stride: i64, pad: i64) -> Vec<AttributeProto> {
    vec![ints("kernel_shape", &[side; 2]), ints("strides", &[stride; 2]), ints("pads", &[pad; 4])]
}

/// A graph from an image of 1 x 3 x 8 x 8 to `out`.
pub(crate) fn graph(node: Vec<NodeProto>, initializer: Vec<TensorProto>) -> GraphProto {
    let output = ValueInfoProto { name: Some("out".to_owned()), r#type: None };
    let input = vec![value("image", DataType::FLOAT, &[1, 3, 8, 8])];
    GraphProto { node, initializer, input, output: vec![output], ..GraphProto::default() }
}

/// In the manner of FastestDet, two classes and a grid of 2 x 2: something is there as far as the cell is red; it is of the
/// second class as far as the cell is green, else of the first. Boxes are around the cells' first corners, half as wide and
/// high as the image.
pub(crate) fn tiny() -> GraphProto {
    tiny_with_size(0.0)
}

/// The same with boxes of another size: that part of the image is the sigmoid of it.
pub(crate) fn tiny_with_size(size: f32) -> GraphProto {
    let mut weights = vec![0.0; 7 * 3 * 16];
    let mean = |weights: &mut [f32], out: usize, channel: usize| {
        let start = (out * 3 + channel) * 16;
        weights[start..start + 16].fill(1.0 / 16.0);
    };
    mean(&mut weights, 0, 0);
    mean(&mut weights, 6, 1);
    // The first class has 0.5 everywhere.
    let bias = vec![0.0, 0.0, 0.0, size, size, 0.5, 0.0];
    graph(
        vec![node("Conv", &["image", "weights", "bias"], "out", squares(4, 4, 0))],
        vec![floats("weights", &[7, 3, 4, 4], weights), floats("bias", &[7], bias)],
    )
}

pub(crate) fn spec() -> DetectorSpec {
    let spec = DetectorSpec::new("tiny", &["red", "yellow"], OutputLayout::FastestDet);
    DetectorSpec { input: Some(InputSpec::default()), ..spec }
}

pub(crate) fn build(model: &[u8]) -> Result<Detector, InferenceError> {
    Detector::new(model, spec(), &ModelLimits::default(), &InferenceThreads::new(1))
}

pub(crate) fn error(model: &[u8]) -> InferenceError {
    build(model).map(|_| ()).unwrap_err()
}
