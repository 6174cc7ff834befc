//! The line protocol, and a measurement of its own.

use crate::{Args, BenchError, Case, open};
use serde_json::{Map, Value, json};
use std::io::{BufRead, Write};
use std::time::Instant;

/// CPU time of this process so far, milliseconds.
fn cpu_ms() -> f64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    t.tv_sec as f64 * 1e3 + t.tv_nsec as f64 / 1e6
}

/// Largest resident memory of this process so far, megabytes (Linux).
fn peak_rss_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<f64>().ok().map(|kb| kb / 1024.0)
}

/// One timed run: milliseconds of wall and CPU time. Streams report milliseconds a frame.
fn timed(case: &mut dyn Case) -> Result<(f64, f64), BenchError> {
    let (cpu, start) = (cpu_ms(), Instant::now());
    let frames = case.run()?;
    let (wall, cpu) = (start.elapsed().as_secs_f64() * 1e3, cpu_ms() - cpu);
    let frames = frames.unwrap_or(1).max(1) as f64;
    Ok((wall / frames, cpu / frames))
}

/// Speaks the protocol on the given streams until another line than `prep`, `run` or `extra`, or the end.
///
/// `prep` opens the case and runs it once, `run` times one run, `extra` tells the quality of the last result. Must be
/// called inside the rayon pool that the case is to use.
///
/// # Errors
/// The streams break.
pub fn worker(operation: &str, args: &[String], input: impl BufRead, mut output: impl Write) -> std::io::Result<()> {
    let mut case: Option<Box<dyn Case>> = None;
    for line in input.lines() {
        let line = line?;
        let answer = match line.split_whitespace().next() {
            Some("prep") => prepare(operation, args).map(|(opened, answer)| {
                case = Some(opened);
                answer
            }),
            Some("run") => with(&mut case, |c| timed(c).map(|(ms, cpu)| json!({"ms": ms, "cpu": cpu}))),
            Some("extra") => with(&mut case, |c| {
                let mut extra = c.extra();
                extra.insert("rss_mb".to_owned(), json!(peak_rss_mb()));
                Ok(Value::Object(extra))
            }),
            _ => break,
        };
        let answer = answer.unwrap_or_else(|e| json!({"error": e.to_string()}));
        writeln!(output, "{answer}")?;
        output.flush()?;
    }
    Ok(())
}

fn prepare(operation: &str, args: &[String]) -> Result<(Box<dyn Case>, Value), BenchError> {
    let mut case = open(operation, &Args::parse(args)?)?;
    let (warm_ms, _) = timed(case.as_mut())?;
    let n = case.items();
    Ok((case, json!({"n": n, "warm_ms": warm_ms})))
}

fn with(
    case: &mut Option<Box<dyn Case>>,
    work: impl FnOnce(&mut dyn Case) -> Result<Value, BenchError>,
) -> Result<Value, BenchError> {
    work(case.as_mut().ok_or_else(|| BenchError("prep comes first".to_owned()))?.as_mut())
}

/// Runs an operation `rounds` times after a warm-up: one JSON object with median, least and most milliseconds.
///
/// # Errors
/// The operation or its arguments are not known, a file cannot be read, the operation refuses its input.
pub fn run(operation: &str, args: &[String], rounds: usize) -> Result<Value, BenchError> {
    let (mut case, _) = prepare(operation, args)?;
    let mut times = Vec::with_capacity(rounds.max(1));
    for _ in 0..rounds.max(1) {
        times.push(timed(case.as_mut())?);
    }
    times.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut out = Map::new();
    out.insert("operation".to_owned(), json!(operation));
    out.insert("args".to_owned(), json!(args));
    out.insert("threads".to_owned(), json!(rayon::current_num_threads()));
    out.insert("items".to_owned(), json!(case.items()));
    out.insert("rounds".to_owned(), json!(times.len()));
    out.insert("median_ms".to_owned(), json!(times[times.len() / 2].0));
    out.insert("min_ms".to_owned(), json!(times[0].0));
    out.insert("max_ms".to_owned(), json!(times[times.len() - 1].0));
    out.insert("cpu_ms".to_owned(), json!(times[times.len() / 2].1));
    out.insert("peak_rss_mb".to_owned(), json!(peak_rss_mb()));
    out.insert("result".to_owned(), Value::Object(case.extra()));
    Ok(Value::Object(out))
}
