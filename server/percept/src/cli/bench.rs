//! `percept bench`: operations timed on given files, in this process.

use super::Failure;
use serde_json::json;

/// Times one operation and prints a JSON line; `--worker` answers line by line, for interleaved comparison.
#[derive(Debug, clap::Args)]
pub(super) struct BenchArgs {
    /// Name the operations, one JSON line.
    #[arg(long, exclusive = true)]
    list: bool,
    /// Answer `prep`, `run` and `extra` on standard input with this many threads, until another line.
    #[arg(long, value_name = "THREADS", conflicts_with_all = ["threads", "rounds"])]
    worker: Option<usize>,
    /// Threads of the operation; 0 takes all cores.
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Timed rounds after one to warm up.
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u16).range(1..))]
    rounds: u16,
    /// What to time; `--list` names them.
    #[arg(required_unless_present = "list")]
    operation: Option<String>,
    /// Its inputs and parameters.
    #[arg(value_name = "KEY=VALUE")]
    args: Vec<String>,
}

pub(super) fn run(args: BenchArgs) -> Result<(), Failure> {
    let Some(operation) = args.operation else {
        let names: Vec<&str> = percept_bench::OPERATIONS.iter().map(|(name, _)| *name).collect();
        println!("{}", json!({ "operations": names }));
        return Ok(());
    };
    // Not the service's pool: what is measured keeps its priority.
    let threads = args.worker.unwrap_or(args.threads);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    pool.install(|| match args.worker {
        Some(_) => {
            let input = std::io::BufReader::new(std::io::stdin());
            Ok(percept_bench::worker(&operation, &args.args, input, std::io::stdout())?)
        }
        None => {
            println!("{}", percept_bench::run(&operation, &args.args, usize::from(args.rounds))?);
            Ok(())
        }
    })
}
