//! The zenoh door: sensor messages in, poses and events out, maps and scene by query. Payloads are the contract's.
//!
//! Percept listens for peers, and joins networks of zenoh ([`network`]), as the settings say. Key expressions, behind the
//! namespace if there is one, `<session>` and `<sensor>` being ids:
//! - in: `percept/<session>/<sensor>/frame`, a `SensorMessage` whose ids, if set, agree with the key;
//! - out: `percept/<session>/pose` (`PoseEstimate`), `percept/<session>/events` (`SessionEvent`);
//! - liveliness: `percept/<session>/alive`, and `percept/<session>/<sensor>/alive` of drivers ([`presence`]);
//! - queryable: `percept/<session>/map/occupancy` (`OccupancyGridChunk`, whole), `.../map/cloud` (`CloudChunk`,
//!   whole), `.../scene/graph` (`SceneGraph`), `.../scene/objects` (`ListObjectsResponse`), `.../scene/rooms` (`GetRoomsResponse`), `.../sensors`
//!   (`ListSensorsResponse`), `.../pose` (`PoseEstimate`), and `percept/<session>/rpc/<service>/<method>`: the rpc of the
//!   contract, its request as the payload, its answer whole. Errors are an error reply with an `ErrorInfo`. Where the session is a
//!   wildcard, those that are awake answer.
//!
//! Who may what is [`access`]'s: rules that zenoh enforces, and whose session it is.
//!
//! A frame that is refused has no one to be told: it is counted in the sensor's status.

mod access;
mod lanes;
mod network;
mod presence;
mod publish;
mod query;

use super::bounds::{Charge, Memory, Peer};
use super::grpc::{Api, ingest};
use super::listener::tls::{self, Stamps};
use crate::config::{Tls, Zenoh};
use access::Policy;
use percept_identity::AuthSettings;
use percept_service::reason;
use percept_service::{Caller, Error, IncomingFrame, SessionList, SessionState, observe};
use percept_wire::v1;
use prost::{Message, Name};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use zenoh::sample::Sample;

/// First chunk of every key.
const ROOT: &str = "percept";
/// Samples of a session that wait between the network and the decoder; beyond it the link is held.
const BACKLOG: usize = 16;
/// How often floods that have ended are summed up.
const COUNTS_EVERY: Duration = Duration::from_secs(5);

pub(super) type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Opens a session of zenoh.
///
/// # Errors
/// What zenoh says, without the lines of its source in which it says it.
pub(super) async fn open(config: zenoh::Config) -> Result<zenoh::Session, Failure> {
    zenoh::open(config).await.map_err(|error| without_source_lines(&error.to_string()).into())
}

/// Zenoh's errors name the file and line of each cause: ` at /some/path/file.rs:12.`
fn without_source_lines(words: &str) -> String {
    let (mut out, mut rest) = (String::new(), words);
    while let Some((before, place)) = rest.split_once(" at /") {
        let Some((_, after)) = place.split_once(".rs:").filter(|(file, _)| !file.contains(' ')) else { break };
        out.push_str(before);
        rest = after.trim_start_matches(|c: char| c.is_ascii_digit()).trim_start_matches('.');
    }
    out + rest
}

/// What every session of the door is opened with.
fn config(setup: &Setup) -> Result<zenoh::Config, Failure> {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("transport/shared_memory/enabled", "true".to_owned()),
        // The default of 1 GiB would let one peer take all memory.
        ("transport/link/rx/max_message_size", setup.max_message_bytes.saturating_mul(2).to_string()),
    ] {
        config.insert_json5(key, &value)?;
    }
    if !setup.network.namespace.is_empty() {
        config.insert_json5("namespace", &serde_json::to_string(&setup.network.namespace)?)?;
    }
    Ok(config)
}

/// A peer that listens.
fn listening(setup: &Setup, policy: &Policy) -> Result<zenoh::Config, Failure> {
    let Setup { endpoint, tls, .. } = setup;
    let mut config = config(setup)?;
    config.insert_json5("mode", "\"peer\"")?;
    config.insert_json5("listen/endpoints", &serde_json::to_string(&[endpoint])?)?;
    for (key, value) in policy.settings() {
        config.insert_json5(key, &value)?;
    }
    if tls.is_on() {
        let files = [
            ("listen_certificate", &tls.cert_file),
            ("listen_private_key", &tls.key_file),
            ("root_ca_certificate", &tls.client_ca_file),
        ];
        for (key, file) in files.into_iter().filter(|(_, file)| !file.as_os_str().is_empty()) {
            config.insert_json5(&format!("transport/link/tls/{key}"), &serde_json::to_string(file)?)?;
        }
        config.insert_json5("transport/link/tls/enable_mtls", &tls.client_cert_required.to_string())?;
    }
    Ok(config)
}

