//! The command line: one file a command.

mod bench;
mod client;
mod corrupt;
mod demo;
mod doctor;
mod eval;
mod eval_gap;
mod eval_graph;
mod eval_objects;
mod eval_planning;
mod eval_relations;
mod eval_slam;
mod eval_trajectory;
mod eval_wheels;
mod explore;
mod files;
mod fly;
mod health;
mod import_map;
mod info;
mod input;
mod keys;
mod local;
mod plan;
mod plot;
mod prepare;
mod record;
mod recorded;
mod reload;
mod replay;
mod report;
mod serve;
mod sim;
mod slam_run;
mod store;
mod streams;

use clap::{CommandFactory, Parser, Subcommand};
use std::collections::BTreeSet;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

/// What a command ends with when it fails: a sentence for the person at the terminal.
pub(crate) type Failure = Box<dyn std::error::Error + Send + Sync>;

/// The perception service that a robot fleet calls instead of building its own.
#[derive(Debug, Parser)]
#[command(name = "percept", version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the server: gRPC, REST and zenoh.
    Serve(serve::ServeArgs),
    /// Show what percept does, with no data and no network: a simulated robot maps rooms, finds objects, plans.
    Demo(demo::DemoArgs),
    /// Drive a simulated robot and stream its sensors into a server.
    Sim(sim::SimArgs),
    /// Run a recorded data set through percept, in this process or into a server.
    Replay(replay::ReplayArgs),
    /// Tell what a recording holds, and what `replay` would take of it.
    Info(info::InfoArgs),
    /// Plan a path on a map file, or through the map of a session of a running server; no path is a failure, with its reason.
    Plan(plan::PlanArgs),
    /// Plan a path that passes a tool over all that the robot reaches, on a map file or through the map of a session.
    Coverage(explore::CoverageArgs),
    /// List the edges of what is known that the robot reaches: where to look next, on a map file or in the map of a session.
    Frontiers(explore::FrontierArgs),
    /// Plan a path in space for what flies, through an OctoMap file or the voxels of a session; no path is a failure, with its reason.
    Fly(fly::FlyArgs),
    /// Begin a session of a running server with a map that comes from elsewhere.
    ImportMap(import_map::ImportMapArgs),
    /// Begin, end, list and remove recordings of a running server's sessions.
    #[command(subcommand)]
    Record(record::RecordCommand),
    /// Measure against ground truth.
    #[command(subcommand)]
    Eval(eval::EvalCommand),
    /// Time one operation on given files and print a JSON line.
    Bench(bench::BenchArgs),
    /// Make, list and revoke the keys with which callers say who they are.
    #[command(subcommand)]
    Keys(keys::KeysCommand),
    /// Check, export, import and back up what is stored, also while a server runs.
    #[command(subcommand)]
    Store(store::StoreCommand),
    /// Print the configuration file with every default explained.
    Config(ConfigArgs),
    /// Tell how the streams of a running server's sessions fare: figures, what is wrong, and what to do about it. A failure if
    /// something is wrong.
    Doctor(doctor::DoctorArgs),
    /// Ask a running server whether it serves; the exit code says so.
    Health(health::HealthArgs),
    /// Print the script that completes commands and options in a shell: `source <(percept completions bash)`.
    Completions {
        /// Which shell.
        shell: clap_complete::Shell,
    },
}

#[derive(Debug, clap::Args)]
struct ConfigArgs {
    /// Check this file, the environment and the files that they name instead, as `serve` does before it listens, and
    /// print what is in force.
    #[arg(long)]
    check: Option<PathBuf>,
}

/// Ends the process in silence where nobody reads its output any more, as `percept config | head -1` does: printing panics then,
/// since signals of broken pipes are ignored for the sake of sockets.
fn end_with_reader() {
    let otherwise = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        let words = info.payload().downcast_ref::<String>().map_or("", String::as_str);
        if words.starts_with("failed printing to stdout") && words.contains("Broken pipe") {
            std::process::exit(0);
        }
        otherwise(info);
    }));
}

