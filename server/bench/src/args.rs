//! Arguments of an operation: `key=value`.

use crate::BenchError;
use std::collections::BTreeMap;
use std::str::FromStr;

/// The arguments of one operation; each is read once by name.
#[derive(Debug, Clone, Default)]
pub struct Args(BTreeMap<String, String>);

impl Args {
    /// Splits `key=value` words.
    ///
    /// # Errors
    /// A word without `=`.
    pub fn parse(words: &[String]) -> Result<Self, BenchError> {
        let pair = |word: &String| {
            let (key, value) = word.split_once('=').ok_or_else(|| BenchError(format!("{word:?} is not key=value")))?;
            Ok((key.to_owned(), value.to_owned()))
        };
        Ok(Self(words.iter().map(pair).collect::<Result<_, BenchError>>()?))
    }

    /// A value that has to be there.
    ///
    /// # Errors
    /// It is not there, or not of this type.
    pub fn required<T: FromStr>(&self, key: &str) -> Result<T, BenchError> {
        self.optional(key)?.ok_or_else(|| BenchError(format!("{key}= is missing")))
    }

    /// A value that may be there.
    ///
    /// # Errors
    /// It is not of this type.
    pub fn optional<T: FromStr>(&self, key: &str) -> Result<Option<T>, BenchError> {
        let Some(value) = self.0.get(key) else { return Ok(None) };
        value.parse().map(Some).map_err(|_| BenchError(format!("{key}={value} cannot be read")))
    }

    /// A value, or what stands for its absence.
    ///
    /// # Errors
    /// It is not of this type.
    pub fn or<T: FromStr>(&self, key: &str, absent: T) -> Result<T, BenchError> {
        Ok(self.optional(key)?.unwrap_or(absent))
    }
}
