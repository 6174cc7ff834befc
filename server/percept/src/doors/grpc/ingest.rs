//! The ingest stream: messages in, one acknowledgement each in order out, and how far they are durable.

use super::super::bounds::{Charge, Place};
use super::super::listener::Held;
use super::{Api, Streamed, check_size, status, stopped};
use percept_geometry::Timestamp;
use percept_service::admission::TenantPlace;
use percept_service::reason;
use percept_service::{Caller, Durable, Error, IncomingFrame, Pending, Result, Session, Ticket, observe};
use percept_wire::{convert, v1};
use prost::Message;
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Weak};
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Status, Streaming};

/// Frames under way in one stream; beyond it the reader stops reading and flow control holds the sender.
const WINDOW: usize = 32;

const OPERATION: &str = "SensorsService/StreamFrames";

/// Messages above it are decoded beside the threads that serve everyone else.
const LARGE_BYTES: usize = 256 << 10;

/// A message and what will become of it.
struct Sent {
    sensor_id: String,
    sequence: u64,
    stamp_ns: i64,
    outcome: Outcome,
}

enum Outcome {
    Pending { session: Arc<Session>, answer: Pending, memory: Option<Charge> },
    Refused(Error),
}

/// Decodes a message for an operation of the table, counting what is refused. What takes long (images, large clouds) is done
/// beside the threads that serve everyone else.
pub(crate) async fn decode(
    caller: &Caller,
    operation: &'static str,
    message: v1::SensorMessage,
) -> Result<IncomingFrame> {
    caller.may_with(operation, &message.session_id).await?;
    let (session, sensor) = (message.session_id.clone(), message.sensor_id.clone());
    let limits = Arc::clone(caller.limits());
    let decoded = if takes_long(&message) {
        caller.decode(&session, move || convert::sensors::frame(&message, &limits)).await.flatten()
    } else {
        convert::sensors::frame(&message, &limits)
    };
    if let Err(e) = &decoded {
        observe::frame_refused(None, e.reason);
        caller.rejected(&session, &sensor.as_str().into(), e).await;
    }
    decoded
}

/// The same for a frame by itself, which is refused if it comes too soon.
pub(crate) async fn decode_at_once(
    caller: &Caller,
    operation: &'static str,
    message: v1::SensorMessage,
) -> Result<IncomingFrame> {
    if let Err(refused) = caller.admit_frame(&message.session_id, message.encoded_len()) {
        observe::frame_refused(None, refused.reason);
        caller.rejected(&message.session_id, &message.sensor_id.as_str().into(), &refused).await;
        return Err(refused);
    }
    decode(caller, operation, message).await
}

fn takes_long(message: &v1::SensorMessage) -> bool {
    use v1::sensor_message::Data;
    let is_image = matches!(message.data, Some(Data::Depth(_) | Data::Rgbd(_) | Data::Colour(_)));
    is_image || message.encoded_len() > LARGE_BYTES
}

/// Takes a stream in; the answer ends when all of it is processed and durable.
///
/// `held` gives each message's memory, which is given back when the message is acknowledged.
pub(super) fn stream(
    api: Api,
    caller: Caller,
    requests: Streaming<v1::StreamFramesRequest>,
    held: Held,
    place: (Place, TenantPlace),
) -> Streamed<v1::StreamFramesResponse> {
    let (sent, under_way) = mpsc::channel(WINDOW);
    let (acks, answer) = mpsc::channel(WINDOW);
    let (answered, answers) = watch::channel(0);
    let open = observe::stream(observe::Stream::Ingest);
    let order = Order { sessions: HashMap::new(), num_sent: 0, answers };
    let reading = read(api, caller, requests, held, order, sent, acks.clone());
    tokio::spawn(async move {
        reading.await;
        drop(open);
    });
    tokio::spawn(async move {
        acknowledge(under_way, answered, acks).await;
        drop(place);
    });
    Box::pin(ReceiverStream::new(answer))
}

/// Keeps a frame from overtaking another that is turned away: it could not be sent again, being older then than what its
/// session has.
struct Order {
    /// Those that the stream's frames went to; one that ended has a successor of the same id.
    sessions: HashMap<String, Weak<Session>>,
    num_sent: u64,
    /// Frames that were answered, as they come.
    answers: watch::Receiver<u64>,
}

impl Order {
    /// Before the first frame for a session that has ended and begun anew, all those before are answered. False if one of
    /// them was turned away.
    async fn keep(&mut self, session: &Arc<Session>) -> bool {
        let now = Arc::downgrade(session);
        let before = self.sessions.insert(session.id().to_owned(), Weak::clone(&now));
        if before.is_none_or(|before| before.ptr_eq(&now)) {
            return true;
        }
        let num_sent = self.num_sent;
        self.answers.wait_for(|answered| *answered >= num_sent).await.is_ok()
    }
}

type Acks = mpsc::Sender<std::result::Result<v1::StreamFramesResponse, Status>>;

