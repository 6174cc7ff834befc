//! Who is there, by liveliness tokens: of sessions percept declares them, of the drivers of sensors it hears them.
//!
//! - `percept/<session>/alive`: the session is awake, and answers;
//! - `percept/<session>/<sensor>/alive`: a driver's own. That it is gone is noted of the session, for those who look at it.

use super::{Failure, Names, ROOT, hand_over};
use futures::future::try_join_all;
use percept_service::{Caller, FleetFilter, FleetGroup};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::time::Duration;
use tokio::sync::mpsc;
use zenoh::liveliness::LivelinessToken;
use zenoh::sample::SampleKind;

/// What comes and goes while one is worked on; more wait in zenoh's own queue.
const BACKLOG: usize = 64;
/// Life events read at a time; whatever they are, the list is read again.
const EVENTS_PER_READ: usize = 1000;
/// Between two readings of the list at least.
const PAUSE: Duration = Duration::from_millis(200);

/// Declares and hears tokens on a network, until dropped.
pub(super) async fn serve(zenoh: &zenoh::Session, names: &Names) -> Result<(), Failure> {
    let told = names.callers()?.into_iter().map(|caller| tell(zenoh, caller));
    tokio::try_join!(try_join_all(told), hear(zenoh, names)).map(drop)
}

/// Keeps a token for each of the caller's sessions that is awake.
async fn tell(zenoh: &zenoh::Session, caller: Caller) -> Result<(), Failure> {
    let filter = FleetFilter { groups: vec![FleetGroup::Life], ..FleetFilter::default() };
    // Who may see no session has none to tell of.
    let Ok(life) = caller.watch_sessions(filter) else { return std::future::pending().await };
    let mut tokens: BTreeMap<String, LivelinessToken> = BTreeMap::new();
    let mut newest = life.newest_token();
    loop {
        let awake = super::awake(&caller).await?;
        tokens.retain(|id, _| awake.contains(id));
        for id in awake {
            if let Entry::Vacant(vacant) = tokens.entry(id) {
                let key = format!("{ROOT}/{}/alive", vacant.key());
                vacant.insert(zenoh.liveliness().declare_token(key).await?);
            }
        }
        // What passes the filter and says nothing moves the token on alone.
        loop {
            let Some((events, up_to)) = life.after(newest, EVENTS_PER_READ).await else { return Ok(()) };
            newest = up_to;
            if !events.is_empty() {
                break;
            }
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// Notes of sessions which drivers have gone, and that they are there again.
async fn hear(zenoh: &zenoh::Session, names: &Names) -> Result<(), Failure> {
    let (heard, mut changes) = mpsc::channel::<(String, bool)>(BACKLOG);
    let take = move |sample: zenoh::sample::Sample| {
        let is_there = sample.kind() == SampleKind::Put;
        drop(hand_over(&heard, (sample.key_expr().as_str().to_owned(), is_there)));
    };
    let key = format!("{ROOT}/*/*/alive");
    let _drivers = zenoh.liveliness().declare_subscriber(key).history(true).callback(take).await?;
    while let Some((key, is_there)) = changes.recv().await {
        let mut chunks = key.split('/').skip(1);
        let (session, sensor) = (chunks.next().unwrap_or_default(), chunks.next().unwrap_or_default());
        let words = format!(
            "the driver of {sensor} has left the zenoh network: it was closed or has failed, or its link is gone; its frames \
             come again when it is back"
        );
        if let Ok(caller) = names.sender(session) {
            caller.note_driver(session, &sensor.into(), (!is_there).then_some(words)).await;
        }
    }
    Ok(())
}
