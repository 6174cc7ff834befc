//! Which node a session belongs to, where several share the data: numbered objects that are created and never changed.
//!
//! `sessions/<id>/<generation>/lease/<n>`, of which the highest number says how things are: `held` by a node,
//! `released`, or `deleting`. Whoever changes something creates the next number, which only one can do. A lease whose
//! node is dead (see [`crate::node`]) is taken over in the same way; the epoch of the session's records then keeps the
//! former holder from confirming anything, whatever it believes.

use futures::TryStreamExt;
use object_store::path::Path;
use object_store::{Error, ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload};

use crate::catalogue::{self, SessionPlace};
use crate::error::StoreError;
use crate::node::Node;

const FOLDER: &str = "lease";
const TITLE: &str = "percept-lease ";
const HELD: &str = "held";
const RELEASED: &str = "released";
const DELETING: &str = "deleting";

/// What came of asking for a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Claim {
    /// It is this node's, until it is released or the node is silent for too long.
    Ours,
    /// Another node has it, and may be alive.
    Elsewhere {
        /// The address that the other node advertises.
        address: String,
    },
    /// It was deleted.
    Gone,
}

struct Lease {
    number: u64,
    state: String,
    node: String,
}

/// Takes a session that nobody living has.
pub(crate) async fn claim(objects: &dyn ObjectStore, node: &Node, place: &SessionPlace) -> Result<Claim, StoreError> {
    let life = node.life();
    loop {
        if !life.is_alive() {
            return Err(StoreError::NodeSilent);
        }
        let number = match newest(objects, place).await? {
            None => 0,
            Some(lease) if lease.state == DELETING => {
                catalogue::bury(objects, place).await?;
                return Ok(Claim::Gone);
            }
            Some(lease) if lease.state == HELD && lease.node == life.node => return Ok(Claim::Ours),
            Some(lease) if lease.state == HELD => match node.address_of(&lease.node).await? {
                Some(address) => return Ok(Claim::Elsewhere { address }),
                None => lease.number + 1,
            },
            Some(lease) => lease.number + 1,
        };
        if !create(objects, place, number, HELD, &life.node).await? {
            continue;
        }
        // Older numbers are removed: this one may have been taken before, long ago.
        if numbers(objects, place).await?.last() != Some(&number) {
            delete(objects, place, number).await?;
            continue;
        }
        if !catalogue::is_there(objects, place).await? {
            delete(objects, place, number).await?;
            return Ok(Claim::Gone);
        }
        tidy(objects, place, number).await;
    }
}

/// Gives a session back, if it is this node's.
pub(crate) async fn release(objects: &dyn ObjectStore, node: &Node, place: &SessionPlace) -> Result<(), StoreError> {
    let own = node.life().node.clone();
    if let Some(lease) = newest(objects, place).await?
        && lease.state == HELD
        && lease.node == own
        && create(objects, place, lease.number + 1, RELEASED, &own).await?
    {
        tidy(objects, place, lease.number + 1).await;
    }
    Ok(())
}

/// Makes sure that no other node can take a session that is about to be buried. `false` if it is buried already.
pub(crate) async fn condemn(objects: &dyn ObjectStore, node: &Node, place: &SessionPlace) -> Result<bool, StoreError> {
    match claim(objects, node, place).await? {
        Claim::Ours => {}
        Claim::Elsewhere { address } => return Err(StoreError::Elsewhere { address }),
        Claim::Gone => return Ok(false),
    }
    let own = node.life().node.clone();
    match newest(objects, place).await? {
        Some(lease) if lease.state == HELD && lease.node == own => {
            let is_done = create(objects, place, lease.number + 1, DELETING, &own).await?;
            if is_done { Ok(true) } else { Err(StoreError::Fenced { epoch: 0 }) }
        }
        _ => Err(StoreError::Fenced { epoch: 0 }),
    }
}

