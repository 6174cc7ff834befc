//! The benchmark worker alone, quick to build: `bench --worker THREADS OPERATION key=value ...`, or
//! `bench THREADS OPERATION key=value ...` for fifteen rounds.

use std::process::ExitCode;

fn main() -> ExitCode {
    // Called like the program itself, `bench` comes first.
    let words: Vec<String> = std::env::args().skip(1).filter(|w| w != "bench").collect();
    let is_worker = words.first().is_some_and(|w| w == "--worker");
    let [threads, operation, args @ ..] = &words[usize::from(is_worker)..] else {
        eprintln!("usage: bench [--worker] THREADS OPERATION key=value ...");
        return ExitCode::FAILURE;
    };
    let Ok(pool) = rayon::ThreadPoolBuilder::new().num_threads(threads.parse().unwrap_or(1)).build() else {
        return ExitCode::FAILURE;
    };
    let done = pool.install(|| {
        if is_worker {
            let (input, output) = (std::io::BufReader::new(std::io::stdin()), std::io::stdout());
            return percept_bench::worker(operation, args, input, output).map_err(|e| e.to_string());
        }
        percept_bench::run(operation, args, 15).map(|r| println!("{r}")).map_err(|e| e.to_string())
    });
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("bench: {e}");
            ExitCode::FAILURE
        }
    }
}
