//! `percept record`: begin, end, list and remove recordings of a running server's sessions.

use super::Failure;
use super::client::{AccessArgs, Connection, answered, connect};
use clap::{Args, Subcommand};
use percept_wire::v1::sessions_service_client::SessionsServiceClient;
use percept_wire::{json, v1};

#[derive(Debug, Subcommand)]
pub(crate) enum RecordCommand {
    /// Record a session from its next frame on.
    Start(Session),
    /// End what is recorded of a session.
    Stop(Session),
    /// List what was recorded of a session, the oldest first.
    List(Session),
    /// Remove a recording that has ended, for good.
    Delete(Delete),
}

#[derive(Debug, Args)]
pub(crate) struct Session {
    /// The session.
    session: String,
    #[command(flatten)]
    server: Server,
    /// Print the answer as JSON, as REST has it; of a list one recording a line.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
pub(crate) struct Delete {
    /// The session.
    session: String,
    /// The recording: milliseconds since 1970, as `list` tells it.
    recording: String,
    #[command(flatten)]
    server: Server,
}

#[derive(Debug, Args)]
struct Server {
    /// gRPC address of the server.
    #[arg(long, env = "PERCEPT_SERVER", default_value = "http://127.0.0.1:50051")]
    server: String,
    #[command(flatten)]
    access: AccessArgs,
}

type Sessions = SessionsServiceClient<Connection>;

impl Server {
    async fn sessions(&self) -> Result<Sessions, Failure> {
        Ok(SessionsServiceClient::new(connect(&self.server, &self.access).await?))
    }
}

pub(crate) fn run(command: RecordCommand) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        match command {
            RecordCommand::Start(args) => start(args).await,
            RecordCommand::Stop(args) => stop(args).await,
            RecordCommand::List(args) => list(args).await,
            RecordCommand::Delete(args) => delete(args).await,
        }
    })
}

async fn start(args: Session) -> Result<(), Failure> {
    let request = v1::StartRecordingRequest { session_id: args.session };
    let answer = answered(args.server.sessions().await?.start_recording(request).await)?;
    tell(answer.recording.as_ref(), args.json)
}

async fn stop(args: Session) -> Result<(), Failure> {
    let request = v1::StopRecordingRequest { session_id: args.session };
    let answer = answered(args.server.sessions().await?.stop_recording(request).await)?;
    tell(answer.recording.as_ref(), args.json)
}

async fn list(args: Session) -> Result<(), Failure> {
    let mut sessions = args.server.sessions().await?;
    let mut page_token = String::new();
    loop {
        let request = v1::ListRecordingsRequest { session_id: args.session.clone(), page_size: 1000, page_token };
        let page = answered(sessions.list_recordings(request).await)?;
        for recording in &page.recordings {
            if args.json {
                println!("{}", json::to_json("StoredRecording", recording)?);
            } else {
                let open = if recording.open { ", not ended" } else { "" };
                let v1::StoredRecording { recording_id, num_files, num_bytes, .. } = recording;
                println!("{recording_id}  {}{open}", size(*num_files, *num_bytes));
            }
        }
        page_token = page.next_page_token;
        if page_token.is_empty() {
            return Ok(());
        }
    }
}

async fn delete(args: Delete) -> Result<(), Failure> {
    let request = v1::DeleteRecordingRequest { session_id: args.session, recording_id: args.recording };
    answered(args.server.sessions().await?.delete_recording(request).await)?;
    Ok(())
}

fn tell(recording: Option<&v1::Recording>, as_json: bool) -> Result<(), Failure> {
    let Some(recording) = recording else {
        println!("{}", if as_json { "{}" } else { "no frame came: nothing was recorded" });
        return Ok(());
    };
    if as_json {
        println!("{}", json::to_json("Recording", recording)?);
        return Ok(());
    }
    let state = match recording.state() {
        v1::RecordingState::Waiting => "begins with the session's next frame",
        v1::RecordingState::Running => "running",
        v1::RecordingState::Ending => "ending",
        v1::RecordingState::Ended => "ended",
        v1::RecordingState::Unspecified => "unknown",
    };
    println!("{:>10}  {} in the server's folder of recordings", "recording", recording.folder);
    println!("{:>10}  {state}", "state");
    if !recording.end_message.is_empty() {
        println!("{:>10}  {}", "because", recording.end_message);
    }
    println!("{:>10}  {} frames, {}", "written", recording.num_frames, size(recording.num_files, recording.num_bytes));
    let dropped = recording.dropped.clone().unwrap_or_default();
    let reasons = [
        (dropped.num_too_slow, "the disk is slower than the sensors"),
        (dropped.num_no_shared_room, "what waits of all sessions is as much as may"),
        (dropped.num_unwritable, "ROS 2's messages cannot say them"),
        (dropped.num_after_end, "the disk is full, or refused"),
    ];
    for (number, why) in reasons.into_iter().filter(|(number, _)| *number > 0) {
        println!("{:>10}  {number} frames and poses: {why}", "dropped");
    }
    Ok(())
}

fn size(num_files: u32, num_bytes: u64) -> String {
    format!("{num_files} {}, {:.1} MB", if num_files == 1 { "file" } else { "files" }, num_bytes as f64 / 1e6)
}
