//! A message as a tree of names and values, whatever its type: for showing and comparing.

/// A value of a message.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// True or false.
    Bool(bool),
    /// Any integer.
    Integer(i128),
    /// A float; of 32 bits, the same number in 64.
    Float(f64),
    /// A string.
    Text(String),
    /// An array or a sequence.
    List(Vec<Value>),
    /// A message's fields by name, in the order of the definition.
    Fields(Vec<(&'static str, Value)>),
}
