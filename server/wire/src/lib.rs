//! percept-wire.