/// Serves until the server stops. Opened before it returns its future's first await point is over.
pub(crate) struct ZenohDoor {
    /// The session that listens, and of the setup's files when it was opened; none if percept only joins networks.
    listening: Option<(zenoh::Session, Stamps)>,
    names: Names,
    setup: Setup,
    /// Who may call; other rules for certificates come while the server runs.
    auth: watch::Receiver<AuthSettings>,
}

/// What a session is opened with.
struct Setup {
    /// What it listens on; nothing if empty.
    endpoint: String,
    network: Zenoh,
    max_message_bytes: usize,
    tls: Tls,
    users_file: PathBuf,
}

impl Setup {
    async fn listen(&self, policy: &Policy) -> Result<Option<(zenoh::Session, Stamps)>, Failure> {
        if self.endpoint.is_empty() {
            return Ok(None);
        }
        let stamps = self.stamps();
        Ok(Some((open(listening(self, policy)?).await?, stamps)))
    }

    /// Zenoh reads certificates and users when it is opened, and only then.
    fn stamps(&self) -> Stamps {
        let Tls { cert_file, key_file, client_ca_file, .. } = &self.tls;
        let certificates: &[&Path] = &[cert_file, key_file, client_ca_file];
        let read = if self.endpoint.starts_with("tls/") { certificates } else { &[] };
        tls::stamps(&[read, &[&self.users_file]].concat())
    }

    /// Comes when the files have changed, and fit each other.
    async fn changed(&self, opened: &Stamps) {
        loop {
            tokio::time::sleep(tls::LOOK).await;
            let now = self.stamps();
            if now == *opened || (!self.users_file.as_os_str().is_empty() && !self.users_file.is_file()) {
                continue;
            }
            match tls::check(&self.tls) {
                // Files are replaced one after the other: those that do not fit are looked at again.
                Err(error) if self.tls.is_on() => tracing::warn!(%error, "changed certificates are not used by zenoh"),
                // Whoever replaces several has done so by the next look.
                _ if now != self.stamps() => {}
                _ => return,
            }
        }
    }
}

/// The operations, in the name of those who may have sent what came for a session.
#[derive(Clone)]
struct Names {
    api: Api,
    policy: Arc<Policy>,
}

impl Names {
    fn caller(&self, session: &str) -> Result<Caller, Error> {
        self.api.service.caller(self.policy.context(session)?)
    }

    fn sender(&self, session: &str) -> Result<Caller, Error> {
        Ok(self.api.service.sender(self.policy.context(session)?))
    }

    /// One for each tenant that may send or ask here.
    fn callers(&self) -> Result<Vec<Caller>, Error> {
        let contexts = self.policy.contexts()?;
        Ok(contexts.into_iter().map(|context| self.api.service.sender(context)).collect())
    }

    /// Sessions that are awake, of all who may send or ask here.
    async fn awake(&self) -> Result<Vec<String>, Error> {
        let mut all = Vec::new();
        for caller in self.callers()? {
            all.extend(awake(&caller).await?);
        }
        Ok(all)
    }
}

/// Ids of the caller's sessions that are awake.
async fn awake(caller: &Caller) -> Result<BTreeSet<String>, Error> {
    let mut list = SessionList { state: Some(SessionState::Awake), page_size: 1000, ..SessionList::default() };
    let mut ids = BTreeSet::new();
    loop {
        let page = caller.list_sessions(&list).await?;
        ids.extend(page.items.into_iter().map(|view| view.id));
        if page.next_page_token.is_empty() {
            return Ok(ids);
        }
        list.page_token = page.next_page_token;
    }
}

/// Whether rules can be said in zenoh's terms, and its users be read; warns of rules that let nobody in.
///
/// # Errors
/// What cannot, with the remedy.
pub(crate) fn check(auth: &AuthSettings, endpoint: &str, tls: &Tls) -> Result<(), Failure> {
    if endpoint.is_empty() {
        return Ok(());
    }
    let policy = Policy::of(auth, endpoint, tls)?;
    if let Policy::Members { users_file, .. } = &policy
        && !users_file.is_empty()
        && let Err(error) = std::fs::File::open(users_file)
    {
        let words = "give the file of user:password lines, or close listen.zenoh with \"\"";
        return Err(format!("auth.zenoh_users_file is {users_file}, which cannot be read: {error}; {words}").into());
    }
    policy.warn(auth);
    Ok(())
}

