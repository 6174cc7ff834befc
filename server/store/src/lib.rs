//! percept-store.
