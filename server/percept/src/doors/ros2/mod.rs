//! Robots on ROS 2, without ROS: their topics come by zenoh, as rmw_zenoh or the bridge of zenoh and DDS puts them there.
//!
//! Each endpoint has a zenoh session of its own, so that robots on different routers stay apart; each robot has a task that
//! listens ([`robot`]) and one that publishes ([`publish`]). Who may reach that network may speak for its robots: that is how
//! ROS 2 is. What they feed are the sessions that the settings name, and no others.

mod book;
mod checks;
mod clock;
mod inbox;
mod link;
mod motion;
mod mounts;
mod numbers;
mod pairs;
mod pointed_out;
mod publish;
mod robot;
mod settings;

pub(crate) use settings::{Robot, Ros2};

use super::grpc::Api;
use super::zenoh::Failure;
use link::Entities;
use percept_identity::{Access, Grant, Pattern, Principal, random_token};
use percept_service::{CallContext, Caller};
use publish::Shared;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;

/// How long it takes at least to try again what failed.
const PAUSE: Duration = Duration::from_secs(2);

/// Listens to all robots until the server stops.
pub(crate) async fn serve(api: Api, settings: Ros2) -> Result<(), Failure> {
    let mut networks: BTreeMap<(String, String), Vec<Robot>> = BTreeMap::new();
    for robot in settings.robots {
        networks.entry((robot.connect.clone(), robot.listen.clone())).or_default().push(robot);
    }
    let mut stopping = api.stopping.clone();
    let mut tasks = tokio::task::JoinSet::new();
    for ((connect, listen), robots) in networks {
        tasks.spawn(network(api.clone(), connect, listen, robots));
    }
    let _ = stopping.wait_for(|stops| *stops).await;
    tasks.shutdown().await;
    Ok(())
}

/// Keeps up a session with one endpoint, and its robots.
async fn network(api: Api, connect: String, listen: String, robots: Vec<Robot>) {
    loop {
        let endpoint = if connect.is_empty() { &listen } else { &connect };
        match open(&connect, &listen, api.service.limits().max_message_bytes).await {
            Ok(zenoh) => {
                tracing::info!(endpoint, robots = robots.len(), "the network of robots on ROS 2 is open");
                let entities = Entities::default();
                let all = robots.iter().map(|robot| Box::pin(attend(&zenoh, &entities, &api, robot)));
                futures::future::join_all(all).await;
            }
            Err(error) => {
                if let Some(untold) = api.service.faults().admit(&format!("ros2 {endpoint}")) {
                    tracing::warn!(endpoint, untold, %error, "robots on ROS 2 cannot be reached; it is tried again");
                }
            }
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// A session of zenoh: a client of the robot's router, or a router that the robot's router connects to, since a router hands
/// nothing on from one of its peers to another.
async fn open(connect: &str, listen: &str, max_message_bytes: usize) -> Result<zenoh::Session, Failure> {
    let mut config = zenoh::Config::default();
    let list = |endpoint: &str| {
        let endpoints: Vec<&str> = Some(endpoint).filter(|e| !e.is_empty()).into_iter().collect();
        serde_json::to_string(&endpoints)
    };
    for (key, value) in [
        ("mode", (if listen.is_empty() { "\"client\"" } else { "\"router\"" }).to_owned()),
        ("connect/endpoints", list(connect)?),
        ("listen/endpoints", list(listen)?),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("transport/shared_memory/enabled", "true".to_owned()),
        // For the samples that late joiners get.
        ("timestamping/enabled", "true".to_owned()),
        // The default of 1 GiB would let one peer take all memory.
        ("transport/link/rx/max_message_size", max_message_bytes.saturating_mul(2).to_string()),
    ] {
        config.insert_json5(key, &value)?;
    }
    super::zenoh::open(config).await
}

/// Listens to a robot and publishes to it; what fails is begun again.
async fn attend(zenoh: &zenoh::Session, entities: &Entities, api: &Api, robot: &Robot) {
    loop {
        let attended = async {
            let caller = caller(api, robot)?;
            let shared = Arc::new(Shared::default());
            let (goal, goals) = mpsc::channel(1);
            let listening = robot::Listener::serve(zenoh, api, robot, caller.clone(), Arc::clone(&shared), goal);
            if !robot.publishes {
                return listening.await;
            }
            let publishing = publish::serve(zenoh, entities, robot, &caller, &shared, goals);
            tokio::try_join!(listening, publishing).map(drop)
        };
        if let Err(error) = attended.await
            && let Some(untold) = api.service.faults().admit(&format!("ros2 {}", robot.session))
        {
            tracing::warn!(session = robot.session, untold, %error, "a robot on ROS 2 is attended to anew");
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// The operations in the robot's name: it may write to its own session.
fn caller(api: &Api, robot: &Robot) -> Result<Caller, Failure> {
    let grant = Grant { access: Access::Write, sessions: Pattern::new(&robot.session)? };
    let principal = Principal {
        name: "ros2".to_owned(),
        tenant: robot.tenant.clone(),
        grants: vec![grant],
        ..Principal::anonymous()
    };
    let (principal, trace) = (Arc::new(principal), random_token()?);
    Ok(api.service.sender(CallContext { principal, deadline: None, trace, peer: "ros2".to_owned() }))
}
