//! Files that are cut, huge, nested, or ask for too much: each is refused with what is wrong, in little time and memory.

use crate::models::{build, error, floats, graph, int, longs, node, squares, tiny, value, write};
use percept_inference::{Detector, DetectorSpec, InferenceError, InferenceThreads, ModelLimits, OutputLayout};
use rten_onnx::onnx::{AttributeProto, DataLocation, DataType, GraphProto, StringStringEntryProto, ValueInfoProto};

fn too_large(model: &[u8], expected: &str) {
    let error = error(model);
    assert!(matches!(error, InferenceError::TooLarge { what, .. } if what == expected), "{error}");
}

fn unsupported(model: &[u8], expected: &str) {
    let error = error(model);
    assert!(matches!(&error, InferenceError::Unsupported { .. }) && error.to_string().contains(expected), "{error}");
}

fn relus(count: usize) -> GraphProto {
    let name = |i: usize| {
        if i == 0 {
            "image".to_owned()
        } else if i == count {
            "last".to_owned()
        } else {
            format!("v{i}")
        }
    };
    let mut nodes: Vec<_> = (0..count).map(|i| node("Relu", &[&name(i)], &name(i + 1), vec![])).collect();
    let tiny = tiny();
    nodes.extend(tiny.node.into_iter().map(|mut conv| {
        conv.input[0] = name(count);
        conv
    }));
    graph(nodes, tiny.initializer)
}

#[test]
fn cut_files_and_other_bytes_are_no_models() {
    let whole = write(tiny());
    assert!(build(&whole).is_ok());
    // The versions of the operators come last, and only a file cut just there may do.
    let whole_ones = (0..whole.len()).filter(|&length| build(&whole[..length]).is_ok()).count();
    assert!(whole_ones <= 1, "{whole_ones}");
    for bytes in [&b""[..], b"\x00", b"GIF89a", b"{\"a\": 1}", &[0xff; 1000], &[0x3a; 1000], &[0; 100_000]] {
        let error = error(bytes);
        assert!(matches!(error, InferenceError::NotOnnx { .. }), "{error}");
    }
}

#[test]
fn files_of_too_many_bytes_are_not_looked_at() {
    let limits = ModelLimits { max_bytes: 10, ..ModelLimits::default() };
    let spec = DetectorSpec::new("x", &["a"], OutputLayout::YoloV8);
    let error = Detector::new(&[0; 11], spec, &limits, &InferenceThreads::new(1)).map(|_| ()).unwrap_err();
    assert!(matches!(error, InferenceError::TooLarge { what: "bytes", actual: 11, limit: 10, .. }), "{error}");
}

#[test]
fn other_inputs_than_one_image_are_told_with_their_shapes() {
    let cases: [(Vec<ValueInfoProto>, &str); 6] = [
        (vec![value("image", DataType::FLOAT, &[1, 1, 8, 8])], "image 1 x 1 x 8 x 8"),
        (vec![value("image", DataType::FLOAT, &[1, 3, 0, 0])], "image 1 x 3 x n x n"),
        (vec![value("image", DataType::FLOAT, &[2, 3, 8, 8])], "image 2 x 3 x 8 x 8"),
        (vec![value("image", DataType::FLOAT, &[3, 8, 8])], "image 3 x 8 x 8"),
        (vec![value("image", DataType::INT64, &[1, 3, 8, 8])], "(tensor(i32))"),
        (
            vec![value("image", DataType::FLOAT, &[1, 3, 8, 8]), value("mask", DataType::FLOAT, &[1])],
            "image 1 x 3 x 8 x 8 (tensor(f32)), mask 1 (tensor(f32))",
        ),
    ];
    for (input, expected) in cases {
        let error = error(&write(GraphProto { input, ..tiny() }));
        // What the library refuses before, it names, too.
        let is_named = error.to_string().contains(expected) || matches!(error, InferenceError::Failed { .. });
        assert!(is_named, "{error}");
    }
    let large = vec![value("image", DataType::FLOAT, &[1, 3, 8, 1281])];
    too_large(&write(GraphProto { input: large, ..tiny() }), "pixels along an edge of the input");
    let just = vec![value("image", DataType::FLOAT, &[1, 3, 8, 1280])];
    assert_eq!(build(&write(GraphProto { input: just, ..tiny() })).unwrap().input_px(), [1280, 8]);
    let none = error(&write(GraphProto { input: vec![], ..tiny() }));
    assert!(!none.to_string().is_empty());
}