/// Whether what failed was to write where nobody reads any more.
fn is_of_closed_pipe(error: &(dyn std::error::Error + 'static)) -> bool {
    error.downcast_ref::<std::io::Error>().is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}

/// Runs the command line of this process.
pub(crate) fn run() -> ExitCode {
    end_with_reader();
    let cli = Cli::parse();
    let outcome = match cli.command {
        Command::Serve(args) => serve::run(args),
        Command::Demo(args) => demo::run(args),
        Command::Sim(args) => sim::run(args),
        Command::Replay(args) => replay::run(args),
        Command::Info(args) => info::run(&args),
        Command::Plan(args) => plan::run(args),
        Command::Coverage(args) => explore::coverage(args),
        Command::Frontiers(args) => explore::frontiers(args),
        Command::Fly(args) => fly::run(args),
        Command::ImportMap(args) => import_map::run(args),
        Command::Record(command) => record::run(command),
        Command::Eval(command) => eval::run(command),
        Command::Bench(args) => bench::run(args),
        Command::Keys(command) => keys::run(command),
        Command::Store(command) => store::run(command),
        Command::Config(args) => config(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Health(args) => health::run(&args),
        Command::Completions { shell } => completions(shell),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) if is_of_closed_pipe(e.as_ref()) => ExitCode::SUCCESS,
        Err(e) => {
            let of_server = || client::lost(e.as_ref()).or_else(|| client::refused(e.as_ref()));
            eprintln!("percept: {}", of_server().unwrap_or_else(|| with_causes(e.as_ref())));
            ExitCode::FAILURE
        }
    }
}

fn completions(shell: clap_complete::Shell) -> Result<(), Failure> {
    let mut script = vec![];
    clap_complete::generate(shell, &mut Cli::command(), "percept", &mut script);
    Ok(std::io::stdout().write_all(&script)?)
}

/// Variables of the environment that options of any command read, whichever runs.
pub(crate) fn variables() -> BTreeSet<String> {
    fn gather(command: &clap::Command, found: &mut BTreeSet<String>) {
        found.extend(
            command.get_arguments().filter_map(clap::Arg::get_env).filter_map(|v| v.to_str()).map(str::to_owned),
        );
        command.get_subcommands().for_each(|below| gather(below, found));
    }
    let mut found = BTreeSet::new();
    gather(&Cli::command(), &mut found);
    found
}

/// An error and what brought it about, outermost first; causes that the words before tell already are left out.
fn with_causes(error: &dyn std::error::Error) -> String {
    let mut words = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let told = error.to_string();
        if !words.contains(&told) {
            words = format!("{words}: {told}");
        }
        cause = error.source();
    }
    words
}

fn config(args: &ConfigArgs) -> Result<(), Failure> {
    match &args.check {
        None => print!("{}", crate::config::TEMPLATE),
        Some(file) => {
            let config = crate::config::Config::load(Some(file))?;
            // What `serve` warns of at its start is told here, too.
            crate::telemetry::init("warn", crate::config::LogFormat::Text);
            prepare::prepare(&config)?;
            print!("{}", toml::to_string_pretty(&config)?);
        }
    }
    Ok(())
}

/// A rayon pool of `threads` (0: all cores) whose threads give way to the doors.
pub(crate) fn compute_pool(threads: usize, nice: i32) -> Result<rayon::ThreadPool, Failure> {
    let lower = move |_| {
        // On Linux the priority is the thread's own; where it cannot be lowered, nothing is lost.
        let _ = rustix::process::nice(nice);
    };
    Ok(rayon::ThreadPoolBuilder::new().num_threads(threads).start_handler(lower).build()?)
}

/// Runs what pipelines of this process do beside their frames.
struct Beside(rayon::ThreadPool);

impl percept_pipeline::Executor for Beside {
    fn spawn(&self, work: Box<dyn FnOnce() + Send>) {
        self.0.spawn(work);
    }
}

/// Threads for what a pipeline does beside its frames: `threads`, or one a core.
///
/// # Errors
/// Threads that cannot be started.
pub(crate) fn beside_frames(threads: usize) -> Result<std::sync::Arc<dyn percept_pipeline::Executor>, Failure> {
    Ok(std::sync::Arc::new(Beside(compute_pool(threads, 0)?)))
}

/// A progress bar over `total` frames on standard error; hidden when that is no terminal.
pub(crate) fn progress(total: u64, what: &'static str) -> indicatif::ProgressBar {
    let style = indicatif::ProgressStyle::with_template("{msg:12} {wide_bar} {pos}/{len} {per_sec} {eta}");
    let bar = indicatif::ProgressBar::new(total).with_message(what);
    match style {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}
