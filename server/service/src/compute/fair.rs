//! A line before a pool: as many jobs at a time as there are places, the others in fair turns by what they cost.
//!
//! Of those who wait, the one whose jobs have computed least goes first, as in start-time fair queueing (Goyal, Vin, Cheng:
//! Start-time fair queuing, 1996) with measured instead of announced costs. Who comes back after a pause begins where the
//! others are, so that nobody saves up turns. Who weighs twice as much pays half for the same time.

use crate::Asker;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Work, with everything that it needs.
pub(super) type Job = Box<dyn FnOnce() + Send>;

/// The line was full.
#[derive(Debug)]
pub(super) struct Full;

pub(super) struct Line {
    pool: Arc<rayon::ThreadPool>,
    places: usize,
    max_waiting: usize,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    running: usize,
    waiting: usize,
    /// By name, those who wait or are being served.
    parties: BTreeMap<String, Party>,
    /// What the party that was served last had used when its job began.
    reached: Duration,
    arrivals: u64,
}

#[derive(Default)]
struct Party {
    jobs: VecDeque<(u64, Job)>,
    /// Time used, by its weight.
    used: Duration,
    weight: u32,
    running: usize,
}

impl State {
    /// The next job by the least used, then by arrival.
    fn next(&mut self) -> Option<(String, Job)> {
        let first = |(name, party): (&String, &Party)| Some((party.used, party.jobs.front()?.0, name.clone()));
        let (used, _, name) = self.parties.iter().filter_map(first).min()?;
        let (_, job) = self.parties.get_mut(&name)?.jobs.pop_front()?;
        self.reached = self.reached.max(used);
        self.waiting -= 1;
        Some((name, job))
    }

    fn ended(&mut self, name: &str, cost: Duration) {
        self.running -= 1;
        if let Some(party) = self.parties.get_mut(name) {
            party.used += cost / party.weight.max(1);
            party.running -= 1;
        }
        // A party without work whose turn would be due at once is like a new one.
        let reached = self.reached;
        self.parties.retain(|_, p| p.running > 0 || !p.jobs.is_empty() || p.used > reached);
    }
}

impl Line {
    pub(super) fn new(pool: Arc<rayon::ThreadPool>, places: usize, max_waiting: usize) -> Arc<Self> {
        Arc::new(Self { pool, places: places.max(1), max_waiting, state: Mutex::default() })
    }

    /// Jobs that wait for a place.
    pub(super) fn waiting(&self) -> usize {
        self.lock().waiting
    }

    /// Puts a job of a party in line; it runs when its turn comes.
    pub(super) fn push(self: &Arc<Self>, asker: &Asker, job: Job) -> Result<(), Full> {
        {
            let mut state = self.lock();
            if state.running >= self.places && state.waiting >= self.max_waiting {
                return Err(Full);
            }
            state.arrivals += 1;
            let (number, reached) = (state.arrivals, state.reached);
            let party = state.parties.entry(asker.name().to_owned()).or_default();
            party.weight = u32::try_from(asker.weight()).unwrap_or(u32::MAX);
            if party.jobs.is_empty() && party.running == 0 {
                party.used = party.used.max(reached);
            }
            party.jobs.push_back((number, job));
            state.waiting += 1;
        }
        self.start();
        Ok(())
    }

    fn start(self: &Arc<Self>) {
        loop {
            let (name, job) = {
                let mut state = self.lock();
                if state.running >= self.places {
                    return;
                }
                let Some((name, job)) = state.next() else { return };
                state.running += 1;
                if let Some(party) = state.parties.get_mut(&name) {
                    party.running += 1;
                }
                (name, job)
            };
            let line = Arc::clone(self);
            self.pool.spawn(move || {
                let begin = Instant::now();
                job();
                line.lock().ended(&name, begin.elapsed());
                line.start();
            });
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waiting(state: &mut State, party: &str, n: usize) {
        for _ in 0..n {
            state.arrivals += 1;
            let number = state.arrivals;
            state.parties.entry(party.to_owned()).or_default().jobs.push_back((number, Box::new(|| ())));
            state.waiting += 1;
        }
    }

    /// Who is served, if each job costs what is said, and one runs at a time.
    fn served(state: &mut State, cost: impl Fn(&str) -> u64) -> Vec<String> {
        let mut order = vec![];
        while let Some((name, _)) = state.next() {
            state.running += 1;
            if let Some(party) = state.parties.get_mut(&name) {
                party.running += 1;
            }
            state.ended(&name, Duration::from_millis(cost(&name)));
            order.push(name);
        }
        order
    }

    #[test]
    fn one_that_floods_does_not_delay_the_others() {
        let mut state = State::default();
        waiting(&mut state, "flood", 100);
        waiting(&mut state, "calm", 2);
        let order = served(&mut state, |_| 10);
        let last = order.iter().rposition(|n| n == "calm").unwrap();
        assert!(last <= 3, "{order:?}");
    }

    #[test]
    fn turns_are_shared_by_time_and_not_by_number() {
        let mut state = State::default();
        waiting(&mut state, "heavy", 100);
        waiting(&mut state, "light", 100);
        let order = served(&mut state, |name| if name == "heavy" { 30 } else { 10 });
        let light = order[..40].iter().filter(|n| *n == "light").count();
        assert!((28..=32).contains(&light), "{light} of 40, 30 are three quarters");
    }

    #[test]
    fn who_weighs_more_gets_more() {
        let mut state = State::default();
        waiting(&mut state, "three", 100);
        waiting(&mut state, "one", 100);
        state.parties.get_mut("three").unwrap().weight = 3;
        let order = served(&mut state, |_| 10);
        let three = order[..40].iter().filter(|n| *n == "three").count();
        assert!((28..=32).contains(&three), "{three} of 40, 30 are three quarters");
    }

    #[test]
    fn who_is_alone_keeps_the_order_and_leaves_nothing_behind() {
        let mut state = State::default();
        for party in ["a", "b", "c"] {
            waiting(&mut state, party, 1);
        }
        assert_eq!(served(&mut state, |_| 0), ["a", "b", "c"]);
        assert!(state.parties.is_empty());
    }
}
