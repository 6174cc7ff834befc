//! The body of a request as it comes: charged to the sender's share of memory before it is kept, and broken off when it
//! comes too slowly.

use crate::doors::bounds::{Charge, Memory, Peer};
use crate::doors::status;
use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use percept_service::reason;
use percept_service::{Error, ErrorCode, Limits};
use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::task::{Context, Poll, Waker};
use std::time::{Duration, Instant};

/// What a body has to come at on average, once its first time is over.
const LEAST_BYTES_PER_S: u64 = 16 << 10;
/// Memory is taken in steps that double, from this one on. What is one request, and no larger, takes none: questions are
/// answered whatever else is under way.
const FIRST_STEP: usize = 64 << 10;
/// Length of what stands before each message of gRPC: a flag, and the message's length.
const PREFIX: usize = 5;

type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// What a body consists of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Framing {
    /// One thing.
    Whole,
    /// One message of gRPC.
    Message,
    /// Any number of them, with pauses between.
    Messages,
    /// The same, all of them small, and nothing is kept of them.
    Talk,
}

impl Framing {
    const fn has_pauses(self) -> bool {
        matches!(self, Self::Messages | Self::Talk)
    }
}

/// How long a body may keep the server waiting.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    body: Duration,
    between_messages: Duration,
}

impl Patience {
    pub(super) fn of(limits: &Limits) -> Self {
        let seconds = |s: usize| Duration::from_secs(s as u64);
        Self { body: seconds(limits.body_timeout_s), between_messages: seconds(limits.stream_idle_timeout_s) }
    }
}

/// What a request's messages have taken of the sender's memory, in the order in which they came; goes with the request's
/// extensions. What nobody takes out is given back when the request is answered.
#[derive(Clone, Default)]
pub(crate) struct Held(Arc<Mutex<VecDeque<Charge>>>);

impl Held {
    /// Charges that are kept apart; what comes beyond is of a handler that does not take them.
    const APART: usize = 256;

    /// The oldest message's.
    pub(crate) fn take(&self) -> Option<Charge> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }

    fn put(&self, charge: Charge) {
        let mut held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if held.len() >= Self::APART
            && let Some(last) = held.back_mut()
        {
            last.absorb(charge);
        } else {
            held.push_back(charge);
        }
    }
}

/// Where in a body the sender is.
struct Progress {
    framing: Framing,
    /// Since when the thing or message under way, or the pause before it.
    began: Instant,
    /// When something last came.
    last: Instant,
    /// Whether the server waits for more.
    waits: bool,
    /// Of the prefix of the message under way.
    prefix: [u8; PREFIX],
    /// What came of the message under way, with its prefix.
    received: usize,
    /// Why the body ends early.
    cut: Option<Error>,
    waker: Option<Waker>,
}

impl Progress {
    fn new(framing: Framing, now: Instant) -> Self {
        Self { framing, began: now, last: now, waits: false, prefix: [0; PREFIX], received: 0, cut: None, waker: None }
    }

    /// Length of the message under way, with its prefix, once that has come.
    fn length(&self) -> Option<usize> {
        let [_, a, b, c, d] = self.prefix;
        (self.received >= PREFIX && self.framing != Framing::Whole)
            .then(|| PREFIX + u32::from_be_bytes([a, b, c, d]) as usize)
    }

    /// Notes a part; gives the lengths of the messages that are whole with it.
    fn take(&mut self, mut part: &[u8], now: Instant) -> Vec<usize> {
        self.last = now;
        if self.framing == Framing::Whole {
            self.received += part.len();
            return vec![];
        }
        let mut whole = vec![];
        while !part.is_empty() {
            if self.received == 0 {
                self.began = now;
            }
            let wanted = self.length().unwrap_or(PREFIX) - self.received;
            let (now_come, rest) = part.split_at(wanted.min(part.len()));
            if let Some(place) = self.prefix.get_mut(self.received..self.received + now_come.len()) {
                place.copy_from_slice(now_come);
            }
            self.received += now_come.len();
            part = rest;
            if self.framing == Framing::Talk && self.length().is_some_and(|length| length > FIRST_STEP) {
                let words = format!("a message here has at most {FIRST_STEP} bytes");
                self.cut(Error::exhausted(reason::MESSAGE_TOO_LARGE, "", words));
                return whole;
            }
            if self.length() == Some(self.received) {
                whole.push(self.received);
                (self.received, self.began) = (0, now);
            }
        }
        whole
    }

    /// Memory to have for what is under way: what came, and as much again.
    fn wanted(&self) -> usize {
        if self.received == 0 {
            return 0;
        }
        let step = (2 * self.received).max(FIRST_STEP).min(self.length().unwrap_or(usize::MAX)).max(self.received);
        self.charged(step)
    }

    /// What a message of this length takes.
    fn charged(&self, length: usize) -> usize {
        if self.framing != Framing::Messages && length <= FIRST_STEP { 0 } else { length }
    }

    fn is_late(&self, patience: Patience, now: Instant) -> bool {
        if !self.waits {
            return false;
        }
        if self.framing.has_pauses() && self.received == 0 {
            return now.duration_since(self.last) >= patience.between_messages;
        }
        let in_all = patience.body + Duration::from_secs(self.received as u64 / LEAST_BYTES_PER_S);
        now.duration_since(self.last) >= patience.body || now.duration_since(self.began) >= in_all
    }

    fn cut(&mut self, error: Error) {
        self.cut.get_or_insert(error);
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }
}

