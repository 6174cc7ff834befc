//! What a message is made of, gathered from the declarations that the codec is made of: names, types, order.

use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The fields of messages by the message's name; sorted, as the canonical form needs them.
pub type Definitions = BTreeMap<&'static str, Vec<Field>>;

/// A field of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: &'static str,
    /// Its type.
    pub field_type: FieldType,
}

/// A field's type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FieldType {
    /// What it is, or has several of.
    pub base: Base,
    /// One or many.
    pub many: Many,
}

/// How many of its base a field has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Many {
    /// One.
    One,
    /// A fixed number.
    Array(usize),
    /// As many as the bytes say.
    Sequence,
}

/// A type that is no array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Base {
    /// A message.
    Nested(&'static str),
    /// `int8`.
    Int8,
    /// `uint8`.
    Uint8,
    /// `int16`.
    Int16,
    /// `uint16`.
    Uint16,
    /// `int32`.
    Int32,
    /// `uint32`.
    Uint32,
    /// `int64`.
    Int64,
    /// `uint64`.
    Uint64,
    /// `float32`.
    Float32,
    /// `float64`.
    Float64,
    /// `bool`.
    Bool,
    /// `string`.
    String,
}

impl Base {
    /// Its number and its name in `.msg` files. Source: `type_description_interfaces/msg/FieldType`, ROS 2.
    fn number_and_name(self) -> (u8, &'static str) {
        match self {
            Self::Nested(name) => (1, name),
            Self::Int8 => (2, "int8"),
            Self::Uint8 => (3, "uint8"),
            Self::Int16 => (4, "int16"),
            Self::Uint16 => (5, "uint16"),
            Self::Int32 => (6, "int32"),
            Self::Uint32 => (7, "uint32"),
            Self::Int64 => (8, "int64"),
            Self::Uint64 => (9, "uint64"),
            Self::Float32 => (10, "float32"),
            Self::Float64 => (11, "float64"),
            Self::Bool => (15, "bool"),
            Self::String => (17, "string"),
        }
    }
}

impl FieldType {
    /// One of `base`.
    pub fn one(base: Base) -> Self {
        Self { base, many: Many::One }
    }

    pub(crate) fn sequence(self) -> Self {
        Self { many: Many::Sequence, ..self }
    }

    pub(crate) fn array(self, length: usize) -> Self {
        Self { many: Many::Array(length), ..self }
    }

    fn nested_name(self) -> &'static str {
        if let Base::Nested(name) = self.base { name } else { "" }
    }
}

/// The type description of `name` as the canonical JSON that is hashed.
///
/// Source: REP-2016, "Type description", and `rosidl`'s `generate_type_hash`: one line, `, ` and `: ` between, fields in the
/// order of the definition, the types that are referred to sorted by name, no default values.
pub(crate) fn canonical_json(name: &str, definitions: &Definitions) -> String {
    let own = definitions.get(name).map_or(&[][..], Vec::as_slice);
    let others: Vec<String> = definitions
        .iter()
        .filter(|(other, _)| **other != name)
        .map(|(other, fields)| individual(other, fields))
        .collect();
    let (own, others) = (individual(name, own), others.join(", "));
    format!(r#"{{"type_description": {own}, "referenced_type_descriptions": [{others}]}}"#)
}

fn individual(name: &str, fields: &[Field]) -> String {
    let field = |Field { name, field_type }: &Field| {
        let (number, _) = field_type.base.number_and_name();
        let (number, capacity) = match field_type.many {
            Many::One => (number, 0),
            Many::Array(length) => (number + 48, length),
            Many::Sequence => (number + 144, 0),
        };
        let nested = field_type.nested_name();
        format!(
            r#"{{"name": "{name}", "type": {{"type_id": {number}, "capacity": {capacity}, "string_capacity": 0, "nested_type_name": "{nested}"}}}}"#
        )
    };
    let fields: Vec<String> = fields.iter().map(field).collect();
    format!(r#"{{"type_name": "{name}", "fields": [{}]}}"#, fields.join(", "))
}

/// The definition of `name` in `.msg` files' words, those of the types that it needs behind it (MCAP's schema encoding
/// `ros2msg`).
pub(crate) fn text(name: &str, definitions: &Definitions) -> String {
    let mut out = definitions.get(name).map_or_else(String::new, |fields| lines(fields));
    for (other, fields) in definitions.iter().filter(|(other, _)| **other != name) {
        // Writing to a string does not fail.
        let _ = write!(out, "{}\nMSG: {}\n{}", "=".repeat(80), short(other), lines(fields));
    }
    out
}

fn lines(fields: &[Field]) -> String {
    let line = |Field { name, field_type }: &Field| {
        let base = short(field_type.base.number_and_name().1);
        match field_type.many {
            Many::One => format!("{base} {name}\n"),
            Many::Array(length) => format!("{base}[{length}] {name}\n"),
            Many::Sequence => format!("{base}[] {name}\n"),
        }
    };
    fields.iter().map(line).collect()
}

/// `std_msgs/Header` of `std_msgs/msg/Header`.
fn short(name: &str) -> String {
    name.replacen("/msg/", "/", 1)
}
