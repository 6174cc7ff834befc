//! percept-pipeline.