impl ZenohDoor {
    /// Opens a peer that listens on `endpoint`, e.g. `tcp/127.0.0.1:7447`; without one, networks are joined alone.
    pub(crate) async fn open(
        api: &Api,
        endpoint: &str,
        network: &Zenoh,
        mut auth: watch::Receiver<AuthSettings>,
        tls: &Tls,
    ) -> Result<Self, Failure> {
        let settings = auth.borrow_and_update().clone();
        let policy = Arc::new(Policy::of(&settings, endpoint, tls)?);
        let setup = Setup {
            endpoint: endpoint.to_owned(),
            network: network.clone(),
            max_message_bytes: api.service.limits().max_message_bytes,
            tls: tls.clone(),
            users_file: settings.zenoh_users_file.clone().into(),
        };
        let listening = setup.listen(&policy).await?;
        Ok(Self { listening, names: Names { api: api.clone(), policy }, setup, auth })
    }

    /// Serves until the server stops.
    pub(crate) async fn serve(self, api: Api) -> Result<(), Failure> {
        let publishers = Arc::new(publish::Publishers::default());
        let mut networks = tokio::task::JoinSet::new();
        for router in &self.setup.network.connect {
            let attended = Attended { names: self.names.clone(), publishers: Arc::clone(&publishers) };
            networks.spawn(network::join(config(&self.setup)?, router.clone(), attended, api.stopping.clone()));
        }
        tokio::select! {
            served = self.serve_listening(&api, &publishers) => served?,
            () = tell_counts(&api) => {}
        }
        // Each leaves its network.
        while networks.join_next().await.is_some() {}
        Ok(())
    }

    /// Serves those who connect to percept. When certificates, users or rules have changed, the session closes and opens
    /// again: peers connect anew by themselves.
    async fn serve_listening(mut self, api: &Api, publishers: &Arc<publish::Publishers>) -> Result<(), Failure> {
        let mut stopping = api.stopping.clone();
        while let Some((session, stamps)) = self.listening.take() {
            let attended = Attended { names: self.names.clone(), publishers: Arc::clone(publishers) };
            let has_changed = tokio::select! {
                failed = attended.to(&session) => { failed?; false }
                () = self.setup.changed(&stamps) => true,
                Ok(()) = self.auth.changed() => true,
                _ = stopping.wait_for(|s| *s) => false,
            };
            session.close().await?;
            if !has_changed {
                return Ok(());
            }
            tracing::info!("zenoh's certificates, users or rules have changed: its door opens anew");
            while self.listening.is_none() {
                let settings = self.auth.borrow_and_update().clone();
                match Policy::of(&settings, &self.setup.endpoint, &self.setup.tls) {
                    Ok(policy) => self.names.policy = Arc::new(policy),
                    Err(error) => tracing::error!(%error, "the rules in force at the zenoh door stay"),
                }
                match self.setup.listen(&self.names.policy).await {
                    Ok(opened) => self.listening = opened,
                    Err(error) => {
                        tracing::error!(%error, "the zenoh door is closed: it cannot be opened anew");
                        let pause = tokio::time::timeout(tls::LOOK, stopping.wait_for(|s| *s));
                        if pause.await.is_ok() {
                            return Ok(());
                        }
                    }
                }
            }
        }
        let _ = stopping.wait_for(|s| *s).await;
        Ok(())
    }
}

/// What comes of what a session of zenoh brings.
#[derive(Clone)]
struct Attended {
    names: Names,
    publishers: Arc<publish::Publishers>,
}

impl Attended {
    /// Takes frames from a session, answers its questions and publishes there, until dropped.
    async fn to(&self, session: &zenoh::Session) -> Result<(), Failure> {
        let names = self.names.clone();
        let decode = move |sample, memory| decode(names.clone(), sample, memory);
        let this = self.clone();
        let give = move |decoded| give(this.clone(), decoded);
        let lanes = lanes::Lanes::new(Arc::clone(&self.names.api.bounds.memory), decode, give);
        let _published = self.publishers.to(session);
        let frames = format!("{ROOT}/*/*/frame");
        let _frames = session.declare_subscriber(frames).callback(move |s| lanes.put(s)).await?;
        let answers = query::serve(session, self.names.clone()).await?;
        tokio::select! {
            () = answers => Ok(()),
            served = presence::serve(session, &self.names) => served,
        }
    }
}

/// Called on zenoh's own threads: waiting here holds the sender, which is what BLOCK means. Those threads drive
/// zenoh's runtime, which must be told before one of them waits. Gives back what nobody will take any more.
pub(super) fn hand_over<T>(to: &mpsc::Sender<T>, item: T) -> Option<T> {
    match to.try_send(item) {
        Ok(()) => None,
        Err(mpsc::error::TrySendError::Closed(item)) => Some(item),
        Err(mpsc::error::TrySendError::Full(item)) => {
            tokio::task::block_in_place(|| to.blocking_send(item)).err().map(|refused| refused.0)
        }
    }
}

