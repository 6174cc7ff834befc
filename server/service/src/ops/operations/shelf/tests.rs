use super::*;
use crate::OperationKind;
use futures::FutureExt;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};

fn open(limits: Limits) -> Arc<Operations> {
    Operations::open(&Arc::new(limits))
}

fn new(request_id: &str, request_bytes: usize) -> NewOperation {
    let (kind, session) = (OperationKind::RunPipeline, String::new());
    NewOperation { kind, session, request_id: request_id.to_owned(), request_bytes, needs: vec![] }
}

/// Work that is over at once, with so many bytes.
fn quick(bytes: usize) -> Work {
    Box::new(move |_| async move { Ok(vec![Bytes::from(vec![1; bytes])]) }.boxed())
}

/// Work that says its name when it begins, and ends when its step is over: word comes, or it is cancelled.
fn slow(name: &'static str, begun: &UnboundedSender<&'static str>, mut step: UnboundedReceiver<()>) -> Work {
    let begun = begun.clone();
    Box::new(move |progress| {
        async move {
            progress.stage(name);
            let _ = begun.send(name);
            let _ = step.recv().await;
            progress.check().map(|()| vec![Bytes::from_static(b"slow")])
        }
        .boxed()
    })
}

fn panics() -> Result<Vec<Bytes>> {
    panic!("on purpose")
}

async fn ended(operations: &Operations, owner: &str, id: &str) -> Operation {
    let mut ended = operations.ended(owner, id).unwrap();
    ended.wait_for(|ended| *ended).await.unwrap();
    operations.get(owner, id).unwrap()
}

#[tokio::test]
async fn a_result_is_its_owners_alone_and_may_be_read_again() {
    let operations = open(Limits::default());
    let id = operations.start("me", new("", 10), quick(100)).unwrap().id;
    let done = ended(&operations, "me", &id).await;
    assert_eq!((done.state, done.result_bytes), (OperationState::Done, Some(100)));
    for _ in 0..2 {
        assert_eq!(operations.result("me", &id, |_| true).unwrap()[0].len(), 100);
    }
    assert_eq!(operations.result("me", &id, |_| false).unwrap_err().reason, "PERMISSION_DENIED");
    for error in [
        operations.get("you", &id).unwrap_err(),
        operations.result("you", &id, |_| true).unwrap_err(),
        operations.cancel("you", &id).unwrap_err(),
        operations.delete("you", &id).unwrap_err(),
        operations.ended("you", &id).unwrap_err(),
    ] {
        assert_eq!((error.reason, error.field.as_str()), ("OPERATION_NOT_FOUND", "operation_id"));
    }
    assert!(operations.all("you").is_empty());
    operations.delete("me", &id).unwrap();
    assert_eq!(operations.get("me", &id).unwrap_err().reason, "OPERATION_NOT_FOUND");
}

#[tokio::test]
async fn a_request_id_names_one_operation_of_each_owner() {
    let operations = open(Limits::default());
    let first = operations.start("me", new("once", 1), quick(1)).unwrap().id;
    assert_eq!(operations.start("me", new("once", 1), quick(1)).unwrap().id, first);
    assert_ne!(operations.start("you", new("once", 1), quick(1)).unwrap().id, first);
    assert_ne!(operations.start("me", new("", 1), quick(1)).unwrap().id, first);
    ended(&operations, "me", &first).await;
    operations.delete("me", &first).unwrap();
    assert_ne!(operations.start("me", new("once", 1), quick(1)).unwrap().id, first);
}

#[tokio::test]
async fn owners_have_turns_whoever_came_first() {
    let operations = open(Limits { max_running_operations: 1, ..Limits::default() });
    let (begun, mut begins) = unbounded_channel();
    let mut steps = vec![];
    let mut start = |owner, name| {
        let (step, until) = unbounded_channel();
        steps.push(step);
        operations.start(owner, new("", 1), slow(name, &begun, until)).unwrap()
    };
    let states: Vec<_> = [("a", "a1"), ("a", "a2"), ("a", "a3"), ("b", "b1")].map(|(o, n)| start(o, n).state).to_vec();
    assert_eq!(states[0], OperationState::Running);
    assert!(states[1..].iter().all(|s| *s == OperationState::Queued));
    drop(steps);
    let mut order = vec![];
    for _ in 0..4 {
        order.extend(begins.recv().await);
    }
    assert_eq!(order, ["a1", "b1", "a2", "a3"]);
}

#[tokio::test]
async fn an_owner_has_no_more_places_than_it_may_and_leaves_the_others_theirs() {
    let limits = Limits { max_running_operations: 3, max_running_operations_per_owner: 1, ..Limits::default() };
    let operations = open(limits);
    let (begun, _begins) = unbounded_channel();
    let mut steps = vec![];
    let mut state = |owner| {
        let (step, until) = unbounded_channel();
        steps.push(step);
        operations.start(owner, new("", 1), slow(owner, &begun, until)).unwrap().state
    };
    let states = ["a", "a", "b", "c", "d"].map(&mut state);
    use OperationState::{Queued, Running};
    assert_eq!(states, [Running, Queued, Running, Running, Queued]);
}