#[test]
fn outputs_of_another_layout_are_told_with_their_shapes() {
    let mean = node("ReduceMean", &["image"], "out", vec![int("keepdims", 0)]);
    let e = error(&write(graph(vec![mean], vec![])));
    assert!(matches!(&e, InferenceError::OutputMismatch { actual, .. } if actual == "of one number"), "{e}");
    let relu = node("Relu", &["image"], "out", vec![]);
    let e = error(&write(graph(vec![relu], vec![])));
    assert!(matches!(&e, InferenceError::OutputMismatch { actual, .. } if actual == "1 x 3 x 8 x 8"), "{e}");
    let shape = node("Shape", &["image"], "out", vec![]);
    let e = error(&write(graph(vec![shape], vec![])));
    assert!(matches!(&e, InferenceError::OutputMismatch { .. }), "{e}");
    unsupported(&write(GraphProto { output: vec![], ..tiny() }), "without outputs");
}

#[test]
fn what_could_run_for_any_time_is_refused() {
    let mut looped = node("Loop", &["", "", "image"], "out", vec![]);
    let body = AttributeProto { name: Some("body".into()), g: Some(tiny()), ..AttributeProto::default() };
    looped.attribute.push(body);
    unsupported(&write(graph(vec![looped], vec![])), "graph of its own");
    let other = |kind: &str| error(&write(graph(vec![node(kind, &["image"], "out", vec![])], vec![])));
    for kind in ["NonZero", "RandomNormalLike", "NoSuchOperator", ""] {
        let e = other(kind);
        assert!(matches!(&e, InferenceError::Failed { step: "loaded", .. }) && e.to_string().contains(kind), "{e}");
    }
    let mut foreign = node("Relu", &["image"], "out", vec![]);
    foreign.domain = Some("com.example".into());
    unsupported(&write(graph(vec![foreign], vec![])), "com.example");
}

/// Sub-messages within each other that a reader by recursion would follow into the end of its stack.
#[test]
fn graphs_within_graphs_are_refused_before_they_are_followed() {
    let field = |number: u8, content: &[u8]| {
        let mut out = vec![number << 3 | 2];
        let mut length = content.len();
        while length >= 0x80 {
            out.push(length as u8 | 0x80);
            length >>= 7;
        }
        out.push(length as u8);
        out.extend_from_slice(content);
        out
    };
    // Node, attribute, graph, and so on; from the inside out, all of it refused at the first one.
    let mut graph = vec![];
    for _ in 0..3000 {
        graph = field(1, &field(5, &field(6, &graph)));
    }
    let model = [vec![8, 8], field(7, &graph)].concat();
    unsupported(&model, "graph of its own");
    // Types of sequences of sequences.
    let mut kind = vec![];
    for _ in 0..3000 {
        kind = field(4, &field(1, &kind));
    }
    let input = field(11, &field(2, &kind));
    unsupported(&[vec![8, 8], field(7, &input)].concat(), "no tensor");
}

#[test]
fn small_files_that_ask_for_much_memory_are_refused() {
    // Two bytes each, some hundred in memory.
    let nodes = [0x0a, 0x00].repeat(1 << 20);
    let length = [0x80, 0x80, 0x80, 0x01];
    too_large(&[&[8, 8, 0x3a][..], &length, &nodes].concat(), "operators");
    let attributes = [0x2a, 0x00].repeat(1 << 20);
    too_large(&[&[8, 8, 0x3a, 0x85, 0x80, 0x80, 0x01, 0x0a][..], &length, &attributes].concat(), "fields");

    let empty = floats("weights", &[1 << 40, 1 << 40], vec![]);
    too_large(&write(graph(tiny().node, vec![empty])), "numbers of a tensor");
    let lying = floats("weights", &[7, 3, 4, 4], vec![0.5]);
    let e = error(&write(graph(vec![node("Conv", &["image", "weights"], "out", vec![])], vec![lying])));
    assert!(matches!(e, InferenceError::Failed { .. }), "{e}");
    let negative = floats("weights", &[-7, 3, 4, 4], vec![0.5]);
    too_large(&write(graph(tiny().node, vec![negative])), "numbers of a tensor");
}

