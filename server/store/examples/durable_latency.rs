//! Latency and throughput of durable writes: `cargo run --release -p percept-store --example
//! durable_latency -- <a new directory>`.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use percept_store::{DataRoot, Key, Prefix, RootConfig, SlateStore, Store, StoreError};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let root = std::env::args().nth(1).unwrap_or_else(|| "durable-latency".to_owned());
    let opening = Instant::now();
    let data = DataRoot::open(RootConfig::directory(&root)).await?;
    let place = data.create("durable-latency", b"").await?;
    let store = Arc::new(data.open_session(&place).await?);
    println!("open: {:?}", opening.elapsed());
    for (writers, each) in [(1, 1000), (8, 500), (64, 200), (256, 100)] {
        records(&store, writers, each).await?;
    }
    blobs(&store, 1 << 20, 100).await?;
    blobs(&store, 100_000, 200).await?;
    let closing = Instant::now();
    store.close().await?;
    println!("close: {:?}", closing.elapsed());
    let opening = Instant::now();
    let store = data.open_session(&place).await?;
    println!("open again: {:?}", opening.elapsed());
    let scanning = Instant::now();
    let found = store.scan_all(&Prefix::everything()).await?.len();
    println!("scan of {found} x 1 KB: {:?}", scanning.elapsed());
    store.close().await?;
    data.bury(&place).await?;
    Ok(data.purge(&place).await?)
}

async fn records(store: &Arc<SlateStore>, writers: u64, each: u64) -> Result<(), Box<dyn std::error::Error>> {
    let start = Instant::now();
    let tasks: Vec<_> = (0..writers)
        .map(|writer| {
            let store = store.clone();
            tokio::spawn(async move {
                let keys = Key::parse(&format!("{writers}-{writer}"))?;
                let mut times = Vec::new();
                for number in 0..each {
                    let value = Bytes::from(vec![number as u8; 1024]);
                    let start = Instant::now();
                    store.put(keys.numbered(number)?, value).await?;
                    times.push(start.elapsed());
                }
                Ok::<_, StoreError>(times)
            })
        })
        .collect();
    let mut times: Vec<Duration> = Vec::new();
    for task in tasks {
        times.extend(task.await??);
    }
    report(&format!("{writers} writers, 1 KB"), times, start.elapsed(), 1024);
    Ok(())
}

async fn blobs(store: &SlateStore, size: usize, count: usize) -> Result<(), StoreError> {
    let mut times = Vec::new();
    let begin = Instant::now();
    for number in 0..count {
        let mut bytes = vec![0; size];
        bytes[..8].copy_from_slice(&number.to_le_bytes());
        let start = Instant::now();
        store.put_blob(Bytes::from(bytes)).await?;
        times.push(start.elapsed());
    }
    report(&format!("blobs of {size} B"), times, begin.elapsed(), size);
    Ok(())
}

fn report(name: &str, mut times: Vec<Duration>, total: Duration, size: usize) {
    times.sort_unstable();
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize];
    let rate = times.len() as f64 / total.as_secs_f64();
    println!("{name}: p50 {:?}, p99 {:?}, {rate:.0} /s, {:.1} MB/s", at(0.5), at(0.99), rate * size as f64 / 1e6);
}