/// Where another living node is that has a session, if one has.
pub(crate) async fn holder(
    objects: &dyn ObjectStore,
    node: &Node,
    place: &SessionPlace,
) -> Result<Option<String>, StoreError> {
    match newest(objects, place).await? {
        Some(lease) if lease.state == HELD && lease.node != node.life().node => node.address_of(&lease.node).await,
        _ => Ok(None),
    }
}

/// Whether it was decided that a session is deleted.
pub(crate) async fn is_condemned(objects: &dyn ObjectStore, place: &SessionPlace) -> Result<bool, StoreError> {
    Ok(newest(objects, place).await?.is_some_and(|lease| lease.state == DELETING))
}

async fn newest(objects: &dyn ObjectStore, place: &SessionPlace) -> Result<Option<Lease>, StoreError> {
    loop {
        let Some(&number) = numbers(objects, place).await?.last() else { return Ok(None) };
        // One that is gone by now has a successor.
        if let Some(lease) = read(objects, place, number).await? {
            return Ok(Some(lease));
        }
    }
}

async fn numbers(objects: &dyn ObjectStore, place: &SessionPlace) -> Result<Vec<u64>, StoreError> {
    let listed = objects.list(Some(&place.folder().join(FOLDER)));
    let number = |path: &Path| path.filename().and_then(|name| u64::from_str_radix(name, 16).ok());
    let found = listed.try_filter_map(|meta| async move { Ok(number(&meta.location)) }).try_collect::<Vec<_>>().await;
    let mut numbers = found.map_err(|error| StoreError::from_object("list leases", error))?;
    numbers.sort_unstable();
    Ok(numbers)
}

async fn read(objects: &dyn ObjectStore, place: &SessionPlace, number: u64) -> Result<Option<Lease>, StoreError> {
    let read = async { objects.get(&path(place, number)).await?.bytes().await };
    let bytes = match read.await {
        Ok(bytes) => bytes,
        Err(Error::NotFound { .. }) => return Ok(None),
        Err(error) => return Err(StoreError::from_object("read a lease", error)),
    };
    // One that cannot be read is nobody's.
    let text = String::from_utf8_lossy(&bytes);
    let words = text.trim_end().strip_prefix(TITLE).and_then(|rest| rest.split_once(' '));
    let (state, node) = words.unwrap_or((RELEASED, ""));
    Ok(Some(Lease { number, state: state.to_owned(), node: node.to_owned() }))
}

/// Whether it was this node that created the lease.
async fn create(
    objects: &dyn ObjectStore,
    place: &SessionPlace,
    number: u64,
    state: &str,
    node: &str,
) -> Result<bool, StoreError> {
    let content = PutPayload::from(format!("{TITLE}{state} {node}\n"));
    match objects.put_opts(&path(place, number), content, PutOptions::from(PutMode::Create)).await {
        Ok(_) => Ok(true),
        // A request that was sent twice finds its own object.
        Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => {
            let found = read(objects, place, number).await?;
            Ok(found.is_some_and(|lease| lease.state == state && lease.node == node))
        }
        Err(error) => Err(StoreError::from_object("write a lease", error)),
    }
}

async fn delete(objects: &dyn ObjectStore, place: &SessionPlace, number: u64) -> Result<(), StoreError> {
    match objects.delete(&path(place, number)).await {
        Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
        Err(error) => Err(StoreError::from_object("delete a lease", error)),
    }
}

/// Removes older leases; what stays is removed the next time.
async fn tidy(objects: &dyn ObjectStore, place: &SessionPlace, newest: u64) {
    for number in numbers(objects, place).await.unwrap_or_default().into_iter().filter(|number| *number < newest) {
        if let Err(error) = delete(objects, place, number).await {
            tracing::debug!(%error, "an old lease stays");
        }
    }
}

fn path(place: &SessionPlace, number: u64) -> Path {
    place.folder().join(FOLDER).join(format!("{number:016x}"))
}
