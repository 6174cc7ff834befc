//! `percept store`: check, export, import and back up what is stored. A server may run on it meanwhile.

use super::Failure;
use crate::config::{Config, Storage};
use crate::storage;
use clap::{Args, Subcommand};
use indicatif::ProgressBar;
use percept_service::read_record;
use percept_store::archive::{export_sessions, import_sessions};
use percept_store::backup::backup;
use percept_store::check::{Fault, Progress, SessionReport, check};
use percept_store::{DataRoot, RootConfig, StoreError};
use serde_json::json;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use tokio::io::{AsyncRead, AsyncWriteExt, BufReader, BufWriter};

#[derive(Debug, Subcommand)]
pub(crate) enum StoreCommand {
    /// Read everything that is stored and say what is damaged; mends nothing. Exits with 1 if anything is.
    Check(Check),
    /// Write sessions into one file, which `import` reads.
    Export(Export),
    /// Add the sessions of an exported file; sessions that are there stay as they are. A running server finds them within
    /// seconds.
    Import(Import),
    /// Bring a copy of all sessions up to date: only what changed is copied. The copy is a place like any other: a server
    /// serves it, and a backup of it into an empty place restores it.
    Backup(Backup),
}

/// Where data are stored.
#[derive(Debug, Args)]
pub(crate) struct PlaceArgs {
    /// Directory in which everything is stored; instead of storage.data_dir.
    #[arg(long, conflicts_with = "store_url")]
    data_dir: Option<PathBuf>,
    /// Object store in which everything is stored, such as s3://bucket/prefix; instead of storage.url.
    #[arg(long)]
    store_url: Option<String>,
}

impl PlaceArgs {
    /// Flags override the configuration.
    pub(crate) fn lay_over(self, storage: &mut Storage) {
        if let Some(directory) = self.data_dir {
            storage.data_dir = directory;
            storage.url = String::new();
        }
        if let Some(url) = self.store_url {
            storage.url = url;
        }
    }
}

#[derive(Debug, Args)]
struct Source {
    /// Configuration file, for its section storage.
    #[arg(long, env = "PERCEPT_CONFIG")]
    config: Option<PathBuf>,
    #[command(flatten)]
    place: PlaceArgs,
}

impl Source {
    fn storage(self) -> Result<Storage, Failure> {
        let mut config = Config::load(self.config.as_deref())?;
        self.place.lay_over(&mut config.storage);
        config.validate()?;
        Ok(config.storage)
    }
}

