use super::*;
use futures::StreamExt;
use http_body_util::{BodyExt, StreamBody};
use std::net::SocketAddr;

const PATIENCE: Patience = Patience { body: Duration::from_secs(20), between_messages: Duration::from_secs(600) };

fn message(length: usize) -> Vec<u8> {
    let mut out = vec![0];
    out.extend_from_slice(&u32::try_from(length).unwrap().to_be_bytes());
    out.resize(PREFIX + length, 7);
    out
}

fn peer() -> Peer {
    Peer::at(SocketAddr::from(([127, 0, 0, 1], 1)))
}

fn parts(parts: Vec<Vec<u8>>) -> impl Body<Data = Bytes, Error = BoxError> + Unpin {
    StreamBody::new(futures::stream::iter(parts).map(|part| Ok::<_, BoxError>(Frame::data(Bytes::from(part)))).boxed())
}

#[test]
fn messages_are_told_apart_however_they_are_cut() {
    let stream = [message(3), message(0), message(1000)].concat();
    for step in [1, 2, 4, 5, 6, 7, 100, 2000] {
        let mut progress = Progress::new(Framing::Messages, Instant::now());
        let whole: Vec<usize> = stream.chunks(step).flat_map(|part| progress.take(part, Instant::now())).collect();
        assert_eq!((whole, progress.received), (vec![8, 5, 1005], 0), "step {step}");
    }
}

#[test]
fn a_declared_length_takes_no_memory_until_it_comes() {
    let mut progress = Progress::new(Framing::Message, Instant::now());
    let start = &message(4 << 20)[..100];
    progress.take(start, Instant::now());
    assert_eq!(progress.wanted(), 0, "as small as this is free");
    progress.take(&vec![7; 1 << 20], Instant::now());
    assert_eq!(progress.wanted(), 2 * ((1 << 20) + 100));
}

#[tokio::test]
async fn memory_is_held_until_the_message_is_done_with() {
    let memory = Memory::new(1 << 20, 1 << 20);
    let body = parts(vec![message(1000), message(500)]);
    let (mut arriving, _, held) = Arriving::new(body, Framing::Messages, &memory, &peer(), None);
    arriving.frame().await.unwrap().unwrap();
    arriving.frame().await.unwrap().unwrap();
    assert!(arriving.frame().await.is_none());
    drop(arriving);
    assert_eq!(memory.taken(), 1510);
    drop(held.take());
    assert_eq!(memory.taken(), 505);
    drop(held);
    assert_eq!(memory.taken(), 0);
}

#[tokio::test]
async fn beyond_the_memory_a_body_is_refused_and_what_it_had_comes_back() {
    let memory = Memory::new(1 << 20, 1 << 20);
    for framing in [Framing::Whole, Framing::Message] {
        let body = parts(message(2 << 20).chunks(100_000).map(<[u8]>::to_vec).collect());
        let (mut arriving, _, _held) = Arriving::new(body, framing, &memory, &peer(), None);
        let error = loop {
            match arriving.frame().await.unwrap() {
                Ok(_) => assert!(memory.taken() <= 1 << 20),
                Err(error) => break error,
            }
        };
        let status = error.downcast_ref::<tonic::Status>().unwrap();
        assert_eq!(status.code(), tonic::Code::ResourceExhausted);
        drop(arriving);
        assert_eq!(memory.taken(), 0);
    }
}

#[test]
fn slow_bodies_are_late_and_pauses_between_messages_are_not() {
    let begin = Instant::now();
    let after = |s| begin + Duration::from_secs(s);
    let mut stopped = Progress::new(Framing::Whole, begin);
    assert!(!stopped.is_late(PATIENCE, after(100)), "nobody waits for it yet");
    stopped.waits = true;
    assert!(!stopped.is_late(PATIENCE, after(19)));
    assert!(stopped.is_late(PATIENCE, after(20)));
    let mut trickling = Progress::new(Framing::Message, begin);
    trickling.waits = true;
    trickling.take(&message(1 << 20)[..6], after(19));
    assert!(!trickling.is_late(PATIENCE, after(30)), "its time begins with its first byte");
    for s in 20..40 {
        trickling.take(&[7], after(s));
    }
    assert!(trickling.is_late(PATIENCE, after(39)), "a byte a second is too slow");
    let mut fast = Progress::new(Framing::Message, begin);
    fast.waits = true;
    for s in 0..1000 {
        fast.take(&if s == 0 { message(1 << 30)[..20_000].to_vec() } else { vec![7; 20_000] }, after(s));
        assert!(!fast.is_late(PATIENCE, after(s)), "{s}");
    }
    let mut pausing = Progress::new(Framing::Messages, begin);
    pausing.waits = true;
    pausing.take(&message(10), after(1));
    assert!(!pausing.is_late(PATIENCE, after(600)));
    assert!(pausing.is_late(PATIENCE, after(601)));
    pausing.take(&message(10)[..7], after(601));
    assert!(pausing.is_late(PATIENCE, after(621)), "half a message is no pause");
}

#[tokio::test]
async fn a_stopping_server_cuts_what_is_not_whole() {
    let memory = Memory::new(1 << 20, 1 << 20);
    let never = StreamBody::new(futures::stream::pending::<Result<Frame<Bytes>, BoxError>>());
    let (mut arriving, sender, _) = Arriving::new(never, Framing::Whole, &memory, &peer(), None);
    let mut frame = Box::pin(arriving.frame());
    assert!(futures::poll!(&mut frame).is_pending());
    assert!(sender.check(PATIENCE, false, Instant::now()));
    assert!(futures::poll!(&mut frame).is_pending());
    sender.check(PATIENCE, true, Instant::now());
    let error = frame.await.unwrap().unwrap_err();
    assert_eq!(error.downcast_ref::<tonic::Status>().unwrap().code(), tonic::Code::Unavailable);
    drop(arriving);
    assert!(!sender.check(PATIENCE, false, Instant::now()), "nothing is left to watch");
}
