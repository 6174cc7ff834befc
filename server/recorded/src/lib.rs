//! Tests on recorded data: run where the data are, counted as ignored where they are not.
//!
//! Cargo's own harness counts a test that returns early as passed. A test target with `harness = false` lists its tests
//! here instead, each with the sets that it needs; what is absent is said beside the test's name. Arguments are those of
//! the usual harness.

use libtest_mimic::{Arguments, Completion, Failed, Trial};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// A test, and what it needs.
pub struct Test {
    /// Its name.
    pub name: &'static str,
    /// Sets or files of the recorded data, by their paths in that folder.
    pub needs: &'static [&'static str],
    /// The test, which gets the folder of the recorded data; it fails by panicking.
    pub run: fn(&Path),
}

/// The `main` of a test target: `tests! { name: "set", "another set"; ... }`, where each name is that of a function that
/// gets the folder of the recorded data.
#[macro_export]
macro_rules! tests {
    ($($name:ident: $($set:literal),+;)+) => {
        fn main() -> std::process::ExitCode {
            $crate::run(&[$($crate::Test { name: stringify!($name), needs: &[$($set),+], run: $name }),+])
        }
    };
}

/// Runs those whose data are there, as the process's arguments ask.
pub fn run(tests: &[Test]) -> ExitCode {
    let trials = tests.iter().map(|test| trial(test, folder())).collect();
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}

/// The folder of the recorded data: `PERCEPT_DATA`, else `shared/data` beside the repository.
fn folder() -> PathBuf {
    let by_default = || package().join("../../../shared/data");
    std::env::var_os("PERCEPT_DATA").map_or_else(by_default, PathBuf::from)
}

/// The package that is being tested. Asked when it runs: what was built in one checkout may be run in another.
fn package() -> PathBuf {
    std::env::var_os("CARGO_MANIFEST_DIR").map_or_else(|| env!("CARGO_MANIFEST_DIR").into(), PathBuf::from)
}

fn trial(test: &Test, data: PathBuf) -> Trial {
    let Test { name, needs, run } = *test;
    Trial::ignorable_test(name, move || Ok::<_, Failed>(completed(&data, needs, run)))
}

fn completed(data: &Path, needs: &[&str], run: impl FnOnce(&Path)) -> Completion {
    match needs.iter().find(|set| !data.join(set).exists()) {
        Some(absent) => Completion::ignored_with(format!("skipped: {} is absent", data.join(absent).display())),
        None => {
            run(data);
            Completion::Completed
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_test_whose_data_are_absent_is_ignored_and_says_what_is_missing() {
        let completion = completed(&package(), &["src", "no-such-set"], |_| panic!("has to be skipped"));
        let Completion::Ignored { reason: Some(reason) } = completion else { panic!("it was run") };
        assert!(reason.starts_with("skipped: ") && reason.ends_with("no-such-set is absent"), "{reason}");
    }

    #[test]
    fn a_test_whose_data_are_there_runs() {
        let mut has_run = false;
        let completion = completed(&package(), &["src", "Cargo.toml"], |data| has_run = data.join("src").is_dir());
        assert!(has_run && matches!(completion, Completion::Completed));
    }
}
