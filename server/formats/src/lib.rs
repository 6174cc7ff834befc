//! percept-formats.