#[tokio::test]
async fn one_that_waits_is_cancelled_at_once_and_one_that_runs_at_its_next_step() {
    let operations = open(Limits { max_running_operations: 1, ..Limits::default() });
    let (begun, mut begins) = unbounded_channel();
    let ((step, until), (_later, never)) = (unbounded_channel(), unbounded_channel());
    let running = operations.start("me", new("", 1), slow("first", &begun, until)).unwrap().id;
    let waiting = operations.start("me", new("", 1), slow("second", &begun, never)).unwrap().id;
    assert_eq!(begins.recv().await, Some("first"));
    assert_eq!(operations.result("me", &running, |_| true).unwrap_err().reason, "OPERATION_NOT_DONE");
    assert_eq!(operations.delete("me", &running).unwrap_err().reason, "OPERATION_UNDER_WAY");

    let second = operations.cancel("me", &waiting).unwrap();
    assert_eq!((second.state, second.cancel_requested), (OperationState::Cancelled, true));
    let first = operations.cancel("me", &running).unwrap();
    assert_eq!((first.state, first.cancel_requested), (OperationState::Running, true));
    step.send(()).unwrap();
    assert_eq!(ended(&operations, "me", &running).await.state, OperationState::Cancelled);
    assert_eq!(operations.result("me", &running, |_| true).unwrap_err().reason, "OPERATION_CANCELLED");
    // The place is free again, and of what has ended nothing changes.
    let third = operations.start("me", new("", 1), quick(1)).unwrap().id;
    assert_eq!(ended(&operations, "me", &third).await.state, OperationState::Done);
    let third = operations.cancel("me", &third).unwrap();
    assert_eq!((third.state, third.cancel_requested), (OperationState::Done, false));
}

#[tokio::test]
async fn number_and_memory_are_bounded_for_each_owner_and_for_all() {
    let limits = Limits { max_operations: 3, max_operations_per_owner: 2, ..Limits::default() };
    let operations = open(Limits { max_operation_bytes: 1000, max_operation_bytes_per_owner: 600, ..limits });
    let start = |owner: &str, request, result| operations.start(owner, new("", request), quick(result));
    assert_eq!(start("a", 601, 1).unwrap_err().reason, "OPERATIONS_FULL");
    let kept = start("a", 600, 500).unwrap().id;
    assert_eq!(ended(&operations, "a", &kept).await.result_bytes, Some(500));
    // The request has gone, the result stays; another has no room beside it.
    let full = start("a", 100, 101).unwrap().id;
    let failed = ended(&operations, "a", &full).await;
    assert_eq!((failed.state, failed.error.unwrap().reason), (OperationState::Failed, "OPERATIONS_FULL"));
    assert_eq!(start("a", 1, 1).unwrap_err().reason, "TOO_MANY_OPERATIONS");
    assert_eq!(start("b", 501, 1).unwrap_err().reason, "OPERATIONS_FULL");
    let third = start("b", 500, 1).unwrap().id;
    assert_eq!(start("c", 1, 1).unwrap_err().reason, "TOO_MANY_OPERATIONS");
    ended(&operations, "b", &third).await;
    operations.delete("a", &full).unwrap();
    start("a", 100, 100).unwrap();
}

#[tokio::test]
async fn what_has_ended_is_forgotten_when_its_time_is_over_and_nothing_before() {
    let operations = open(Limits { operation_kept_s: 100, max_running_operations: 1, ..Limits::default() });
    let done = operations.start("me", new("", 1), quick(1)).unwrap().id;
    let end = ended(&operations, "me", &done).await;
    let expires = end.expire_time_ns.unwrap();
    assert_eq!(expires - end.end_time_ns.unwrap(), 100_000_000_000);
    let (begun, _begins) = unbounded_channel();
    let (_step, until) = unbounded_channel();
    let running = operations.start("me", new("", 1), slow("long", &begun, until)).unwrap().id;
    drop(operations.swept(expires - 1));
    assert!(operations.get("me", &done).is_ok());
    drop(operations.swept(expires));
    assert_eq!(operations.get("me", &done).unwrap_err().reason, "OPERATION_NOT_FOUND");
    drop(operations.swept(i64::MAX));
    assert!(operations.get("me", &running).is_ok());
}

#[tokio::test]
async fn a_panic_and_too_long_a_time_are_failures_that_free_the_place() {
    let operations = open(Limits { max_running_operations: 1, max_operation_s: 0, ..Limits::default() });
    let panics: Work = Box::new(|_| async { panics() }.boxed());
    let panicked = operations.start("me", new("", 1), panics).unwrap().id;
    let error = ended(&operations, "me", &panicked).await.error.unwrap();
    assert_eq!(error.code, ErrorCode::Internal);
    let (begun, _begins) = unbounded_channel();
    let (_step, until) = unbounded_channel();
    let late = operations.start("me", new("", 1), slow("late", &begun, until)).unwrap().id;
    let late = ended(&operations, "me", &late).await;
    assert_eq!((late.state, late.error.unwrap().reason), (OperationState::Failed, "COMPUTATION_TOO_LONG"));
    assert!(!late.cancel_requested, "nobody asked for it");
}

#[tokio::test]
async fn the_servers_end_is_the_end_of_all() {
    let operations = open(Limits { max_running_operations: 1, ..Limits::default() });
    let (begun, mut begins) = unbounded_channel();
    let ((_step, until), (_later, never)) = (unbounded_channel(), unbounded_channel());
    let running = operations.start("me", new("", 1), slow("first", &begun, until)).unwrap().id;
    let waiting = operations.start("me", new("", 1), slow("second", &begun, never)).unwrap().id;
    begins.recv().await;
    operations.stop();
    for id in [running, waiting] {
        let stopped = ended(&operations, "me", &id).await;
        assert_eq!((stopped.state, stopped.error.unwrap().reason), (OperationState::Cancelled, "STOPPING"));
    }
    assert_eq!(operations.start("me", new("", 1), quick(1)).unwrap_err().reason, "STOPPING");
}
