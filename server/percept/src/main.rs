//! The percept binary.
fn main() {}
