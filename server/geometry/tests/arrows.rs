//! Holds the arrows between the crates as ARCHITECTURE.md draws them: reads every manifest and the core's sources.

// Helpers of tests may fail like tests.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Each crate looks only at crates before it.
const ORDER: [&str; 22] = [
    "geometry",
    "sim",
    "evaluation",
    "perception",
    "mapping",
    "slam",
    "scene",
    "planning",
    "pipeline",
    "recorded",
    "ros",
    "bags",
    "recorder",
    "formats",
    "pictures",
    "inference",
    "bench",
    "store",
    "identity",
    "service",
    "wire",
    "percept",
];

/// The last crate of the core.
const LAST_OF_CORE: &str = "pipeline";

/// All that the core may use from outside: mathematics, randomness from a seed, threads of the caller's pool.
const CORE_MAY_USE: [&str; 9] =
    ["amd", "nalgebra", "rand", "rand_chacha", "rand_distr", "rayon", "rustc-hash", "serde", "thiserror"];

/// `pipeline` introduces these; they do not know each other.
const STRANGERS: [&str; 3] = ["slam", "scene", "planning"];

/// What belongs to whom: dependencies that begin so, and the crates that may have them.
const KEPT_BY: [(&str, &[&str]); 10] = [
    ("prost", &["wire", "percept"]),
    ("tonic", &["wire", "percept"]),
    ("axum", &["percept"]),
    ("tower", &["percept"]),
    ("zenoh", &["percept"]),
    ("slatedb", &["store"]),
    ("ring", &["identity"]),
    ("rten", &["inference"]),
    ("prometheus", &["service", "percept"]),
    ("opentelemetry", &["percept"]),
];

/// Absent from the core's sources: files, sockets, threads and processes of its own, environment, clocks.
const ABSENT: [&str; 14] = [
    "std::fs",
    "std::net",
    "std::thread",
    "std::process",
    "std::env",
    "std::io::std",
    "SystemTime",
    "Instant::",
    "std::time::Instant",
    "ThreadPoolBuilder",
    "rayon::spawn",
    "async fn",
    "println!",
    "static mut",
];

fn server() -> PathBuf {
    Path::new(&std::env::var("CARGO_MANIFEST_DIR").unwrap()).parent().unwrap().to_owned()
}

fn place(name: &str) -> usize {
    ORDER.iter().position(|n| *n == name).unwrap_or_else(|| panic!("{name} has no place in ORDER"))
}

fn core() -> &'static [&'static str] {
    &ORDER[..=place(LAST_OF_CORE)]
}

/// Names under `[dependencies]` and `[target.….dependencies]` of each crate; not those of tests and builds.
fn dependencies() -> BTreeMap<String, Vec<String>> {
    let folders = fs::read_dir(server()).unwrap().map(|entry| entry.unwrap().path());
    folders
        .filter(|folder| folder.join("Cargo.toml").exists())
        .map(|folder| {
            let manifest = fs::read_to_string(folder.join("Cargo.toml")).unwrap();
            (folder.file_name().unwrap().to_string_lossy().into_owned(), names(&manifest))
        })
        .collect()
}

fn names(manifest: &str) -> Vec<String> {
    let mut inside = false;
    let mut names = Vec::new();
    for line in manifest.lines().map(str::trim) {
        if let Some(section) = line.strip_prefix('[') {
            inside =
                section == "dependencies]" || (section.starts_with("target.") && section.ends_with(".dependencies]"));
        } else if inside && !line.starts_with('#') && line.contains('=') {
            names.push(line.split(['.', '=', ' ']).next().unwrap().trim_matches('"').to_owned());
        }
    }
    names
}

#[test]
fn every_crate_has_its_place() {
    let found: Vec<String> = dependencies().into_keys().collect();
    let mut expected = ORDER.map(str::to_owned).to_vec();
    expected.sort();
    assert_eq!(found, expected);
}

#[test]
fn crates_look_only_at_crates_above_them() {
    for (name, dependencies) in dependencies() {
        for ours in dependencies.iter().filter_map(|d| d.strip_prefix("percept-")) {
            assert!(place(ours) < place(&name), "{name} looks at {ours}, which stands below it");
        }
    }
}

#[test]
fn slam_scene_and_planning_do_not_know_each_other() {
    let all = dependencies();
    for name in STRANGERS {
        let known = STRANGERS.iter().find(|other| all[name].contains(&format!("percept-{other}")));
        assert_eq!(known, None, "{name} knows {known:?}");
    }
}

#[test]
fn the_core_uses_only_mathematics_and_the_callers_threads() {
    let all = dependencies();
    for name in core() {
        for used in all[*name].iter().filter(|d| !d.starts_with("percept-")) {
            assert!(CORE_MAY_USE.contains(&used.as_str()), "{name} uses {used}: it belongs below the core");
        }
    }
}

#[test]
fn protocols_and_storage_stay_where_they_belong() {
    for (name, dependencies) in dependencies() {
        for (prefix, keepers) in KEPT_BY {
            let used = dependencies.iter().find(|d| d.starts_with(prefix));
            assert!(used.is_none() || keepers.contains(&name.as_str()), "{name} uses {used:?}; only {keepers:?} may");
        }
    }
}

#[test]
fn the_core_has_no_files_sockets_clock_environment_or_threads() {
    for name in core() {
        for file in sources(&server().join(name).join("src")) {
            let text = fs::read_to_string(&file).unwrap();
            for line in outside_tests(&text) {
                let found = ABSENT.iter().find(|word| line.replace("use std::{", "std::").contains(**word));
                assert_eq!(found, None, "{}: `{}`", file.display(), line.trim());
            }
        }
    }
}

/// Rust files below `folder`, but those that hold tests alone.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if path.is_dir() && name != "tests" {
            found.extend(sources(&path));
        } else if name.ends_with(".rs") && !name.contains("tests") {
            found.push(path);
        }
    }
    found
}

/// Lines of code: without comments, and without what follows `#[cfg(test)] mod tests`, which ends a file.
fn outside_tests(text: &str) -> impl Iterator<Item = &str> {
    let lines: Vec<&str> = text.lines().collect();
    let is_tests =
        |i: usize| lines[i].starts_with("#[cfg(test)]") && lines.get(i + 1).is_some_and(|l| l.starts_with("mod "));
    let end = (0..lines.len()).find(|&i| is_tests(i)).unwrap_or(lines.len());
    lines.into_iter().take(end).map(|line| line.split("//").next().unwrap_or(""))
}
