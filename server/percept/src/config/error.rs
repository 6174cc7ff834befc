//! What can be wrong with a configuration.

use super::origin::Origins;
use std::path::{Path, PathBuf};

/// A configuration that cannot be used: where it was set, field, value, remedy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read configuration {}: {message}; `percept config` prints one to start from", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        message: String,
    },
    /// The file is not TOML, or has an unknown field or a value of another type.
    #[error("{}:{line}: {message}; `percept config` prints every field with its default", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is there, and what could be.
        message: String,
    },
    /// A variable of the environment that sets nothing.
    #[error("environment: unknown variable {name}{}; correct or unset it", suggestion(nearest))]
    UnknownVariable {
        /// The variable.
        name: String,
        /// The known one that is written most alike, if any is near.
        nearest: Option<String>,
    },
    /// A variable of the environment whose value is of another type.
    #[error("environment: {name} is {value:?}; {expected}")]
    Variable {
        /// The variable.
        name: String,
        /// Its value.
        value: String,
        /// What it should be.
        expected: String,
    },
    /// A value outside its bounds.
    #[error("{}{field}{problem}", prefix(origin))]
    OutOfBounds {
        /// Where it was set: file and line, or variable; none if by default or flag.
        origin: Option<String>,
        /// Path of the field, e.g. `limits.max_sessions`.
        field: String,
        /// Value and remedy.
        problem: String,
    },
}

impl ConfigError {
    /// What toml found, with its line.
    pub(super) fn syntax(path: &Path, text: &str, error: &toml::de::Error) -> Self {
        let start = error.span().map_or(0, |span| span.start);
        let line = 1 + text.bytes().take(start).filter(|&byte| byte == b'\n').count();
        let shown = text.lines().nth(line - 1).map_or("", str::trim);
        let message = error.message().trim_end().replace('\n', ", ");
        let message = if shown.is_empty() { message } else { format!("{message} in `{shown}`") };
        Self::Syntax { path: path.to_owned(), line, message }
    }

    /// What `validate` of a section of the session's parameters said: its message begins with the
    /// field.
    pub(super) fn params(section: &str, message: String) -> Self {
        let end = message.find(|c: char| !(c.is_ascii_alphanumeric() || "_.".contains(c))).unwrap_or(message.len());
        let (field, problem) = message.split_at(end);
        Self::OutOfBounds { origin: None, field: format!("params.{section}.{field}"), problem: problem.to_owned() }
    }

    /// The same, with where the field was set.
    pub(super) fn located(mut self, origins: &Origins) -> Self {
        if let Self::OutOfBounds { origin, field, .. } = &mut self {
            *origin = origins.of(field);
        }
        self
    }
}

fn suggestion(nearest: &Option<String>) -> String {
    nearest.as_ref().map_or_else(String::new, |name| format!(", perhaps meant: {name}"))
}

fn prefix(origin: &Option<String>) -> String {
    origin.as_ref().map_or_else(String::new, |origin| format!("{origin}: "))
}
