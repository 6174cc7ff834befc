//! The binary container: accessors over one buffer, in two chunks.

use crate::FormatError;
use serde_json::{Map, Value, json};

/// What a view of the buffer is for.
#[derive(Debug, Clone, Copy)]
pub(super) enum Target {
    Vertices = 34962,
    Indices = 34963,
}

/// Component types of accessors.
const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;

/// The buffer that grows, with its views and accessors. All of its parts are multiples of four bytes.
#[derive(Debug, Default)]
pub(super) struct Container {
    buffer: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Container {
    pub(super) fn new() -> Self {
        Self::default()
    }

    /// Number of the accessor of triples, with the smallest and largest of each coordinate if given.
    pub(super) fn floats(&mut self, values: &[[f32; 3]], bounds: Option<([f32; 3], [f32; 3])>) -> Value {
        let bytes = values.iter().flatten().flat_map(|v| v.to_le_bytes());
        let mut accessor = json!({ "componentType": F32, "count": values.len(), "type": "VEC3" });
        if let Some((min, max)) = bounds {
            accessor["min"] = json!(min.map(f64::from));
            accessor["max"] = json!(max.map(f64::from));
        }
        self.add(bytes, Target::Vertices, accessor)
    }

    /// Number of the accessor of colours with opacity, 65535 being one.
    pub(super) fn colors(&mut self, values: &[[u16; 4]]) -> Value {
        let bytes = values.iter().flatten().flat_map(|v| v.to_le_bytes());
        let accessor = json!({ "componentType": U16, "normalized": true, "count": values.len(), "type": "VEC4" });
        self.add(bytes, Target::Vertices, accessor)
    }

    /// Number of the accessor of indices.
    pub(super) fn indices(&mut self, values: &[u32]) -> Value {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes());
        let accessor = json!({ "componentType": U32, "count": values.len(), "type": "SCALAR" });
        self.add(bytes, Target::Indices, accessor)
    }

    fn add(&mut self, bytes: impl Iterator<Item = u8>, target: Target, mut accessor: Value) -> Value {
        let offset = self.buffer.len();
        self.buffer.extend(bytes);
        let length = self.buffer.len() - offset;
        accessor["bufferView"] = json!(self.views.len());
        let view = json!({ "buffer": 0, "byteOffset": offset, "byteLength": length, "target": target as u32 });
        self.views.push(view);
        self.accessors.push(accessor);
        json!(self.accessors.len() - 1)
    }

    /// The file: `document` with views and accessors, then the buffer if it holds anything.
    pub(super) fn finish(self, mut document: Map<String, Value>) -> Result<Vec<u8>, FormatError> {
        if !self.buffer.is_empty() {
            document.insert("buffers".to_owned(), json!([{ "byteLength": self.buffer.len() }]));
            document.insert("bufferViews".to_owned(), self.views.into());
            document.insert("accessors".to_owned(), self.accessors.into());
        }
        let mut text = Value::Object(document).to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let chunks = [(b"JSON", &text), (b"BIN\0", &self.buffer)];
        let chunks = chunks.into_iter().filter(|(_, content)| !content.is_empty());
        let length = 12 + chunks.clone().map(|(_, content)| 8 + content.len()).sum::<usize>();
        let mut out = Vec::with_capacity(length);
        out.extend(b"glTF");
        out.extend(2u32.to_le_bytes());
        out.extend(size(length)?);
        for (kind, content) in chunks {
            out.extend(size(content.len())?);
            out.extend(kind);
            out.extend(content);
        }
        Ok(out)
    }
}

pub(super) fn size(length: usize) -> Result<[u8; 4], FormatError> {
    let (value, limit) = (length as u64, u64::from(u32::MAX));
    let too_large = FormatError::TooLarge { field: "num_bytes", value, limit };
    Ok(u32::try_from(length).map_err(|_| too_large)?.to_le_bytes())
}
