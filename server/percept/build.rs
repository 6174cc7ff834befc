//! Makes the page at `/`: the viewer, built by npm, or a page that says how to get it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::SystemTime;
use std::{env, fs, io};

/// Names a page that was built before, for machines that build without npm or without a network.
const PREBUILT: &str = "VIEWER_HTML";

/// What the page is made of, in `viewer/`.
const SOURCES: [&str; 7] =
    ["src", "index.html", "build.mjs", "package.json", "package-lock.json", "tsconfig.json", ".npmrc"];

const WITHOUT: &str = r#"<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>percept</title>
<link rel="icon" href="data:,">
<style>
  :root { color-scheme: light dark; }
  body { font: 16px/1.6 system-ui, sans-serif; max-width: 40rem; margin: 3rem auto; padding: 0 1.2rem; }
</style>
<h1>percept</h1>
<p>The server runs. It was built without npm, or npm met no network then, so the live 3D viewer is not in it.</p>
<p>To get the viewer, install Node.js 20 or newer on the machine that builds, and build again:</p>
<pre>touch server/percept/build.rs
cargo build --release</pre>
<p>The API is at <a href="/docs">/docs</a>, its document at <a href="/openapi.json">/openapi.json</a>.</p>
</html>
"#;

fn main() {
    let manifest = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default());
    let viewer = manifest.join("../../viewer");
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed={PREBUILT}");
    for source in SOURCES.iter().map(|name| viewer.join(name)).filter(|path| path.exists()) {
        println!("cargo:rerun-if-changed={}", source.display());
    }
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default());
    let page = page(&viewer, &out).unwrap_or_else(|why| {
        println!("cargo:warning=the live viewer is left out: {why}");
        WITHOUT.as_bytes().to_vec()
    });
    let path = out.join("viewer.html");
    if let Err(e) = fs::write(&path, page) {
        // The compiler says the same once more, where the page is included.
        println!("cargo:warning={}: {e}", path.display());
    }
}

/// The viewer's page, or why there is none.
fn page(viewer: &Path, out: &Path) -> Result<Vec<u8>, String> {
    if let Some(path) = env::var_os(PREBUILT).filter(|path| !path.is_empty()) {
        println!("cargo:rerun-if-changed={}", Path::new(&path).display());
        return fs::read(&path).map_err(|e| format!("{PREBUILT}, {}: {e}", Path::new(&path).display()));
    }
    npm(out, &["--version"])?;
    let copied;
    let folder = if is_writable(viewer) {
        viewer
    } else {
        copied = out.join("viewer");
        for name in SOURCES {
            copy(&viewer.join(name), &copied.join(name)).map_err(|e| format!("{name} cannot be copied: {e}"))?;
        }
        &copied
    };
    if is_stale(folder) {
        // Without scripts of packages: none of them needs one. Without a network it gives up soon.
        npm(folder, &["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--prefer-offline", "--fetch-retries=1"])?;
    }
    npm(folder, &["run", "build"])?;
    fs::read(folder.join("dist/index.html")).map_err(|e| format!("dist/index.html: {e}"))
}

/// Runs npm there; what it says is shown if it fails.
fn npm(folder: &Path, arguments: &[&str]) -> Result<(), String> {
    let said = Command::new("npm").args(arguments).current_dir(folder).output();
    let said = said.map_err(|e| format!("npm cannot be run ({e}); install Node.js 20 or newer"))?;
    if said.status.success() {
        return Ok(());
    }
    let error = String::from_utf8_lossy(&said.stderr);
    let line = error.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or("it does not say why");
    Err(format!("npm {} failed: {line}", arguments.first().copied().unwrap_or_default()))
}

/// Whether the packages are absent, or older than the lock file.
fn is_stale(folder: &Path) -> bool {
    let changed = |path: PathBuf| -> Option<SystemTime> { fs::metadata(path).ok()?.modified().ok() };
    let installed = changed(folder.join("node_modules/.package-lock.json"));
    let locked = changed(folder.join("package-lock.json"));
    installed.is_none_or(|installed| locked.is_some_and(|locked| locked > installed))
}

/// Tries it, in a folder that the build makes anyway.
fn is_writable(viewer: &Path) -> bool {
    let folder = viewer.join("dist");
    let probe = folder.join(format!(".probe-{}", std::process::id()));
    let is_written = fs::create_dir_all(&folder).is_ok() && fs::write(&probe, b"").is_ok();
    is_written && fs::remove_file(&probe).is_ok()
}

/// A file or a folder with all that is in it; what is not there is left out.
fn copy(from: &Path, to: &Path) -> io::Result<()> {
    if from.is_dir() {
        fs::create_dir_all(to)?;
        for entry in fs::read_dir(from)? {
            let entry = entry?;
            copy(&entry.path(), &to.join(entry.file_name()))?;
        }
    } else if from.exists() {
        if let Some(folder) = to.parent() {
            fs::create_dir_all(folder)?;
        }
        // Read and written, not copied: the source's mode would make the copy read-only as well.
        fs::write(to, fs::read(from)?)?;
    }
    Ok(())
}
