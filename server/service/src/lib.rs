//! percept-service.
