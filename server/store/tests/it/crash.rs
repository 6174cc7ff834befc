//! A child process writes and is killed with `kill -9` at any moment; what it had acknowledged is there.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use percept_store::{BlobId, Key, RootConfig, Store};

use crate::{Opened, mix, open_with};

const DIRECTORY: &str = "PERCEPT_CRASH_DIRECTORY";
const ROUND: &str = "PERCEPT_CRASH_ROUND";
const WRITERS: u64 = 4;

/// Small tables, so that sorted tables and compaction are under way when the blow comes.
async fn open(root: &Path) -> Opened {
    let mut config = RootConfig::directory(root);
    config.session.memtable_bytes = 1 << 20;
    open_with(config).await
}

/// Fresh bytes of each record: 8 to about 8,000 of them, from its number alone.
fn content(round: u64, writer: u64, number: u64) -> Bytes {
    let seed = mix(round << 40 ^ writer << 32 ^ number);
    (0..1 + seed % 1000).flat_map(|word| mix(seed ^ word << 20).to_le_bytes()).collect()
}

fn record_key(round: u64, writer: u64, number: u64) -> Key {
    Key::parse(&format!("crash/{round}/{writer}")).unwrap().numbered(number).unwrap()
}

#[test]
#[ignore = "the child of the test below"]
fn child() {
    let Ok(directory) = std::env::var(DIRECTORY) else { return };
    let round: u64 = std::env::var(ROUND).unwrap().parse().unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(async {
        let store = Arc::new(open(Path::new(&directory)).await);
        let writers = (0..WRITERS).map(|writer| tokio::spawn(write_for_ever(store.clone(), round, writer)));
        futures::future::join_all(writers).await;
    });
}

/// Each tenth record names a blob that was stored before it; each odd one replaces a counter with it.
async fn write_for_ever(store: Arc<Opened>, round: u64, writer: u64) {
    let counter = Key::parse(&format!("counter/{writer}")).unwrap();
    for number in 0.. {
        let mut value = content(round, writer, number);
        if number % 10 == 0 {
            let id = store.put_blob(value).await.unwrap();
            value = Bytes::copy_from_slice(id.as_bytes());
        }
        let mut puts = vec![(record_key(round, writer, number), value)];
        if number % 2 == 1 {
            puts.push((counter.clone(), Bytes::copy_from_slice(&number.to_le_bytes())));
        }
        store.put_batch(puts, vec![]).await.unwrap();
        // Straight to the pipe: an acknowledgement that was buffered in the child would prove nothing.
        let line = format!("ack {writer} {number}\n");
        std::io::stdout().lock().write_all(line.as_bytes()).unwrap();
        std::io::stdout().flush().unwrap();
    }
}

/// Runs a child for `life` after its first acknowledgement, kills it, and counts what it acknowledged.
fn run_and_kill(directory: &Path, round: u64, life: Duration) -> [u64; WRITERS as usize] {
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "crash::child", "--ignored", "--nocapture", "--test-threads=1"])
        .env(DIRECTORY, directory)
        .env(ROUND, round.to_string())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut acknowledged = [0; WRITERS as usize];
    let mut deadline = None;
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    for line in lines.map_while(Result::ok) {
        // A line cut off by the kill does not count.
        if let [writer, number] = *line.split(' ').skip(1).map_while(|word| word.parse().ok()).collect::<Vec<u64>>()
            && line.starts_with("ack ")
        {
            let count: &mut u64 = &mut acknowledged[writer as usize];
            *count = (*count).max(number + 1);
            deadline = deadline.or_else(|| Some(Instant::now() + life));
        }
        if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            // SIGKILL on Unix. What is in the pipe already was acknowledged and is still read.
            let _ = child.kill();
        }
    }
    child.wait().unwrap();
    acknowledged
}

#[test]
fn what_was_acknowledged_survives_kill_9() {
    let directory = tempfile::tempdir().unwrap();
    let seed = std::process::id() as u64;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let mut rounds = Vec::new();
    for round in 0..7u64 {
        // One life long enough for compaction, the others anywhere in the first moments.
        let life = if round == 3 { 2500 } else { mix(seed ^ round << 32) % 400 };
        rounds.push(run_and_kill(directory.path(), round, Duration::from_millis(life)));
        runtime.block_on(check(directory.path(), &rounds));
    }
    let total: u64 = rounds.iter().flatten().sum();
    println!("{total} acknowledged records in {rounds:?}");
    assert!(total > 100, "too few to prove anything: {rounds:?}");
}

async fn check(directory: &Path, rounds: &[[u64; WRITERS as usize]]) {
    let store = open(directory).await;
    assert_eq!(store.epoch(), 2 * rounds.len() as u64);
    for (round, acknowledged) in rounds.iter().enumerate() {
        for (writer, &count) in acknowledged.iter().enumerate() {
            let (round, writer) = (round as u64, writer as u64);
            let prefix = Key::parse(&format!("crash/{round}/{writer}")).unwrap().prefix();
            let found: HashMap<_, _> = store.scan_all(&prefix).await.unwrap().into_iter().collect();
            for number in 0..count {
                let key = record_key(round, writer, number);
                let found = found.get(&key).unwrap_or_else(|| panic!("{key} of {count} is lost"));
                let expected = content(round, writer, number);
                if number % 10 == 0 {
                    let id = BlobId::from_bytes(found[..].try_into().unwrap());
                    assert_eq!(store.get_blob(id).await.unwrap(), expected, "blob of {key}");
                } else {
                    assert_eq!(*found, expected, "{key}");
                }
            }
            if let Some(last) = count.checked_sub(1) {
                assert!(store.get(&record_key(round, writer, last)).await.unwrap().is_some());
            }
        }
    }
    for (writer, &count) in rounds[rounds.len() - 1].iter().enumerate().filter(|(_, count)| **count > 1) {
        let counter = store.get(&Key::parse(&format!("counter/{writer}")).unwrap()).await.unwrap().unwrap();
        let counter = u64::from_le_bytes(counter[..].try_into().unwrap());
        // The next one may have become durable without being acknowledged.
        let newest = (count - 2) | 1;
        assert!(counter == newest || counter == newest + 2, "counter {counter} after {count} records");
    }
    store.close().await.unwrap();
}