async fn read(
    api: Api,
    caller: Caller,
    mut requests: Streaming<v1::StreamFramesRequest>,
    held: Held,
    mut order: Order,
    sent: mpsc::Sender<Sent>,
    acks: Acks,
) {
    let mut stopping = api.stopping.clone();
    let mut ended = std::pin::pin!(caller.ended());
    loop {
        // A sender that is too fast is held back: what it sends next is not read.
        let next = async {
            let request = requests.message().await;
            if let Ok(Some(v1::StreamFramesRequest { message: Some(message) })) = &request {
                caller.pace_frame(&message.session_id, message.encoded_len()).await;
            }
            request
        };
        let request = tokio::select! {
            request = next => request,
            error = &mut ended => {
                let _ = acks.send(Err(status::grpc(error))).await;
                return;
            }
            // The client has gone; nothing else would tell while it sends nothing.
            () = acks.closed() => return,
            () = stopped(&mut stopping) => {
                let words = "the server is stopping; reconnect and send what was not acknowledged as durable";
                let _ = acks.send(Err(status::grpc(Error::new(percept_service::ErrorCode::Unavailable, reason::STOPPING, words)))).await;
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
        let message = request.message.unwrap_or_default();
        let Some(submitted) = submit(&api, &caller, &mut order, message, held.take()).await else { return };
        let is_turned_away = matches!(&submitted.outcome, Outcome::Refused(e) if status::is_for_now(e.code, e.reason));
        if sent.send(submitted).await.is_err() || is_turned_away {
            return;
        }
        order.num_sent += 1;
    }
}

/// None if a frame before was turned away, so that this one is not taken.
async fn submit(
    api: &Api,
    caller: &Caller,
    order: &mut Order,
    message: v1::SensorMessage,
    memory: Option<Charge>,
) -> Option<Sent> {
    let (sensor_id, sequence, stamp_ns) = (message.sensor_id.clone(), message.sequence, message.stamp_ns);
    let submitted = async {
        check_size(&message, api)?;
        let session = message.session_id.clone();
        let incoming = decode(caller, OPERATION, message).await?;
        if !order.keep(&caller.session(OPERATION, &session).await?).await {
            return Ok(None);
        }
        let (session, answer) = caller.submit(incoming).await?;
        Ok(Some(Outcome::Pending { session, answer, memory }))
    };
    let outcome = submitted.await.unwrap_or_else(|e| Some(Outcome::Refused(e)))?;
    Some(Sent { sensor_id, sequence, stamp_ns, outcome })
}

/// Which positions of the stream wait for which ticket of which session to be durable.
#[derive(Default)]
struct Durability {
    /// Positions in order; a refused message waits for nothing.
    waiting: VecDeque<Option<(Durable, Ticket)>>,
    count: u64,
}

impl Durability {
    fn advance(&mut self) -> u64 {
        while let Some(front) = self.waiting.front() {
            if front.as_ref().is_some_and(|(durable, ticket)| !durable.has(*ticket)) {
                break;
            }
            self.waiting.pop_front();
            self.count += 1;
        }
        self.count
    }

    /// Waits until everything is durable, or can no longer become so.
    async fn finish(&mut self) -> u64 {
        // The newest first: what comes before it is durable with it.
        for (durable, ticket) in self.waiting.iter_mut().rev().flatten().take(1) {
            let _ = durable.reach(*ticket).await;
        }
        while let Some(front) = self.waiting.front_mut() {
            if let Some((durable, ticket)) = front
                && !durable.reach(*ticket).await
            {
                return self.count;
            }
            self.waiting.pop_front();
            self.count += 1;
        }
        self.count
    }
}

async fn acknowledge(mut under_way: mpsc::Receiver<Sent>, answered: watch::Sender<u64>, acks: Acks) {
    let mut durability = Durability::default();
    while let Some(sent) = under_way.recv().await {
        let (outcome, ticket) = match sent.outcome {
            Outcome::Refused(e) => (Err(e), None),
            Outcome::Pending { session, answer, memory } => {
                let answer = answer.answer().await;
                drop(memory);
                let ticket = match &answer {
                    Ok(processed) => Some(processed.ticket),
                    // One that is sent again, because its sender does not know it to be durable: neither do we.
                    Err(e) if matches!(e.reason, reason::STAMP_NOT_INCREASING | reason::CLOCK_SET_BACK) => {
                        session.ticket_of_refused(&sent.sensor_id.as_str().into(), Timestamp::from_nanos(sent.stamp_ns))
                    }
                    Err(_) => None,
                };
                (answer, ticket.map(|ticket| (session.durable(), ticket)))
            }
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
        // What is turned away for now ends the stream, so that it can be sent again before what follows it.
        if let Err(e) = outcome
            && status::is_for_now(e.code, e.reason)
        {
            let _ = acks.send(Err(status::grpc(e))).await;
            return;
        }
        answered.send_modify(|count| *count += 1);
    }
    let durable_count = tokio::select! {
        count = durability.finish() => count,
        // Nobody is there to be told.
        () = acks.closed() => return,
    };
    let last = v1::FrameAck { durable_count, ..v1::FrameAck::default() };
    let _ = acks.send(Ok(v1::StreamFramesResponse { ack: Some(last) })).await;
}
