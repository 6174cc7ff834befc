//! percept-planning.
