//! `percept health`: ask a running server whether it serves.

use super::Failure;
use super::client::AccessArgs;
use std::time::Duration;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::{HealthCheckRequest, health_client::HealthClient};

/// A server that is paused, or a network that swallows everything, is not healthy either.
const PATIENCE: Duration = Duration::from_secs(5);

#[derive(Debug, clap::Args)]
pub(crate) struct HealthArgs {
    /// gRPC address of the server.
    #[arg(long, env = "PERCEPT_SERVER", default_value = "http://127.0.0.1:50051")]
    server: String,
    #[command(flatten)]
    access: AccessArgs,
}

pub(crate) fn run(args: &HealthArgs) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let asked = async {
        let mut client = HealthClient::new(super::client::connect(&args.server, &args.access).await?);
        let answer = client.check(HealthCheckRequest { service: String::new() }).await?;
        match answer.into_inner().status() {
            ServingStatus::Serving => {
                println!("serving");
                Ok(())
            }
            other => Err(format!("the server at {} is {}", args.server, other.as_str_name()).into()),
        }
    };
    runtime.block_on(async {
        let answered = tokio::time::timeout(PATIENCE, asked).await;
        answered.unwrap_or_else(|_| {
            Err(format!("the server at {} has not answered within {} s", args.server, PATIENCE.as_secs()).into())
        })
    })
}