/// Each operator doubles what the one before made.
#[test]
fn what_grows_from_operator_to_operator_is_bounded() {
    let doubling = |from: &str, count: usize| {
        let name = |i: usize| {
            if i == 0 {
                from.to_owned()
            } else if i == count {
                "out".to_owned()
            } else {
                format!("v{i}")
            }
        };
        let twice = |i: usize| node("Concat", &[&name(i), &name(i)], &name(i + 1), vec![int("axis", 0)]);
        (0..count).map(twice).collect::<Vec<_>>()
    };
    too_large(&write(graph(doubling("image", 40), vec![])), "numbers of a value");
    too_large(
        &write(graph(doubling("weights", 40), vec![floats("weights", &[1], vec![1.0])])),
        "numbers of a constant",
    );
    let shape = node("Shape", &["image"], "shape", vec![]);
    too_large(&write(graph([vec![shape], doubling("shape", 40)].concat(), vec![])), "numbers of a constant");

    let size = longs("size", &[2], vec![1 << 30, 1 << 30]);
    for kind in ["ConstantOfShape", "Expand"] {
        let inputs: &[&str] = if kind == "ConstantOfShape" { &["size"] } else { &["size", "size"] };
        unsupported(&write(graph(vec![node(kind, inputs, "out", vec![])], vec![size.clone()])), kind);
    }
    // Of the image, its shape is known before it is made.
    let expand = node("Expand", &["image", "shape"], "out", vec![]);
    let shape = longs("shape", &[5], vec![100_000, 1, 3, 8, 8]);
    let e = error(&write(graph(vec![expand], vec![shape])));
    assert!(
        matches!(e, InferenceError::TooLarge { actual: 19_200_000, .. } | InferenceError::OutputMismatch { .. }),
        "{e}"
    );
    let shape = longs("shape", &[5], vec![1_000_000_000, 1, 3, 8, 8]);
    let expand = node("Expand", &["image", "shape"], "out", vec![]);
    too_large(&write(graph(vec![expand], vec![shape])), "along a side of a value");
}

#[test]
fn what_takes_too_many_multiplications_is_refused() {
    // Thousands of outputs of thousands of terms in each of 64 pixels, again and again.
    let conv = |from: &str, to: &str| node("Conv", &[from, "weights"], to, squares(3, 1, 1));
    let weights = floats("weights", &[3, 3, 3, 3], vec![0.1; 81]);
    let limits = ModelLimits { max_multiply_adds: 3 * 64 * 27 * 2 - 1, ..ModelLimits::default() };
    let model = write(graph(vec![conv("image", "a"), conv("a", "out")], vec![weights]));
    let spec = DetectorSpec::new("x", &["a"], OutputLayout::YoloV8);
    let e = Detector::new(&model, spec, &limits, &InferenceThreads::new(1)).map(|_| ()).unwrap_err();
    assert!(matches!(e, InferenceError::TooLarge { what: "multiplications", actual: 10368, .. }), "{e}");
    // A window of a million by a million.
    let pool = node("MaxPool", &["image"], "out", squares(1 << 20, 1, 1 << 19));
    too_large(&write(graph(vec![pool], vec![])), "as a stride, window, padding or dilation");
}

