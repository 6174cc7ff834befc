//! The body of an answer, which can be taken away from a client that does not read it.

use bytes::Bytes;
use http_body::{Body, Frame, SizeHint};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

type BoxError = Box<dyn std::error::Error + Send + Sync>;
type Inner = Pin<Box<dyn Body<Data = Bytes, Error = BoxError> + Send>>;

struct Slot {
    /// None once it was taken away.
    body: Option<Inner>,
    /// When a part was handed out, and no other was asked for since.
    handed_out: Option<Instant>,
}

/// The body; what it keeps alive (places, memory) goes with it.
pub(super) struct Answer<G> {
    slot: Arc<Mutex<Slot>>,
    _guard: G,
}

/// Watches a body without keeping it alive.
pub(super) struct Reader(Weak<Mutex<Slot>>);

fn lock(slot: &Mutex<Slot>) -> MutexGuard<'_, Slot> {
    slot.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<G> Answer<G> {
    /// A body with what lives as long, and its watcher.
    pub(super) fn new<B>(body: B, guard: G) -> (Self, Reader)
    where
        B: Body<Data = Bytes> + Send + 'static,
        B::Error: Into<BoxError>,
    {
        let body: Inner = Box::pin(http_body_util::BodyExt::map_err(body, Into::into));
        let slot = Arc::new(Mutex::new(Slot { body: Some(body), handed_out: None }));
        let reader = Reader(Arc::downgrade(&slot));
        (Self { slot, _guard: guard }, reader)
    }
}

impl Reader {
    /// Takes the body away if nobody has asked for its next part for so long. False once there is nothing to watch.
    pub(super) fn give_up_after(&self, unread: Duration, now: Instant) -> bool {
        let Some(slot) = self.0.upgrade() else { return false };
        let mut slot = lock(&slot);
        let stalled = slot.handed_out.is_some_and(|since| now.duration_since(since) >= unread);
        let body = if stalled { slot.body.take() } else { None };
        let is_there = slot.body.is_some();
        drop(slot);
        // Outside the lock: what goes with it may take a while.
        drop(body);
        is_there
    }
}

impl<G: Unpin> Body for Answer<G> {
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        let mut slot = lock(&self.slot);
        let Some(body) = &mut slot.body else { return Poll::Ready(Some(Err("the answer was not read".into()))) };
        let polled = body.as_mut().poll_frame(cx);
        slot.handed_out = polled.is_ready().then(Instant::now);
        polled
    }

    fn is_end_stream(&self) -> bool {
        lock(&self.slot).body.as_ref().is_some_and(|b| b.is_end_stream())
    }

    fn size_hint(&self) -> SizeHint {
        lock(&self.slot).body.as_ref().map_or_else(SizeHint::default, |b| b.size_hint())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use http_body_util::{BodyExt, StreamBody};

    #[tokio::test]
    async fn an_unread_answer_is_let_go_and_a_quiet_one_stays() {
        let (parts, mut source) = tokio::sync::mpsc::channel::<&'static [u8]>(4);
        let stream = async_stream(&mut source);
        let (mut answer, reader) = Answer::new(StreamBody::new(stream), ());
        let (unread, later) = (Duration::from_secs(30), Instant::now() + Duration::from_secs(3600));
        assert!(reader.give_up_after(unread, later), "nothing was sent yet: it is quiet, not unread");
        parts.send(b"a").await.unwrap();
        answer.frame().await.unwrap().unwrap();
        assert!(reader.give_up_after(unread, Instant::now()));
        let mut asked = Box::pin(answer.frame());
        assert!(futures::poll!(&mut asked).is_pending());
        assert!(reader.give_up_after(unread, later), "its next part was asked for: it is quiet again");
        drop(asked);
        parts.send(b"b").await.unwrap();
        answer.frame().await.unwrap().unwrap();
        assert!(!reader.give_up_after(unread, later));
        assert!(parts.is_closed(), "its source ends with it");
        assert!(answer.frame().await.unwrap().is_err());
    }

    fn async_stream(
        source: &mut tokio::sync::mpsc::Receiver<&'static [u8]>,
    ) -> impl futures::Stream<Item = Result<Frame<Bytes>, BoxError>> + Send + 'static {
        let (_, empty) = tokio::sync::mpsc::channel(1);
        let source = std::mem::replace(source, empty);
        futures::StreamExt::map(tokio_stream::wrappers::ReceiverStream::new(source), |part| {
            Ok(Frame::data(Bytes::from_static(part)))
        })
    }
}
