//! `percept keys`: make, list and revoke keys. A running server takes a change over within two seconds.

use super::Failure;
use clap::{Args, Subcommand};
use percept_identity::{Access, DEFAULT_TENANT, Grant, KeyFile, KeyRecord, NewKey, Pattern, now_s};
use serde_json::json;
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub(crate) enum KeysCommand {
    /// Make a key and print it. It is shown this once; the file keeps its digest.
    Create(Create),
    /// Show who has which key, without its secret.
    List(List),
    /// Take a key back.
    Revoke(Revoke),
}

#[derive(Debug, Args)]
pub(crate) struct Place {
    /// File of keys, the server's auth.keys_file; `create` makes it if it is absent.
    #[arg(long, env = "PERCEPT_AUTH_KEYS_FILE")]
    file: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct Create {
    #[command(flatten)]
    place: Place,
    /// Whose it is, for people and the audit log.
    #[arg(long)]
    name: String,
    /// Tenant whose sessions it is for.
    #[arg(long, default_value = DEFAULT_TENANT)]
    tenant: String,
    /// What it allows: read, write (and read), or admin (and both).
    #[arg(long)]
    scope: Access,
    /// With which sessions: an id, with * for any characters.
    #[arg(long, default_value = "*", value_parser = Pattern::new)]
    sessions: Pattern,
    /// How long it holds, such as 12h, 90d or 52w; for good if not said.
    #[arg(long, value_parser = seconds)]
    expires: Option<u64>,
    /// Print one JSON object instead of the key alone.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct List {
    #[command(flatten)]
    place: Place,
    /// Print one JSON object a line.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Revoke {
    #[command(flatten)]
    place: Place,
    /// Id of the key, or the name of its holder.
    key: String,
    /// All keys of that name.
    #[arg(long)]
    all: bool,
}

pub(crate) fn run(command: KeysCommand) -> Result<(), Failure> {
    match command {
        KeysCommand::Create(args) => create(args),
        KeysCommand::List(args) => list(&args),
        KeysCommand::Revoke(args) => revoke(&args),
    }
}

fn create(args: Create) -> Result<(), Failure> {
    let now = now_s();
    let grants = vec![Grant { access: args.scope, sessions: args.sessions }];
    let expires_s = args.expires.map(|s| now.saturating_add(s));
    let new = NewKey { name: args.name, tenant: args.tenant, grants, expires_s };
    let (record, key) = KeyFile::change(&args.place.file, |file| file.create(new, now))?;
    if args.json {
        println!("{}", json!({"id": record.id, "key": key, "expires_s": record.expires_s}));
    } else {
        println!("{key}");
        let (file, id) = (args.place.file.display(), &record.id);
        eprintln!("percept: this key is shown once; revoke it with `percept keys revoke --file {file} {id}`");
    }
    Ok(())
}

fn list(args: &List) -> Result<(), Failure> {
    let (file, now) = (KeyFile::read(&args.place.file)?, now_s());
    if !args.json {
        println!("{:14} {:20} {:16} {:24} STATE", "ID", "NAME", "TENANT", "GRANTS");
    }
    for key in &file.keys {
        let grants: Vec<String> = key.grants.iter().map(|g| format!("{} {}", g.access, g.sessions)).collect();
        if args.json {
            let (id, name, tenant, created_s) = (&key.id, &key.name, &key.tenant, key.created_s);
            let times = json!({"created_s": created_s, "expires_s": key.expires_s, "revoked_s": key.revoked_s});
            println!("{}", json!({"id": id, "name": name, "tenant": tenant, "grants": key.grants, "times": times}));
        } else {
            println!("{:14} {:20} {:16} {:24} {}", key.id, key.name, key.tenant, grants.join(", "), state(key, now));
        }
    }
    Ok(())
}

fn revoke(args: &Revoke) -> Result<(), Failure> {
    let count = KeyFile::change(&args.place.file, |file| file.revoke(&args.key, args.all, now_s()))?;
    println!("{count} revoked; running servers refuse it within two seconds");
    Ok(())
}

fn state(key: &KeyRecord, now_s: u64) -> String {
    match (key.revoked_s, key.expires_s) {
        (Some(_), _) => "revoked".to_owned(),
        (None, Some(end)) if end <= now_s => "expired".to_owned(),
        (None, Some(end)) => format!("expires in {}", span(end - now_s)),
        (None, None) => "holds".to_owned(),
    }
}

/// A time as people say it.
fn span(seconds: u64) -> String {
    match seconds {
        0..7200 => format!("{} min", seconds / 60),
        7200..172_800 => format!("{} h", seconds / 3600),
        _ => format!("{} days", seconds / 86_400),
    }
}

/// Seconds of a number with s, m, h, d or w behind it.
fn seconds(text: &str) -> Result<u64, String> {
    let units = [('s', 1), ('m', 60), ('h', 3600), ('d', 86_400), ('w', 604_800)];
    let read = || {
        let (unit, each) = units.into_iter().find(|(unit, _)| text.ends_with(*unit))?;
        text.strip_suffix(unit)?.parse::<u64>().ok()?.checked_mul(each).filter(|s| *s > 0)
    };
    read().ok_or_else(|| "write a number and s, m, h, d or w, such as 90d".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_and_said() {
        assert_eq!((seconds("90d"), seconds("12h"), seconds("1w")), (Ok(7_776_000), Ok(43_200), Ok(604_800)));
        for bad in ["", "90", "d", "0d", "-1d", "1.5h", "1y", "99999999999999999999w", "99999999999999w9w"] {
            assert!(seconds(bad).is_err(), "{bad}");
        }
        assert_eq!((span(90 * 86_400).as_str(), span(3600).as_str()), ("90 days", "60 min"));
    }
}
