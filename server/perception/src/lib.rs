//! percept-perception.