#[derive(Debug, Args)]
pub(crate) struct Check {
    #[command(flatten)]
    source: Source,
    /// Print one JSON object a session.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Export {
    #[command(flatten)]
    source: Source,
    /// Session to export; can be given several times. All of them if it is not given.
    #[arg(long = "session")]
    sessions: Vec<String>,
    /// File to write; - for standard output.
    file: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct Import {
    #[command(flatten)]
    source: Source,
    /// File to read; - for standard input.
    file: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct Backup {
    #[command(flatten)]
    source: Source,
    /// Where the copy is: a directory, made if absent, or a URL such as s3://bucket/prefix.
    to: String,
}

pub(crate) fn run(command: StoreCommand) -> Result<(), Failure> {
    let runtime = tokio::runtime::Runtime::new()?;
    runtime.block_on(async {
        match command {
            StoreCommand::Check(args) => check_all(args).await,
            StoreCommand::Export(args) => export(args).await,
            StoreCommand::Import(args) => import(args).await,
            StoreCommand::Backup(args) => back_up(args).await,
        }
    })
}

async fn check_all(args: Check) -> Result<(), Failure> {
    let root = open_to_read(&args.source.storage()?).await?;
    let bar = bar();
    let reports = check(&root, &read_record, &mut |progress| follow(&bar, &progress)).await?;
    bar.finish_and_clear();
    for report in &reports {
        if args.json {
            println!("{}", as_json(report));
        } else {
            print(report);
        }
    }
    let num_damaged = reports.iter().filter(|report| !report.faults.is_empty()).count();
    if num_damaged > 0 {
        return Err(format!("{num_damaged} of {} sessions are damaged", reports.len()).into());
    }
    eprintln!("percept: {} sessions, all whole", reports.len());
    Ok(())
}

async fn export(args: Export) -> Result<(), Failure> {
    let root = open_to_read(&args.source.storage()?).await?;
    let chosen = (!args.sessions.is_empty()).then_some(args.sessions.as_slice());
    let bar = bar();
    let mut told = |progress| follow(&bar, &progress);
    if args.file == Path::new("-") {
        export_sessions(&root, chosen, &mut BufWriter::new(stream(std::io::stdout())?), &read_record, &mut told)
            .await?;
    } else {
        // A file of this name is a whole export, or what it was before.
        let mut part = args.file.clone().into_os_string();
        part.push(".part");
        // It shows what the maps do: for whoever exports it alone.
        let file = tokio::fs::OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(&part).await;
        let mut writer = BufWriter::new(file.map_err(|e| format!("cannot write {}: {e}", part.display()))?);
        if let Err(error) = export_sessions(&root, chosen, &mut writer, &read_record, &mut told).await {
            let _ = tokio::fs::remove_file(&part).await;
            return Err(error.into());
        }
        writer.flush().await?;
        writer.get_ref().sync_all().await?;
        tokio::fs::rename(&part, &args.file).await?;
    }
    bar.finish_and_clear();
    eprintln!("percept: {} sessions exported", bar.position());
    Ok(())
}

async fn import(args: Import) -> Result<(), Failure> {
    let storage = args.source.storage()?;
    let location = storage::location(&storage)?;
    let file: Box<dyn AsyncRead + Unpin + Send> = if args.file == Path::new("-") {
        Box::new(stream(std::io::stdin())?)
    } else {
        let file = tokio::fs::File::open(&args.file).await;
        Box::new(file.map_err(|e| format!("cannot read {}: {e}", args.file.display()))?)
    };
    let root = match DataRoot::open(RootConfig::at(location.clone())).await {
        // Other sessions than those of the server are added beside it; but it alone may bring old data to the new format.
        Err(StoreError::DirectoryInUse { .. }) => {
            open_to_read(&storage).await?;
            let mut config = RootConfig::at(location);
            config.lock_directory = false;
            DataRoot::open(config).await
        }
        opened => opened,
    };
    let root = root.map_err(|error| at(&place(&storage), error))?;
    let mut told = |progress: Progress| eprintln!("percept: imported {}", progress.id);
    let done = import_sessions(&root, &mut BufReader::new(file), &mut told).await?;
    root.leave().await?;
    eprintln!("percept: {} sessions imported", done.len());
    Ok(())
}

async fn back_up(args: Backup) -> Result<(), Failure> {
    let storage = args.source.storage()?;
    let from = open_to_read(&storage).await?;
    let to = DataRoot::open(RootConfig::at(storage::parse(&args.to, &storage)?)).await;
    let to = to.map_err(|error| at(&args.to, error))?;
    let bar = bar();
    let report = backup(&from, &to, &read_record, &mut |progress| follow(&bar, &progress)).await;
    let report = report.map_err(|error| at(&args.to, error))?;
    to.leave().await?;
    bar.finish_and_clear();
    println!(
        "{}",
        json!({
            "sessions": report.num_sessions,
            "records": report.num_records,
            "blobs": report.num_blobs,
            "bytes": report.num_bytes,
            "damaged": report.damaged.iter().map(|(id, _)| id).collect::<Vec<_>>(),
        })
    );
    for (id, faults) in &report.damaged {
        for fault in faults {
            eprintln!("percept: session {id}: {}", words(fault).1);
        }
    }
    match report.damaged.len() {
        0 => Ok(()),
        n => {
            Err(format!("{n} sessions are damaged; the copy has what can be read of them, and what it had before")
                .into())
        }
    }
}

async fn open_to_read(storage: &Storage) -> Result<DataRoot, Failure> {
    let mut config = RootConfig::at(storage::location(storage)?);
    config.read_only = true;
    DataRoot::open(config).await.map_err(|error| at(&place(storage), error))
}

/// As the operator wrote it.
fn place(storage: &Storage) -> String {
    if storage.url.is_empty() { storage.data_dir.display().to_string() } else { storage.url.clone() }
}

/// What failed, where, and what can be done.
fn at(place: &str, error: StoreError) -> Failure {
    let remedy = match &error {
        StoreError::NoData => {
            "; --data-dir, --store-url or section storage of the configuration (--config) says where the data are"
        }
        StoreError::Io { .. } => "; check that the place can be reached, and that this user may read and write it",
        _ => "",
    };
    format!("{place}: {}{remedy}", super::with_causes(&error)).into()
}

/// Standard input or output as a file of its own.
fn stream(of: impl AsFd) -> std::io::Result<tokio::fs::File> {
    let file = std::fs::File::from(of.as_fd().try_clone_to_owned()?);
    Ok(tokio::fs::File::from_std(file))
}

fn bar() -> ProgressBar {
    super::progress(0, "sessions")
}

fn follow(bar: &ProgressBar, progress: &Progress) {
    bar.set_length(progress.num_sessions as u64);
    bar.set_position(progress.num_done as u64);
}

fn print(report: &SessionReport) {
    let (id, num_records, num_blobs) = (report.place.id(), report.num_records, report.num_blobs);
    let mb = report.num_bytes as f64 / 1e6;
    let state = if report.faults.is_empty() { "whole" } else { "DAMAGED" };
    println!("{id:40} {state:8} {num_records:8} records {num_blobs:8} scans {mb:10.1} MB");
    for fault in &report.faults {
        println!("    {}", words(fault).1);
    }
}

fn as_json(report: &SessionReport) -> serde_json::Value {
    let fault = |(code, words)| json!({"code": code, "message": words});
    let faults: Vec<_> = report.faults.iter().map(words).map(fault).collect();
    json!({
        "session": report.place.id(),
        "records": report.num_records,
        "scans": report.num_blobs,
        "unnamed_scans": report.num_unnamed,
        "bytes": report.num_bytes,
        "faults": faults,
    })
}

/// A stable name and a sentence.
fn words(fault: &Fault) -> (&'static str, String) {
    match fault {
        Fault::CatalogueDamaged => ("CATALOGUE_DAMAGED", "its entry in the catalogue cannot be read".to_owned()),
        Fault::Records(error) => {
            ("RECORDS_UNREADABLE", format!("its records cannot be read: {}", super::with_causes(error)))
        }
        Fault::Record(key, why) => ("RECORD_DAMAGED", format!("record {key} cannot be read: {why}")),
        Fault::BlobMissing(id) => ("SCAN_MISSING", format!("scan {id} is missing")),
        Fault::BlobDamaged(id) => ("SCAN_DAMAGED", format!("scan {id} is not what its name says")),
        Fault::Blob(id, error) => {
            ("SCAN_UNREADABLE", format!("scan {id} cannot be read: {}", super::with_causes(error)))
        }
    }
}
