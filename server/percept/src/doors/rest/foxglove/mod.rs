//! A session in Foxglove, opened directly: its WebSocket protocol, with the messages that robots on ROS 2 get.
//!
//! Comes in: a WebSocket. Goes out: poses at once, what is larger once a second where it changed, each to those who subscribed.
//! A goal that is published comes back as a path. Foxglove's own server library would listen on a port of its own without keys,
//! TLS or a look at who asks, so that the protocol is spoken here, behind the same doorkeepers as all else.

mod protocol;

use super::super::grpc::{Api, peer_of};
use super::super::identify;
use super::super::listener::Seat;
use super::super::results::{Events, NoMessage, Results, transforms};
use super::Refused;
use axum::extract::ws::{CloseFrame, Message as Frame, WebSocket, WebSocketUpgrade, close_code};
use axum::extract::{FromRequestParts, Request};
use axum::http::{StatusCode, header};
use axum::response::Response;
use percept_geometry::{Pose, Timestamp};
use percept_pipeline::PoseEstimate;
use percept_ros::Message;
use percept_ros::messages::{
    Detection3DArray, MarkerArray, OccupancyGrid, Path, PointCloud2, PoseStamped, PoseWithCovarianceStamped, TFMessage,
};
use percept_service::{Caller, Error, EventKind, Guarded, admission, reason};
use protocol::{Channel, ClientChannel, Level, SUBPROTOCOLS, Said};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// A pose that a client has published, in the map; else what is wrong with it.
fn in_map<E: std::fmt::Display>(read: Result<(&str, percept_ros::messages::Pose), E>) -> Result<Pose, String> {
    let (frame, pose) = read.map_err(|error| format!("cannot be read: {error}"))?;
    if frame.trim_start_matches('/') != MAP {
        return Err(format!("is in frame {frame:?}; set the display frame to {MAP:?}"));
    }
    percept_ros::convert::pose(&pose).map_err(|error| format!("cannot be taken: {error}"))
}

/// Frames of the map and of the robot, as REP-105 calls them.
const MAP: &str = "map";
const BASE: &str = "base_link";
/// What is large is sent no more often, whatever a client asks for.
const PERIOD: Duration = Duration::from_secs(1);
/// Clouds are larger still: every so many periods, but in the next one to who subscribes.
const CLOUD_EVERY: u32 = 5;
/// A peer is asked so often whether it is there, and gone if so long nothing has come of it.
const PING: Duration = Duration::from_secs(15);
const SILENCE: Duration = Duration::from_secs(40);
/// A client says no more than this at a time.
const MAX_SAID_BYTES: usize = 64 << 10;
/// Topics that a client may publish.
const MAX_CLIENT_CHANNELS: usize = 64;

/// Topics on offer, by place.
const TF: usize = 0;
const TF_STATIC: usize = 1;
const POSE: usize = 2;
const GRID: usize = 3;
const PATH: usize = 4;
const CLOUD: usize = 5;
const OBJECTS: usize = 6;
const DETECTIONS: usize = 7;
const PLAN: usize = 8;
const CHANNELS: [Channel; 9] = [
    Channel::of::<TFMessage<'_>>("/tf"),
    Channel::of::<TFMessage<'_>>("/tf_static"),
    Channel::of::<PoseWithCovarianceStamped<'_>>("/percept/pose"),
    Channel::of::<OccupancyGrid<'_>>("/map"),
    Channel::of::<Path<'_>>("/percept/path"),
    Channel::of::<PointCloud2<'_>>("/percept/cloud"),
    Channel::of::<MarkerArray<'_>>("/percept/objects"),
    Channel::of::<Detection3DArray<'_>>("/percept/detections"),
    Channel::of::<Path<'_>>("/percept/plan"),
];

