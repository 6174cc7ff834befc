//! The ingest stream: messages in, one acknowledgement each in order out, and how far they are durable.

use super::{Api, Streamed, check_size, status};
use percept_service::{Error, IncomingFrame, Processed, Result, Session, Ticket};
use percept_wire::{convert, v1};
use std::collections::VecDeque;
use std::sync::Arc;
use tokio::sync::{mpsc, oneshot, watch};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Status, Streaming};

/// Frames under way in one stream; beyond it the reader stops reading and flow control holds the sender.
const WINDOW: usize = 32;

/// A message and what will become of it.
struct Sent {
    sensor_id: String,
    sequence: u64,
    stamp_ns: i64,
    outcome: Outcome,
}

enum Outcome {
    Pending { session: Arc<Session>, answer: oneshot::Receiver<Result<Processed>> },
    Refused(Error),
}

/// Decodes a message, counting what is refused.
pub(super) async fn decode(api: &Api, message: &v1::SensorMessage) -> Result<IncomingFrame> {
    let decoded = convert::sensors::frame(message, api.service.limits());
    if decoded.is_err()
        && let Ok(session) = api.service.session(&message.session_id).await
    {
        session.rejected(&message.sensor_id.as_str().into());
    }
    decoded
}

/// Takes a stream in; the answer ends when all of it is processed and durable.
pub(super) fn stream(api: Api, requests: Streaming<v1::StreamFramesRequest>) -> Streamed<v1::StreamFramesResponse> {
    let (sent, under_way) = mpsc::channel(WINDOW);
    let (acks, answer) = mpsc::channel(WINDOW);
    tokio::spawn(read(api, requests, sent, acks.clone()));
    tokio::spawn(acknowledge(under_way, acks));
    Box::pin(ReceiverStream::new(answer))
}

type Acks = mpsc::Sender<std::result::Result<v1::StreamFramesResponse, Status>>;

async fn read(api: Api, mut requests: Streaming<v1::StreamFramesRequest>, sent: mpsc::Sender<Sent>, acks: Acks) {
    let mut stopping = api.stopping.clone();
    loop {
        let request = tokio::select! {
            request = requests.message() => request,
            () = stopped(&mut stopping) => {
                let words = "the server is stopping; reconnect and send what was not acknowledged as durable";
                let _ = acks.send(Err(status::grpc(Error::new(percept_service::ErrorCode::Unavailable, "STOPPING", words)))).await;
                return;
            }
        };
        let request = match request {
            Ok(Some(request)) => request,
            Ok(None) => return,
            Err(broken) => {
                let _ = acks.send(Err(broken)).await;
                return;
            }
        };
        if sent.send(submit(&api, request.message.unwrap_or_default()).await).await.is_err() {
            return;
        }
    }
}

async fn submit(api: &Api, message: v1::SensorMessage) -> Sent {
    let (sensor_id, sequence, stamp_ns) = (message.sensor_id.clone(), message.sequence, message.stamp_ns);
    let submitted = async {
        check_size(&message, api)?;
        let incoming = decode(api, &message).await?;
        drop(message);
        let session = api.service.session(&incoming.session).await?;
        session.numbered(&incoming.frame.sensor, incoming.sequence);
        let answer = session.submit(incoming.frame).await?;
        Ok(Outcome::Pending { session, answer })
    };
    let outcome = submitted.await.unwrap_or_else(Outcome::Refused);
    Sent { sensor_id, sequence, stamp_ns, outcome }
}

/// Which positions of the stream wait for which ticket of which session to be durable.
#[derive(Default)]
struct Durability {
    /// Positions in order; a refused message waits for nothing.
    waiting: VecDeque<Option<(watch::Receiver<Ticket>, Ticket)>>,
    count: u64,
}

impl Durability {
    fn advance(&mut self) -> u64 {
        while let Some(front) = self.waiting.front() {
            if front.as_ref().is_some_and(|(durable, ticket)| *durable.borrow() < *ticket) {
                break;
            }
            self.waiting.pop_front();
            self.count += 1;
        }
        self.count
    }

    /// Waits until everything is durable, or can no longer become so.
    async fn finish(&mut self) -> u64 {
        while let Some(front) = self.waiting.front_mut() {
            if let Some((durable, ticket)) = front {
                let wanted = *ticket;
                if durable.wait_for(|d| *d >= wanted).await.is_err() {
                    return self.count;
                }
            }
            self.waiting.pop_front();
            self.count += 1;
        }
        self.count
    }
}

async fn acknowledge(mut under_way: mpsc::Receiver<Sent>, acks: Acks) {
    let mut durability = Durability::default();
    while let Some(sent) = under_way.recv().await {
        let (outcome, ticket) = match sent.outcome {
            Outcome::Refused(e) => (Err(e), None),
            Outcome::Pending { session, answer } => match answer.await {
                Ok(Ok(processed)) => {
                    let ticket = (session.durable(), processed.ticket);
                    (Ok(processed), Some(ticket))
                }
                Ok(Err(e)) => (Err(e), None),
                Err(_) => (Err(Error::internal("a frame's answer was lost")), None),
            },
        };
        durability.waiting.push_back(ticket);
        let ack = v1::FrameAck {
            sensor_id: sent.sensor_id,
            sequence: sent.sequence,
            stamp_ns: sent.stamp_ns,
            durable_count: durability.advance(),
            outcome: Some(match &outcome {
                Ok(processed) => v1::frame_ack::Outcome::Result(convert::sessions::result_to(processed)),
                Err(e) => v1::frame_ack::Outcome::Rejection(convert::sessions::error_to(e)),
            }),
        };
        if acks.send(Ok(v1::StreamFramesResponse { ack: Some(ack) })).await.is_err() {
            return;
        }
    }
    let durable_count = durability.finish().await;
    let last = v1::FrameAck { durable_count, ..v1::FrameAck::default() };
    let _ = acks.send(Ok(v1::StreamFramesResponse { ack: Some(last) })).await;
}

async fn stopped(stopping: &mut watch::Receiver<bool>) {
    let _ = stopping.wait_for(|s| *s).await;
}