/// Memory for a sample of so many bytes; on zenoh's own threads, it waits there until a peer's or everybody's has room.
pub(super) fn charged(memory: &Arc<Memory>, peer: &Peer, bytes: usize, runtime: &tokio::runtime::Handle) -> Charge {
    let mut charge = memory.charge(peer);
    if !charge.try_grow(bytes) {
        tokio::task::block_in_place(|| runtime.block_on(charge.grow_when_there(bytes)));
    }
    charge
}

/// Tells how often faults came that were counted only, once their flood is over.
async fn tell_counts(api: &Api) {
    loop {
        tokio::time::sleep(COUNTS_EVERY).await;
        for (kind, untold) in api.service.faults().overdue() {
            tracing::warn!(kind, untold, "more of the same");
        }
    }
}

/// What came of a sample.
struct Decoded {
    key: String,
    frame: Result<(Caller, IncomingFrame), Error>,
    /// Given back when the frame is taken.
    memory: Charge,
}

async fn decode(names: Names, sample: Sample, memory: Charge) -> Decoded {
    let key = sample.key_expr().as_str().to_owned();
    let frame = frame_of(&names, &key, sample).await;
    Decoded { key, frame, memory }
}

/// Hands on what came of a sample.
async fn give(to: Attended, decoded: Decoded) {
    let Decoded { key, frame, memory } = decoded;
    let taken = match frame {
        Ok((caller, incoming)) => {
            to.publishers.watch(&caller, &incoming.session).await;
            caller.offer_frame(incoming).await
        }
        Err(error) => {
            observe::frame_refused(None, error.reason);
            Err(error)
        }
    };
    if let Err(error) = taken
        && let Some(untold) = to.names.api.service.faults().admit(&format!("frame {} {key}", error.reason))
    {
        tracing::warn!(key, reason = error.reason, untold, %error, "frame refused");
    }
    drop(memory);
}

async fn frame_of(names: &Names, key: &str, sample: Sample) -> Result<(Caller, IncomingFrame), Error> {
    let mut chunks = key.split('/').skip(1);
    let (session, sensor) = (chunks.next().unwrap_or_default(), chunks.next().unwrap_or_default());
    let caller = names.sender(session)?;
    let message = message_of(&names.api, session, sensor, &sample);
    drop(sample);
    match message {
        Ok(message) => {
            let incoming = ingest::decode_at_once(&caller, "SensorsService/SendFrame", message).await?;
            Ok((caller, incoming))
        }
        Err(error) => {
            caller.rejected(session, &sensor.into(), &error).await;
            Err(error)
        }
    }
}

fn message_of(api: &Api, session: &str, sensor: &str, sample: &Sample) -> Result<v1::SensorMessage, Error> {
    let (size, limit) = (sample.payload().len(), api.service.limits().max_message_bytes);
    if size > limit {
        let words = format!("message has {size} bytes, the limit is {limit}; send less at a time, or downsample");
        return Err(Error::exhausted(reason::MESSAGE_TOO_LARGE, "", words));
    }
    // What comes in pieces is put together once. What lies in one is copied all the same: in shared memory its sender could
    // still write to it.
    let bytes = bytes::Bytes::from(sample.payload().to_bytes().into_owned());
    percept_wire::expansion::check(&v1::SensorMessage::full_name(), &bytes)?;
    let mut message = v1::SensorMessage::decode(bytes)
        .map_err(|e| Error::invalid(reason::MESSAGE_INVALID, "", format!("payload is no SensorMessage: {e}")))?;
    for (field, from_key, sent) in
        [("session_id", session, &mut message.session_id), ("sensor_id", sensor, &mut message.sensor_id)]
    {
        if sent.is_empty() {
            *sent = from_key.to_owned();
        } else if sent != from_key {
            let words = format!("{field} is {sent:?} but the key says {from_key:?}; make them agree, or leave it out");
            return Err(Error::invalid(reason::KEY_MISMATCH, field, words));
        }
    }
    Ok(message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_zenoh_are_told_without_the_lines_of_its_source() {
        let words = "Unable to connect to any of [tcp/a:1]!  at /build/zenoh-1.10.2/src/net/orchestrator.rs:401.";
        assert_eq!(without_source_lines(words), "Unable to connect to any of [tcp/a:1]! ");
        let nested = "No at /a/b.rs:1. - Caused by refused (os error 111) at /c/d.rs:22.";
        assert_eq!(without_source_lines(nested), "No - Caused by refused (os error 111)");
        for other in ["", "there is no file at /etc/percept", "at /x y.rs:1"] {
            assert_eq!(without_source_lines(other), other);
        }
    }
}