/// Answers a handshake.
///
/// # Errors
/// `WEBSOCKET_REQUIRED` for what is no handshake of this protocol; `SESSION_NOT_FOUND`, `TOO_MANY_WATCHERS`,
/// `PERMISSION_DENIED`, `RATE_LIMITED`.
pub(super) async fn open(api: Api, session: String, request: Request) -> Result<Response, Refused> {
    let (mut parts, _) = request.into_parts();
    let no_handshake = |status, detail: String| {
        let words = format!(
            "{detail}; open this address in Foxglove (Open connection, Foxglove WebSocket) with ws:// or wss://"
        );
        Refused::http(status, reason::WEBSOCKET_REQUIRED, words).with(header::UPGRADE, "websocket")
    };
    let upgrade = WebSocketUpgrade::from_request_parts(&mut parts, &()).await;
    let upgrade = upgrade.map_err(|e| no_handshake(StatusCode::UPGRADE_REQUIRED, e.body_text()))?;
    let upgrade = upgrade.protocols(SUBPROTOCOLS).max_message_size(MAX_SAID_BYTES).max_frame_size(MAX_SAID_BYTES);
    if upgrade.selected_protocol().is_none() {
        let words = format!("the handshake asks for no subprotocol of {SUBPROTOCOLS:?}");
        return Err(no_handshake(StatusCode::BAD_REQUEST, words));
    }
    let caller = api.service.caller(identify::context(&parts.extensions)?)?;
    let place = (api.bounds.watcher(&peer_of(&parts.extensions))?, caller.hold(admission::Held::Watch)?);
    // Whoever may not see it is told so before the connection is another one.
    caller.session_events("SessionsService/WatchSession", &session).await?;
    let seat = parts.extensions.get::<Seat>().cloned();
    Ok(upgrade.on_upgrade(move |socket| async move {
        let patience = Duration::from_secs(api.service.limits().unread_timeout_s as u64);
        let (service, shown, client) = (api.service.clone(), Shown::default(), BTreeMap::new());
        let mut viewer = Viewer { service, socket, patience, caller, session, shown, client };
        // A client that has gone needs no answer.
        let _ = viewer.serve(api.stopping.clone()).await;
        drop((place, seat));
    }))
}

/// Comes when the server stops.
async fn stops(stopping: &mut tokio::sync::watch::Receiver<bool>) {
    // Without a sender, it has stopped.
    let _ = stopping.wait_for(|stops| *stops).await;
}

/// The connection is over.
struct Gone;

type Alive = Result<(), Gone>;

/// What a client wants, and what of it is old.
#[derive(Default)]
struct Shown {
    /// The client's numbers by channel.
    subscriptions: [Option<u32>; CHANNELS.len()],
    is_old: [bool; CHANNELS.len()],
    newest: Option<PoseEstimate>,
    /// The way to the last goal.
    plan: Option<Vec<u8>>,
    periods: u32,
    /// Somebody has just subscribed to the cloud.
    is_cloud_due: bool,
}

impl Shown {
    fn outdate(&mut self, channels: &[usize]) {
        for &channel in channels {
            self.is_old[channel] = true;
        }
    }

    /// Whether it is wanted and old; it is new from now on.
    fn take(&mut self, channel: usize) -> bool {
        self.subscriptions[channel].is_some() && std::mem::take(&mut self.is_old[channel])
    }

    fn stamp(&self) -> Timestamp {
        self.newest.as_ref().map_or(Timestamp(0), |pose| pose.stamp)
    }
}

/// Somebody who looks at a session.
struct Viewer {
    service: Guarded,
    socket: WebSocket,
    patience: Duration,
    caller: Caller,
    session: String,
    shown: Shown,
    /// Topics that the client publishes, by its numbers.
    client: BTreeMap<u32, ClientChannel>,
}

impl Viewer {
    async fn serve(&mut self, mut stopping: tokio::sync::watch::Receiver<bool>) -> Alive {
        self.text(protocol::server_info(&format!("percept, session {}", self.session), &self.session)).await?;
        self.text(protocol::advertise(&CHANNELS)).await?;
        if let Ok(snapshot) = self.caller.snapshot("SessionsService/WatchSession", &self.session).await {
            self.shown.newest.clone_from(&snapshot.pose);
        }
        self.send(protocol::time(time_ns(self.shown.stamp()))).await?;
        let (caller, session) = (self.caller.clone(), self.session.clone());
        let mut events = Events::default();
        let (mut period, mut ping) = (tokio::time::interval(PERIOD), tokio::time::interval(PING));
        for interval in [&mut period, &mut ping] {
            interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        }
        let (mut ended, mut moved) = (std::pin::pin!(caller.ended()), std::pin::pin!(caller.moved(&session)));
        let mut heard = Instant::now();
        loop {
            tokio::select! {
                frame = self.socket.recv() => match frame {
                    Some(Ok(frame)) => {
                        heard = Instant::now();
                        self.hear(frame).await?;
                    }
                    Some(Err(_)) | None => return Err(Gone),
                },
                event = events.next(&caller, &session) => self.happened(event).await?,
                _ = period.tick() => self.show().await?,
                _ = ping.tick() => match heard.elapsed() < SILENCE {
                    true => self.frame(Frame::Ping(axum::body::Bytes::new())).await?,
                    false => return Err(Gone),
                },
                error = &mut ended => return self.end(close_code::POLICY, &error).await,
                error = &mut moved => return self.end(close_code::RESTART, &error).await,
                () = stops(&mut stopping) => {
                    let close = CloseFrame { code: close_code::AWAY, reason: "the server stops".into() };
                    return self.frame(Frame::Close(Some(close))).await;
                }
            }
        }
    }

