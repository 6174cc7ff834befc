use super::*;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Crates that refuse requests.
const CRATES: [&str; 4] = ["identity", "service", "wire", "percept"];

/// Words in capitals that are no reasons: codes of gRPC, variables of the environment, names of the contract, a word of Foxglove's.
fn is_other(word: &str) -> bool {
    let codes =
        ["ALREADY_EXISTS", "DATA_LOSS", "FAILED_PRECONDITION", "INVALID_ARGUMENT", "NOT_FOUND", "RESOURCE_EXHAUSTED"];
    let prefixes = [
        "PERCEPT_",
        "ROS_DISTRO",
        "CARGO_",
        "OUT_DIR",
        "FEATURE_METHOD_",
        "SENSOR_KIND_",
        "RELATION_KIND_",
        "NO_PATH_REASON_",
        "BLOCKING_STATE_",
        "TEST_",
    ];
    codes.contains(&word) || prefixes.iter().any(|prefix| word.starts_with(prefix))
}

fn sources() -> Vec<(PathBuf, String)> {
    fn collect(folder: &Path, out: &mut Vec<(PathBuf, String)>) {
        for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
            let path = entry.path();
            if path.is_dir() {
                collect(&path, out);
            } else if path.extension().is_some_and(|e| e == "rs") && !path.ends_with("tests.rs") {
                let text = std::fs::read_to_string(&path).unwrap();
                // Tests may say what they like.
                let code = text.split("\n#[cfg(test)]").next().unwrap_or_default().to_owned();
                out.push((path, code));
            }
        }
    }
    let mut out = vec![];
    let server = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    CRATES.iter().for_each(|name| collect(&server.join(name).join("src"), &mut out));
    // What a store is found to be damaged by is a finding of `percept store check`, and no error.
    out.retain(|(path, _)| !path.ends_with("reason.rs") && !path.ends_with("cli/store.rs"));
    out
}

/// Texts in quotes that look like a reason.
fn words(code: &str) -> impl Iterator<Item = &str> {
    let quoted = code
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"))
        .flat_map(|line| line.split('"').skip(1).step_by(2));
    quoted.filter(|word| {
        word.contains('_')
            && word.starts_with(|c: char| c.is_ascii_uppercase())
            && word.bytes().all(|b| b.is_ascii_uppercase() || b.is_ascii_digit() || b == b'_')
    })
}

#[test]
fn every_reason_in_the_code_is_in_the_catalogue() {
    let missing: BTreeSet<String> = sources()
        .iter()
        .flat_map(|(path, code)| {
            let unknown = words(code).filter(|word| !is_other(word) && entry(word).is_none());
            unknown.map(move |word| format!("{word} in {}", path.display())).collect::<Vec<_>>()
        })
        .collect();
    assert!(missing.is_empty(), "say in service/src/reason.rs what these mean: {missing:#?}");
}

#[test]
fn every_reason_in_the_catalogue_is_used_and_says_what_it_means() {
    let sources = sources();
    let mut names = BTreeSet::new();
    for Entry { name, about, .. } in CATALOGUE {
        assert!(names.insert(*name), "{name} is there twice");
        assert!(about.ends_with('.') && about.len() > 20, "{name}: {about}");
        // Said, taken from here, or within a text that is said.
        let said = [format!("\"{name}\""), format!("reason::{name}"), format!("\"{name}\\\"")];
        let used = sources.iter().any(|(_, code)| said.iter().any(|text| code.contains(text)));
        assert!(used, "{name} is given by nobody");
    }
    assert!(names.len() > 100);
}

#[test]
fn the_page_shows_the_catalogue() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reasons.md");
    assert!(std::fs::read_to_string(path).unwrap() == markdown(), "docs/reasons.md is stale: run docs/refresh-reasons");
}
