//! Credentials as a server meets them: files that change, tokens made by friends and by others.

// Helpers of tests may fail like tests.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

mod keys;
mod tokens;