    async fn end(&mut self, code: u16, error: &Error) -> Alive {
        self.text(protocol::status(Level::Error, "end", &error.to_string())).await?;
        self.frame(Frame::Close(Some(CloseFrame { code, reason: error.reason.into() }))).await
    }

    async fn hear(&mut self, frame: Frame) -> Alive {
        match frame {
            Frame::Text(text) => match serde_json::from_str(&text) {
                Ok(said) => self.said(said).await,
                Err(error) => self.warn("said", &format!("a message of yours cannot be read: {error}")).await,
            },
            Frame::Binary(bytes) => self.published(&bytes).await,
            // Nothing comes after an end, once it was answered.
            Frame::Close(_) | Frame::Ping(_) | Frame::Pong(_) => Ok(()),
        }
    }

    async fn said(&mut self, said: Said) -> Alive {
        match said {
            Said::Subscribe { subscriptions } => {
                for wanted in subscriptions {
                    let channel = usize::try_from(wanted.channel_id).ok().filter(|&c| c < CHANNELS.len());
                    match channel {
                        Some(channel) => {
                            self.shown.subscriptions[channel] = Some(wanted.id);
                            self.shown.outdate(&[channel]);
                            self.shown.is_cloud_due |= channel == CLOUD;
                        }
                        None => self.warn("channel", &format!("there is no channel {}", wanted.channel_id)).await?,
                    }
                }
                Ok(())
            }
            Said::Unsubscribe { subscription_ids } => {
                for wanted in &mut self.shown.subscriptions {
                    *wanted = wanted.filter(|id| !subscription_ids.contains(id));
                }
                Ok(())
            }
            Said::Advertise { channels } => {
                for channel in channels {
                    if self.client.len() >= MAX_CLIENT_CHANNELS {
                        return self.warn("topics", &format!("more than {MAX_CLIENT_CHANNELS} topics at a time")).await;
                    }
                    self.client.insert(channel.id, channel);
                }
                Ok(())
            }
            Said::Unadvertise { channel_ids } => {
                self.client.retain(|id, _| !channel_ids.contains(id));
                Ok(())
            }
            Said::Else => Ok(()),
        }
    }

