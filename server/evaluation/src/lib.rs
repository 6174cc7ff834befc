//! percept-evaluation.
