//! percept-mapping.