    /// A message of the client: goals are planned to.
    async fn published(&mut self, bytes: &[u8]) -> Alive {
        let Some((id, message)) = protocol::client_message(bytes) else {
            return self.warn("said", "a binary message of yours cannot be read").await;
        };
        let Some(channel) = self.client.get(&id) else {
            return self.warn("topics", &format!("you publish by channel {id}, which was not advertised")).await;
        };
        if channel.brings::<PoseStamped<'_>>() {
            let goal = PoseStamped::decode(message).map(|goal| (goal.header.frame_id, goal.pose));
            return match in_map(goal) {
                Ok(t_map_goal) => self.plan(&t_map_goal).await,
                Err(words) => self.warn("goal", &format!("the goal {words}")).await,
            };
        }
        if channel.brings::<PoseWithCovarianceStamped<'_>>() {
            let place = PoseWithCovarianceStamped::decode(message).map(|told| (told.header.frame_id, told.pose.pose));
            return match in_map(place) {
                Ok(t_map_base) => self.place(t_map_base).await,
                Err(words) => self.warn("place", &format!("the pose {words}")).await,
            };
        }
        let words = format!(
            "{} has {} as {}: taken are goals, geometry_msgs/msg/PoseStamped, and where the robot is, \
             geometry_msgs/msg/PoseWithCovarianceStamped, as cdr",
            channel.topic, channel.schema_name, channel.encoding
        );
        self.warn("topics", &words).await
    }

    /// Says where the robot is.
    async fn place(&mut self, t_map_base: Pose) -> Alive {
        // As a request of any other's.
        let placed = match self.service.caller(self.caller.context().clone()) {
            Ok(caller) => caller.set_pose(&self.session, t_map_base).await,
            Err(error) => Err(error),
        };
        match placed {
            Ok(_) => self.text(protocol::remove_status("place")).await,
            Err(error) => self.warn("place", &error.to_string()).await,
        }
    }

    async fn plan(&mut self, t_map_goal: &Pose) -> Alive {
        // A goal is a request like any other's.
        if let Err(error) = self.service.caller(self.caller.context().clone()) {
            return self.warn("goal", &format!("no path: {error}")).await;
        }
        match self.results().plan(t_map_goal).await {
            Ok(planned) => {
                self.shown.plan = Some(planned.path);
                self.shown.outdate(&[PLAN]);
                match planned.why_none {
                    Some(why) => self.warn("goal", &format!("no path: {why}")).await?,
                    None => self.text(protocol::remove_status("goal")).await?,
                }
                self.refresh(false).await
            }
            Err(error) => self.warn("goal", &format!("no path: {error}")).await,
        }
    }

    async fn happened(&mut self, event: EventKind) -> Alive {
        match event {
            EventKind::Pose(pose) => {
                self.send(protocol::time(time_ns(pose.stamp))).await?;
                self.shown.newest = Some(*pose);
                self.shown.outdate(&[TF, POSE]);
                self.pose().await
            }
            EventKind::Object(_) => {
                self.shown.outdate(&[OBJECTS, DETECTIONS]);
                Ok(())
            }
            EventKind::Keyframe(_) | EventKind::MapVersion(_) | EventKind::Loop(_) | EventKind::Resync(_) => {
                self.shown.outdate(&[GRID, PATH, CLOUD, TF_STATIC]);
                Ok(())
            }
        }
    }

    /// What is due once a period.
    async fn show(&mut self) -> Alive {
        self.shown.periods = self.shown.periods.wrapping_add(1);
        let is_due = std::mem::take(&mut self.shown.is_cloud_due) || self.shown.periods.is_multiple_of(CLOUD_EVERY);
        self.refresh(is_due).await
    }

    /// Where the robot is; where it is not known to be, the last place stays.
    async fn pose(&mut self) -> Alive {
        let Some(pose) = self.shown.newest.clone().filter(|pose| !pose.state.is_lost() && pose.scale.is_metric())
        else {
            return Ok(());
        };
        if self.shown.take(TF) {
            let message = self.results().transform(pose.stamp, BASE, &pose.t_map_base);
            self.give(TF, message).await?;
        }
        if self.shown.take(POSE) {
            let message = self.results().pose(&pose);
            self.give(POSE, message).await?;
        }
        Ok(())
    }

    async fn refresh(&mut self, with_clouds: bool) -> Alive {
        self.pose().await?;
        if self.shown.take(TF_STATIC) {
            let message = mounts(&self.results(), self.shown.stamp()).await;
            self.give(TF_STATIC, message).await?;
        }
        if self.shown.take(GRID) {
            let message = self.results().map().await;
            self.give(GRID, message).await?;
        }
        if self.shown.take(PATH) {
            let path = self.results().path().await;
            if let Some(message) = path.transpose() {
                self.give(PATH, message).await?;
            }
        }
        if with_clouds && self.shown.take(CLOUD) {
            let message = self.results().cloud().await;
            self.give(CLOUD, message).await?;
        }
        let (objects, detections) = (self.shown.take(OBJECTS), self.shown.take(DETECTIONS));
        if objects || detections {
            match self.results().things(self.shown.stamp()).await {
                Ok((markers, boxes)) => {
                    self.give(OBJECTS, Ok(markers)).await?;
                    self.give(DETECTIONS, Ok(boxes)).await?;
                }
                Err(error) => self.give(OBJECTS, Err(error)).await?,
            }
        }
        if self.shown.take(PLAN)
            && let Some(plan) = self.shown.plan.clone()
        {
            self.give(PLAN, Ok(plan)).await?;
        }
        Ok(())
    }

    fn results(&self) -> Results<'_> {
        Results { caller: &self.caller, session: &self.session, map_frame: MAP }
    }

    /// Sends a message of a channel to who wants it, or says why there is none.
    async fn give(&mut self, channel: usize, message: Result<Vec<u8>, NoMessage>) -> Alive {
        let topic = CHANNELS[channel].topic;
        match message {
            Ok(message) => {
                let Some(subscription) = self.shown.subscriptions[channel] else { return Ok(()) };
                self.send(protocol::message_data(subscription, time_ns(self.shown.stamp()), &message)).await
            }
            // It is asked for again with the next change.
            Err(error) => self.warn(topic, &format!("{topic}: {error}")).await,
        }
    }

    async fn warn(&mut self, id: &str, words: &str) -> Alive {
        self.text(protocol::status(Level::Warning, id, words)).await
    }

    async fn text(&mut self, text: String) -> Alive {
        self.frame(Frame::Text(text.into())).await
    }

    async fn send(&mut self, bytes: Vec<u8>) -> Alive {
        self.frame(Frame::Binary(bytes.into())).await
    }

    /// Sends a frame; who does not read for long is gone.
    async fn frame(&mut self, frame: Frame) -> Alive {
        match tokio::time::timeout(self.patience, self.socket.send(frame)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) | Err(_) => Err(Gone),
        }
    }
}

/// Where sensors sit on the robot.
async fn mounts(results: &Results<'_>, stamp: Timestamp) -> Result<Vec<u8>, NoMessage> {
    let sensors = results.caller.list_sensors(results.session).await?;
    let mounts = sensors.iter().map(|s| (s.declaration.spec.id.0.as_str(), s.declaration.spec.t_base_sensor));
    transforms(stamp, BASE, mounts)
}

/// A stamp of the session's clock as the protocol has it.
fn time_ns(stamp: Timestamp) -> u64 {
    u64::try_from(stamp.0).unwrap_or_default()
}
