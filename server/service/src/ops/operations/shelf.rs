//! The operations of a server: whose they are, whose turn it is, and when they are forgotten.

use super::progress::{Progress, cancelled};
use super::{NewOperation, Operation, OperationState, Work};
use crate::clock::now_ns;
use crate::{Error, ErrorCode, Limits, Result, observe, reason};
use bytes::Bytes;
use percept_identity::Access;
use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::watch;

/// How often those whose time is over are looked for.
const SWEEP: Duration = Duration::from_secs(5);

struct Entry {
    owner: String,
    new: NewOperation,
    state: OperationState,
    progress: Progress,
    cancel_requested: bool,
    /// Until it runs.
    work: Option<Work>,
    error: Option<Error>,
    parts: Arc<Vec<Bytes>>,
    /// Of the request until the end, then of the result.
    held_bytes: usize,
    /// Unique, so that it is the order of lists.
    create_time_ns: i64,
    run_time_ns: Option<i64>,
    end_time_ns: Option<i64>,
    expire_time_ns: Option<i64>,
    ended: watch::Sender<bool>,
}

impl Entry {
    fn described(&self, id: &str) -> Operation {
        let is_done = self.state == OperationState::Done;
        Operation {
            id: id.to_owned(),
            kind: self.new.kind,
            session: self.new.session.clone(),
            state: self.state,
            how_far: self.progress.how_far(),
            cancel_requested: self.cancel_requested,
            error: self.error.clone(),
            result_bytes: is_done.then_some(self.held_bytes),
            create_time_ns: self.create_time_ns,
            run_time_ns: self.run_time_ns,
            end_time_ns: self.end_time_ns,
            expire_time_ns: self.expire_time_ns,
            request_id: self.new.request_id.clone(),
        }
    }

    fn moved(&mut self, to: OperationState) {
        observe::operation_moved(Some(self.state), Some(to));
        self.state = to;
    }

    /// Ends it; `held_bytes` is what it holds from now on.
    fn end(&mut self, state: OperationState, kept: Duration) {
        let now = now_ns();
        let took = self.run_time_ns.map(|began| Duration::from_nanos(now.saturating_sub(began).max(0) as u64));
        observe::operation_ended(self.new.kind, state, took);
        if state == OperationState::Done && self.progress.how_far().fraction.is_some() {
            // What was found sooner than it had to be is done all the same.
            self.progress.done(1, 1);
        }
        self.moved(state);
        self.work = None;
        self.end_time_ns = Some(now);
        self.expire_time_ns = Some(now.saturating_add(i64::try_from(kept.as_nanos()).unwrap_or(i64::MAX)));
        self.ended.send_replace(true);
    }

    fn fail(&mut self, state: OperationState, error: Error, kept: Duration) {
        (self.error, self.held_bytes) = (Some(error), 0);
        self.end(state, kept);
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        observe::operation_moved(Some(self.state), None);
    }
}

#[derive(Default)]
struct Shelf {
    entries: HashMap<String, Entry>,
    running: usize,
    /// When each owner had its last turn, in turns.
    turns: BTreeMap<String, u64>,
    turn: u64,
    newest_ns: i64,
    is_stopping: bool,
}

impl Shelf {
    fn held_bytes(&self, of: impl Fn(&Entry) -> bool) -> usize {
        self.entries.values().filter(|e| of(e)).map(|e| e.held_bytes).sum()
    }

    /// Whose turn it is: of the owners that run the fewest, and fewer than they may, who has waited longest for a turn.
    fn next(&self, most_of_an_owner: usize) -> Option<String> {
        let running = |owner: &str| {
            self.entries.values().filter(|e| e.owner == owner && e.state == OperationState::Running).count()
        };
        let waiting = self.entries.iter().filter(|(_, e)| e.state == OperationState::Queued);
        let turns = waiting.map(|(id, e)| (running(&e.owner), self.turns.get(&e.owner), e.create_time_ns, id));
        let next = turns.filter(|(running, ..)| *running < most_of_an_owner).min();
        next.map(|(.., id)| id.clone())
    }