/// Shapes are inferred with 32 bits: 8 and twice 2^31 - 1 would be 6.
#[test]
fn sides_that_would_overflow_are_refused() {
    for pad in [i64::MAX, i64::from(i32::MAX), 1025] {
        let pads = longs("pads", &[8], vec![0, 0, 0, pad, 0, 0, 0, pad]);
        let node = node("Pad", &["image", "pads"], "out", vec![]);
        too_large(&write(graph(vec![node], vec![pads])), "as a padding, size or factor");
    }
    let computed = [node("Add", &["pads", "pads"], "twice", vec![]), node("Pad", &["image", "twice"], "out", vec![])];
    let pads = longs("pads", &[8], vec![1; 8]);
    unsupported(&write(graph(computed.to_vec(), vec![pads])), "a computed size");
    let scales = floats("scales", &[4], vec![1.0, 1.0, 536_870_912.0, 1.0]);
    let resize = node("Resize", &["image", "", "scales"], "out", vec![]);
    too_large(&write(graph(vec![resize], vec![scales])), "as a padding, size or factor");
    let pool = node("AveragePool", &["image"], "out", squares(2, 1, 1 << 32));
    too_large(&write(graph(vec![pool], vec![])), "as a stride, window, padding or dilation");
}

/// The library goes along such a chain by recursion.
#[test]
fn long_chains_are_followed_or_refused() {
    let in_small_stack = |model: Vec<u8>| {
        let thread = std::thread::Builder::new().stack_size(256 << 10);
        thread.spawn(move || build(&model).map(|_| ())).unwrap().join().unwrap()
    };
    assert_eq!(in_small_stack(write(relus(4095))), Ok(()));
    let error = in_small_stack(write(relus(4096))).unwrap_err();
    assert!(matches!(error, InferenceError::TooLarge { what: "operators", limit: 4096, .. }), "{error}");
}

#[test]
fn operators_out_of_order_and_in_circles_are_refused() {
    let circle =
        [node("Relu", &["b"], "a", vec![]), node("Relu", &["a"], "b", vec![]), node("Relu", &["b"], "out", vec![])];
    unsupported(&write(graph(circle.to_vec(), vec![])), "nothing before it makes");
    let missing = node("Add", &["image", "nothing"], "out", vec![]);
    unsupported(&write(graph(vec![missing], vec![])), "nothing before it makes");
}

/// What is counted has to be what is run.
#[test]
fn names_that_are_given_twice_are_refused() {
    let mut twice = tiny();
    twice.initializer.push(floats("bias", &[1], vec![0.0]));
    unsupported(&write(twice), "given twice");
    for name in ["image", "weights", "a"] {
        let nodes = [node("Relu", &["image"], "a", vec![]), node("Neg", &["image"], name, vec![])];
        let end = [node("Add", &["a", name], "b", vec![]), node("Add", &["b", "weights"], "out", vec![])];
        let weights = vec![floats("weights", &[1], vec![1.0])];
        unsupported(&write(graph([nodes, end].concat(), weights)), "given twice");
    }
}

/// A border around a constant, again and again; and many constants that are each as large as they may be.
#[test]
fn what_is_computed_when_a_model_is_loaded_is_bounded() {
    let weights = vec![floats("weights", &[1, 1, 1, 1], vec![1.0])];
    let name = |i: usize| if i == 0 { "weights".to_owned() } else { format!("v{i}") };
    let grow = |i: usize| node("Conv", &[&name(i), "weights"], &name(i + 1), squares(1, 1, 1024));
    let mut nodes: Vec<_> = (0..100).map(grow).collect();
    nodes.push(node("Add", &["image", "v100"], "out", vec![]));
    unsupported(&write(graph(nodes, weights)), "a constant made by");

    let weights = vec![floats("row", &[1, 4096], vec![1.0; 4096]), floats("column", &[4096, 1], vec![1.0; 4096])];
    let mut nodes: Vec<_> = (0..5).map(|i| node("Mul", &["row", "column"], &format!("m{i}"), vec![])).collect();
    nodes.push(node("Max", &["m0", "m1", "m2", "m3", "m4"], "out", vec![]));
    too_large(&write(graph(nodes, weights)), "numbers of all constants");
}

#[test]
fn weights_in_other_files_are_not_looked_for() {
    let mut outside = floats("weights", &[7, 3, 4, 4], vec![]);
    let entry = |key: &str, value: &str| StringStringEntryProto { key: Some(key.into()), value: Some(value.into()) };
    outside.external_data = vec![entry("location", "/etc/passwd")];
    outside.data_location = Some(DataLocation::EXTERNAL);
    unsupported(&write(graph(tiny().node, vec![outside])), "in another file");
}
