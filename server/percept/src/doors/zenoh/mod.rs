//! The zenoh door: sensor messages in, poses and events out, maps and scene by query. Payloads are the contract's.
//!
//! Key expressions, `<session>` and `<sensor>` being ids:
//! - in: `percept/<session>/<sensor>/frame`, a `SensorMessage` whose ids, if set, agree with the key;
//! - out: `percept/<session>/pose` (`PoseEstimate`), `percept/<session>/events` (`SessionEvent`);
//! - queryable: `percept/<session>/map/occupancy` (`OccupancyGridChunk`, whole), `.../map/cloud` (`CloudChunk`,
//!   whole), `.../scene/graph` (`SceneGraph`), `.../scene/objects` (`ListObjectsResponse`), `.../sensors`
//!   (`ListSensorsResponse`), `.../pose` (`PoseEstimate`). Errors are an error reply with an `ErrorInfo`.
//!
//! A frame that is refused has no one to be told: it is counted in the sensor's status.

mod lanes;
mod publish;
mod query;

use super::grpc::Api;
use percept_service::{Error, IncomingFrame};
use percept_wire::{convert, v1};
use prost::Message;
use std::sync::Arc;
use tokio::sync::mpsc;
use zenoh::sample::Sample;

/// First chunk of every key.
const ROOT: &str = "percept";
/// Samples of a session that wait between the network and the decoder; beyond it the link is held.
const BACKLOG: usize = 16;

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn config(endpoint: &str, max_message_bytes: usize) -> Result<zenoh::Config, Failure> {
    let mut config = zenoh::Config::default();
    let endpoints = serde_json::to_string(&[endpoint])?;
    for (key, value) in [
        ("mode", "\"peer\""),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("listen/endpoints", endpoints.as_str()),
        ("transport/shared_memory/enabled", "true"),
        // The default of 1 GiB would let one peer take all memory.
        ("transport/link/rx/max_message_size", &max_message_bytes.saturating_mul(2).to_string()),
    ] {
        config.insert_json5(key, value)?;
    }
    Ok(config)
}

/// Serves until the server stops. Opened before it returns its future's first await point is over.
pub(crate) struct ZenohDoor {
    session: zenoh::Session,
}

impl ZenohDoor {
    /// Opens a peer that listens on `endpoint`, e.g. `tcp/127.0.0.1:7447`.
    pub(crate) async fn open(api: &Api, endpoint: &str) -> Result<Self, Failure> {
        let session = zenoh::open(config(endpoint, api.service.limits().max_message_bytes)?).await?;
        Ok(Self { session })
    }

    /// Serves until the server stops.
    pub(crate) async fn serve(self, api: Api) -> Result<(), Failure> {
        let publishers = Arc::new(publish::Publishers::new(self.session.clone(), api.clone()));
        let lanes = lanes::Lanes::new({
            let api = api.clone();
            move |sample| take(api.clone(), Arc::clone(&publishers), sample)
        });
        let frames = format!("{ROOT}/*/*/frame");
        let subscriber = self.session.declare_subscriber(frames).callback(move |s| lanes.put(s)).await?;
        let queries = query::serve(&self.session, api.clone()).await?;
        let mut stopping = api.stopping.clone();
        tokio::select! {
            () = queries => {}
            _ = stopping.wait_for(|s| *s) => {}
        }
        subscriber.undeclare().await?;
        self.session.close().await
    }
}

/// Called on zenoh's own threads: waiting here holds the sender, which is what BLOCK means. Those threads drive
/// zenoh's runtime, which must be told before one of them waits. Gives back what nobody will take any more.
fn hand_over<T>(to: &mpsc::Sender<T>, item: T) -> Option<T> {
    match to.try_send(item) {
        Ok(()) => None,
        Err(mpsc::error::TrySendError::Closed(item)) => Some(item),
        Err(mpsc::error::TrySendError::Full(item)) => {
            tokio::task::block_in_place(|| to.blocking_send(item)).err().map(|refused| refused.0)
        }
    }
}

/// Decodes a sample and hands it on.
async fn take(api: Api, publishers: Arc<publish::Publishers>, sample: Sample) {
    let key = sample.key_expr().as_str().to_owned();
    match decode(&api, &key, &sample).await {
        Ok(incoming) => {
            publishers.watch(&incoming.session).await;
            api.service.offer_frame(incoming).await;
        }
        Err(error) => tracing::warn!(key, reason = error.reason, %error, "frame refused"),
    }
}

async fn decode(api: &Api, key: &str, sample: &Sample) -> Result<IncomingFrame, Error> {
    let mut chunks = key.split('/').skip(1);
    let (session, sensor) = (chunks.next().unwrap_or_default(), chunks.next().unwrap_or_default());
    let decoded = decode_message(api, session, sensor, sample);
    if decoded.is_err()
        && let Ok(session) = api.service.session(session).await
    {
        session.rejected(&sensor.into());
    }
    decoded
}

fn decode_message(api: &Api, session: &str, sensor: &str, sample: &Sample) -> Result<IncomingFrame, Error> {
    let (size, limit) = (sample.payload().len(), api.service.limits().max_message_bytes);
    if size > limit {
        let words = format!("message has {size} bytes, the limit is {limit}; send less at a time, or downsample");
        return Err(Error::exhausted("MESSAGE_TOO_LARGE", "", words));
    }
    let bytes = bytes::Bytes::copy_from_slice(&sample.payload().to_bytes());
    let mut message = v1::SensorMessage::decode(bytes)
        .map_err(|e| Error::invalid("MESSAGE_INVALID", "", format!("payload is no SensorMessage: {e}")))?;
    for (field, from_key, sent) in
        [("session_id", session, &mut message.session_id), ("sensor_id", sensor, &mut message.sensor_id)]
    {
        if sent.is_empty() {
            *sent = from_key.to_owned();
        } else if sent != from_key {
            let words = format!("{field} is {sent:?} but the key says {from_key:?}; make them agree, or leave it out");
            return Err(Error::invalid("KEY_MISMATCH", field, words));
        }
    }
    convert::sensors::frame(&message, api.service.limits())
}