    fn of<'a>(&'a mut self, owner: &str, id: &str) -> Result<&'a mut Entry> {
        self.entries.get_mut(id).filter(|e| e.owner == owner).ok_or_else(|| not_found(id))
    }
}

/// All operations of a server.
pub(crate) struct Operations {
    shelf: Mutex<Shelf>,
    limits: Arc<Limits>,
}

impl Operations {
    /// None yet; those whose time is over are forgotten, asked or not.
    pub(crate) fn open(limits: &Arc<Limits>) -> Arc<Self> {
        let operations = Arc::new(Self { shelf: Mutex::default(), limits: Arc::clone(limits) });
        let weak = Arc::downgrade(&operations);
        tokio::spawn(async move {
            loop {
                tokio::time::sleep(SWEEP).await;
                let Some(operations) = weak.upgrade() else { return };
                drop(operations.swept(now_ns()));
            }
        });
        operations
    }

    fn kept(&self) -> Duration {
        Duration::from_secs(self.limits.operation_kept_s as u64)
    }

    /// The shelf without those whose time is over.
    fn swept(&self, now_ns: i64) -> MutexGuard<'_, Shelf> {
        let mut shelf = self.shelf.lock().unwrap_or_else(PoisonError::into_inner);
        shelf.entries.retain(|_, e| e.expire_time_ns.is_none_or(|end| end > now_ns));
        let Shelf { entries, turns, .. } = &mut *shelf;
        turns.retain(|owner, _| entries.values().any(|e| e.owner == *owner));
        observe::operation_bytes(shelf.held_bytes(|_| true));
        shelf
    }

    pub(super) fn start(self: &Arc<Self>, owner: &str, new: NewOperation, work: Work) -> Result<Operation> {
        let mut shelf = self.swept(now_ns());
        let is_same = |e: &Entry| e.owner == owner && e.new.request_id == new.request_id;
        if !new.request_id.is_empty()
            && let Some((id, first)) = shelf.entries.iter().find(|(_, e)| is_same(e))
        {
            return Ok(first.described(id));
        }
        if shelf.is_stopping {
            return Err(stopping());
        }
        self.check_number(&shelf, owner)?;
        self.check_room(&shelf, owner, new.request_bytes)?;
        let id = new_id()?;
        let create_time_ns = now_ns().max(shelf.newest_ns + 1);
        shelf.newest_ns = create_time_ns;
        let entry = Entry {
            owner: owner.to_owned(),
            held_bytes: new.request_bytes,
            new,
            state: OperationState::Queued,
            progress: Progress::default(),
            cancel_requested: false,
            work: Some(work),
            error: None,
            parts: Arc::default(),
            create_time_ns,
            run_time_ns: None,
            end_time_ns: None,
            expire_time_ns: None,
            ended: watch::Sender::new(false),
        };
        observe::operation_moved(None, Some(entry.state));
        shelf.entries.insert(id.clone(), entry);
        self.advance(&mut shelf);
        shelf.of(owner, &id).map(|e| e.described(&id))
    }

    /// One that was started with this id, if that is known still.
    pub(super) fn started(&self, owner: &str, request_id: &str) -> Option<Operation> {
        let shelf = self.swept(now_ns());
        let is_same = |e: &Entry| e.owner == owner && !request_id.is_empty() && e.new.request_id == request_id;
        shelf.entries.iter().find(|(_, e)| is_same(e)).map(|(id, first)| first.described(id))
    }

    fn check_number(&self, shelf: &Shelf, owner: &str) -> Result<()> {
        let own = shelf.entries.values().filter(|e| e.owner == owner).count();
        let (most, most_own) = (self.limits.max_operations, self.limits.max_operations_per_owner);
        if own < most_own && shelf.entries.len() < most {
            return Ok(());
        }
        let n = shelf.entries.len();
        let words = format!(
            "{own} operations are yours and {n} are kept in all; the limits are {most_own} and {most}; delete some that have \
             ended, or wait"
        );
        observe::shed(reason::TOO_MANY_OPERATIONS);
        Err(Error::exhausted(reason::TOO_MANY_OPERATIONS, "", words))
    }

    fn check_room(&self, shelf: &Shelf, owner: &str, bytes: usize) -> Result<()> {
        let (own, all) = (shelf.held_bytes(|e| e.owner == owner), shelf.held_bytes(|_| true));
        let (most_own, most) = (self.limits.max_operation_bytes_per_owner, self.limits.max_operation_bytes);
        if own + bytes <= most_own && all + bytes <= most {
            return Ok(());
        }
        let words = format!(
            "requests and results of operations hold {own} bytes of yours and {all} in all, and this needs {bytes} more; the \
             limits are {most_own} and {most}; delete operations that have ended, or wait"
        );
        Err(Error::exhausted(reason::OPERATIONS_FULL, "", words))
    }

    /// Lets those run whose turn it is.
    fn advance(self: &Arc<Self>, shelf: &mut Shelf) {
        let limits = &self.limits;
        while shelf.running < limits.max_running_operations.max(1) {
            let Some(id) = shelf.next(limits.max_running_operations_per_owner.max(1)) else { return };
            shelf.turn += 1;
            let turn = shelf.turn;
            let Some(entry) = shelf.entries.get_mut(&id) else { return };
            let Some(work) = entry.work.take() else { return };
            entry.moved(OperationState::Running);
            entry.run_time_ns = Some(now_ns());
            let (owner, progress) = (entry.owner.clone(), entry.progress.clone());
            shelf.turns.insert(owner, turn);
            shelf.running += 1;
            let (operations, budget) = (Arc::clone(self), super::budget(limits));
            tokio::spawn(async move {
                // In a task of its own, so that a panic ends the operation, and not what follows.
                let outcome = tokio::spawn(run(work, progress, budget)).await;
                operations.ended_with(&id, outcome.unwrap_or_else(|panic| Err(Error::internal(panic))));
            });
        }
    }

    fn ended_with(self: &Arc<Self>, id: &str, outcome: Result<Vec<Bytes>>) {
        let mut shelf = self.swept(now_ns());
        shelf.running -= 1;
        let kept = self.kept();
        let outcome = outcome.and_then(|parts| {
            let bytes = parts.iter().map(Bytes::len).sum();
            let Some(entry) = shelf.entries.get_mut(id) else { return Ok((parts, 0)) };
            // The request is gone by now.
            entry.held_bytes = 0;
            let owner = entry.owner.clone();
            self.check_room(&shelf, &owner, bytes).map(|()| (parts, bytes))
        });
        // One that was ended by the server's end stays so.
        if let Some(entry) = shelf.entries.get_mut(id).filter(|e| !e.state.is_end()) {
            match outcome {
                Ok((parts, bytes)) => {
                    (entry.parts, entry.held_bytes) = (Arc::new(parts), bytes);
                    entry.end(OperationState::Done, kept);
                }
                Err(error) if error.reason == reason::OPERATION_CANCELLED => {
                    entry.fail(OperationState::Cancelled, error, kept);
                }
                Err(error) => entry.fail(OperationState::Failed, error, kept),
            }
        }
        observe::operation_bytes(shelf.held_bytes(|_| true));
        self.advance(&mut shelf);
    }

    pub(super) fn get(&self, owner: &str, id: &str) -> Result<Operation> {
        self.swept(now_ns()).of(owner, id).map(|e| e.described(id))
    }

    /// All of an owner's, oldest first.
    pub(super) fn all(&self, owner: &str) -> Vec<Operation> {
        let shelf = self.swept(now_ns());
        let own = shelf.entries.iter().filter(|(_, e)| e.owner == owner);
        let mut all: Vec<Operation> = own.map(|(id, e)| e.described(id)).collect();
        all.sort_by_key(|o| o.create_time_ns);
        all
    }

    /// Turns true at the end of one.
    pub(super) fn ended(&self, owner: &str, id: &str) -> Result<watch::Receiver<bool>> {
        self.swept(now_ns()).of(owner, id).map(|e| e.ended.subscribe())
    }

    pub(super) fn cancel(&self, owner: &str, id: &str) -> Result<Operation> {
        let mut shelf = self.swept(now_ns());
        let (kept, entry) = (self.kept(), shelf.of(owner, id)?);
        if !entry.state.is_end() {
            entry.cancel_requested = true;
            entry.progress.cancel();
        }
        if entry.state == OperationState::Queued {
            entry.fail(OperationState::Cancelled, cancelled(), kept);
        }
        Ok(entry.described(id))
    }

    pub(super) fn result(
        &self,
        owner: &str,
        id: &str,
        may_read: impl Fn(&[(Access, String)]) -> bool,
    ) -> Result<Arc<Vec<Bytes>>> {
        let mut shelf = self.swept(now_ns());
        let entry = shelf.of(owner, id)?;
        if !may_read(&entry.new.needs) {
            let words = "this result needs the access that the operation was started with; ask for a key that has it";
            return Err(Error::new(ErrorCode::PermissionDenied, reason::PERMISSION_DENIED, words));
        }
        match (&entry.error, entry.state.is_end()) {
            (Some(error), _) => Err(error.clone()),
            (None, true) => Ok(Arc::clone(&entry.parts)),
            (None, false) => {
                let words = format!("the operation is {} and has no result yet; wait for it", entry.state.name());
                Err(Error::new(ErrorCode::FailedPrecondition, reason::OPERATION_NOT_DONE, words))
            }
        }
    }

    pub(super) fn delete(&self, owner: &str, id: &str) -> Result<()> {
        let mut shelf = self.swept(now_ns());
        let state = shelf.of(owner, id)?.state;
        if !state.is_end() {
            let words = format!("the operation is {}; cancel it first, or wait for its end", state.name());
            return Err(Error::new(ErrorCode::FailedPrecondition, reason::OPERATION_UNDER_WAY, words));
        }
        shelf.entries.remove(id);
        observe::operation_bytes(shelf.held_bytes(|_| true));
        Ok(())
    }

    /// Takes no more, and ends all that have not ended.
    pub(crate) fn stop(&self) {
        let mut shelf = self.swept(now_ns());
        shelf.is_stopping = true;
        let kept = self.kept();
        for entry in shelf.entries.values_mut().filter(|e| !e.state.is_end()) {
            entry.progress.cancel();
            entry.fail(OperationState::Cancelled, stopping(), kept);
        }
    }
}