fn lock(progress: &Mutex<Progress>) -> MutexGuard<'_, Progress> {
    progress.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Watches a body that comes.
pub(super) struct Sender(Weak<Mutex<Progress>>);

impl Sender {
    /// Breaks off what is late, or, when the server stops, what is not whole. False once there is nothing to watch.
    pub(super) fn check(&self, patience: Patience, is_over: bool, now: Instant) -> bool {
        let Some(progress) = self.0.upgrade() else { return false };
        let mut progress = lock(&progress);
        if is_over {
            let words = "the server is stopping and the request was not whole; send it again when it is back";
            progress.cut(Error::new(ErrorCode::Unavailable, reason::STOPPING, words));
        } else if progress.is_late(patience, now) {
            let error = late(&progress, patience);
            progress.cut(error);
        }
        true
    }
}

fn late(progress: &Progress, patience: Patience) -> Error {
    if progress.framing.has_pauses() && progress.received == 0 {
        let words = format!(
            "no message came for {} s, the limit; open the stream again when there is one",
            patience.between_messages.as_secs()
        );
        return Error::new(ErrorCode::Unavailable, reason::STREAM_IDLE, words);
    }
    let words = format!(
        "the request stopped, or came slower than {LEAST_BYTES_PER_S} bytes a second, for {} s; send it faster, or less",
        patience.body.as_secs()
    );
    Error::new(ErrorCode::DeadlineExceeded, reason::BODY_TOO_SLOW, words)
}

type Growth = Pin<Box<dyn Future<Output = (Charge, Result<(), Error>)> + Send>>;

enum Account {
    Open(Charge),
    /// Waits for memory.
    Growing(Growth),
    /// It broke.
    Closed,
}

/// The body.
pub(super) struct Arriving<B> {
    body: B,
    progress: Arc<Mutex<Progress>>,
    account: Account,
    /// A part that waits for memory, and the messages that are whole with it.
    part: Option<(Frame<Bytes>, Vec<usize>)>,
    held: Held,
    /// What the transport may keep before this asks for it.
    _window: Option<Charge>,
}

impl<B> Arriving<B> {
    pub(super) fn new(
        body: B,
        framing: Framing,
        memory: &Arc<Memory>,
        peer: &Peer,
        window: Option<Charge>,
    ) -> (Self, Sender, Held) {
        let progress = Arc::new(Mutex::new(Progress::new(framing, Instant::now())));
        let (sender, held) = (Sender(Arc::downgrade(&progress)), Held::default());
        let account = Account::Open(memory.charge(peer));
        let arriving = Self { body, progress, account, part: None, held: held.clone(), _window: window };
        (arriving, sender, held)
    }

    /// Hands out the part, its memory being there.
    fn hand_out(&mut self, mut charge: Charge) -> Option<Result<Frame<Bytes>, BoxError>> {
        let (frame, whole) = self.part.take()?;
        for length in whole {
            let taken = charge.split(length);
            if taken.bytes() > 0 {
                self.held.put(taken);
            }
        }
        self.account = Account::Open(charge);
        Some(Ok(frame))
    }
}

fn refused<T>(error: Error) -> Poll<Option<Result<Frame<T>, BoxError>>> {
    Poll::Ready(Some(Err(Box::new(status::grpc(error)))))
}

impl<B> Body for Arriving<B>
where
    B: Body<Data = Bytes> + Unpin,
    B::Error: Into<BoxError>,
{
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        let this = &mut *self;
        loop {
            match std::mem::replace(&mut this.account, Account::Closed) {
                Account::Closed => return Poll::Ready(None),
                Account::Growing(mut growth) => match growth.as_mut().poll(cx) {
                    Poll::Pending => {
                        this.account = Account::Growing(growth);
                        return Poll::Pending;
                    }
                    Poll::Ready((charge, Ok(()))) => return Poll::Ready(this.hand_out(charge)),
                    Poll::Ready((_, Err(error))) => return refused(error),
                },
                Account::Open(mut charge) => {
                    let mut progress = lock(&this.progress);
                    if let Some(error) = progress.cut.take() {
                        return refused(error);
                    }
                    let Poll::Ready(polled) = Pin::new(&mut this.body).poll_frame(cx) else {
                        if !std::mem::replace(&mut progress.waits, true) {
                            // The time while nobody asked is not the sender's.
                            progress.last = Instant::now();
                        }
                        progress.waker = Some(cx.waker().clone());
                        this.account = Account::Open(charge);
                        return Poll::Pending;
                    };
                    progress.waits = false;
                    let frame = match polled {
                        None => {
                            if progress.framing == Framing::Whole {
                                this.held.put(charge);
                            }
                            return Poll::Ready(None);
                        }
                        Some(Err(error)) => return Poll::Ready(Some(Err(error.into()))),
                        Some(Ok(frame)) => frame,
                    };
                    let whole = frame.data_ref().map(|part| progress.take(part, Instant::now())).unwrap_or_default();
                    let wanted = whole.iter().map(|&l| progress.charged(l)).sum::<usize>() + progress.wanted();
                    let more = wanted.saturating_sub(charge.bytes());
                    drop(progress);
                    this.part = Some((frame, whole));
                    if more == 0 || charge.try_grow(more) {
                        return Poll::Ready(this.hand_out(charge));
                    }
                    this.account = Account::Growing(Box::pin(async move {
                        let grown = charge.grow(more).await;
                        (charge, grown)
                    }));
                }
            }
        }
    }

    fn is_end_stream(&self) -> bool {
        self.part.is_none() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests;