/// Runs the work within its budget. What was cancelled before it began does not wait for its turn in the computing lines.
async fn run(work: Work, progress: Progress, budget: Duration) -> Result<Vec<Bytes>> {
    tokio::select! {
        biased;
        outcome = work(progress.clone()) => outcome,
        () = progress.cancelled_unbegun() => Err(cancelled()),
        () = tokio::time::sleep(budget) => {
            // It may have begun, and looks here between its steps.
            progress.cancel();
            Err(crate::compute::too_long(budget))
        }
    }
}

/// 128 bits that nobody can guess: who knows an id was told it.
fn new_id() -> Result<String> {
    let mut secret = [0; 16];
    getrandom::fill(&mut secret).map_err(Error::internal)?;
    Ok(format!("op-{:032x}", u128::from_be_bytes(secret)))
}

fn not_found(id: &str) -> Error {
    let shown: String = id.chars().take(80).collect();
    let words = format!(
        "operation_id is {shown:?}, which is not known here: it was deleted, its time is over, or the server that had it was \
         stopped; start it again"
    );
    Error::not_found(reason::OPERATION_NOT_FOUND, "operation_id", words)
}

fn stopping() -> Error {
    let words = "the server is stopping, and its operations with it; start it again when it is back";
    Error::new(ErrorCode::Unavailable, reason::STOPPING, words)
}

#[cfg(test)]
mod tests;
