//! Which sessions there are: a numbered log for each id, made of objects that are created and never changed.
//!
//! `catalogue/<id>/<n>` with `n` in 16 hexadecimal digits. The highest number says how things are: `created` with a
//! generation and the creator's record, `deleted`, or `purged` when its data are gone, too. Whoever changes something creates the next number, which only
//! one can do, on every object store. The generation names where the session's own data lie
//! (`sessions/<id>/<generation>/`), so that an id that is used again never meets its past.
//!
//! Numbers may start again once an id's last entry is gone, so that entry goes only when nobody can be about to
//! create the number after it: at once under the lock of a process that has the data to itself, after
//! [`PURGED_STAYS`] where several share them.

use std::collections::BTreeMap;
use std::time::Duration;

use bytes::Bytes;
use futures::stream::{StreamExt, TryStreamExt};
use object_store::path::Path;
use object_store::{Error, ObjectMeta, ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload};

use crate::blobs;
use crate::error::{StoreError, shortened};

/// Folder of the logs.
pub(crate) const FOLDER: &str = "catalogue";
/// First words of an entry; a line, then the creator's record.
const CREATED: &str = "percept-session created ";
const DELETED: &str = "percept-session deleted ";
const PURGED: &str = "percept-session purged ";
/// How long `purged` entries stay where data are shared; nobody looks and creates only then.
const PURGED_STAYS: Duration = Duration::from_secs(3600);
/// Entries read at a time when all are listed: each read of a local file takes a thread.
const READS_AT_ONCE: usize = 16;

/// A session in the catalogue: its id, and which of those that had this id.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionPlace {
    pub(crate) id: String,
    pub(crate) number: u64,
    pub(crate) generation: String,
}

impl SessionPlace {
    /// The session's id.
    #[must_use]
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Number of its entry in the catalogue.
    #[must_use]
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Tells sessions apart that had the same id one after the other.
    #[must_use]
    pub fn generation(&self) -> &str {
        &self.generation
    }

    /// Folder of all that the session has stored.
    pub(crate) fn folder(&self) -> Path {
        Path::from_iter(["sessions", &self.id, &self.generation])
    }
}

/// What the catalogue says of one id.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CatalogueEntry {
    /// The session exists; with the record that its creator gave.
    Created {
        /// Where it is.
        place: SessionPlace,
        /// The creator's record.
        record: Bytes,
    },
    /// It was deleted; its data may still have to go.
    Deleted {
        /// Where it was.
        place: SessionPlace,
    },
    /// The entry cannot be read; the others can.
    Damaged {
        /// Where it is, as far as that can be told.
        place: SessionPlace,
    },
}

/// Ids that can be part of a path everywhere.
pub(crate) fn check_id(id: &str) -> Result<(), StoreError> {
    let fine = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
    if (1..=256).contains(&id.len()) && id.bytes().all(fine) {
        return Ok(());
    }
    Err(StoreError::InvalidKey { segment: shortened(id), requirement: "1 to 256 characters of a-z A-Z 0-9 _ -" })
}

/// Tells every id's newest entry, in the order of ids, as it is read: their records together may be large. With `sweep`, entries
/// that say `purged` for long enough are removed.
pub(crate) async fn for_each(
    objects: &dyn ObjectStore,
    sweep: bool,
    mut tell: impl FnMut(CatalogueEntry),
) -> Result<(), StoreError> {
    let newest = numbers(objects, &Path::from(FOLDER)).await?;
    let reads = newest.into_iter().filter_map(|(id, numbers)| Some((id, numbers.last().copied()?)));
    let mut entries = futures::stream::iter(reads.map(|(id, number)| async move { read(objects, &id, number).await }))
        .buffered(READS_AT_ONCE);
    while let Some(found) = entries.try_next().await? {
        match found.map(|found| (found.content, found.meta)) {
            Some((Content::Entry(entry), _)) => tell(entry),
            Some((Content::Purged, meta)) if sweep && blobs::age(&meta) > PURGED_STAYS => {
                let deleted = objects.delete(&meta.location).await;
                unless_missing(deleted).map_err(|error| StoreError::from_object("delete a catalogue entry", error))?;
            }
            Some((Content::Purged, _)) | None => {}
        }
    }
    Ok(())
}

/// The number of the newest entry by id.
pub(crate) async fn newest_numbers(objects: &dyn ObjectStore) -> Result<BTreeMap<String, u64>, StoreError> {
    let all = numbers(objects, &Path::from(FOLDER)).await?;
    Ok(all.into_iter().filter_map(|(id, numbers)| Some((id, *numbers.last()?))).collect())
}

/// The number that a new session of this id gets; [`StoreError::AlreadyExists`] if there is one.
pub(crate) async fn free_number(objects: &dyn ObjectStore, id: &str) -> Result<u64, StoreError> {
    // An entry that is gone by now was purged a moment ago: what was left in its place is found by looking again.
    for _ in 0..LOOKS {
        let numbers = numbers(objects, &Path::from_iter([FOLDER, id])).await?;
        let Some(&number) = numbers.get(id).and_then(|numbers| numbers.last()) else { return Ok(0) };
        match read(objects, id, number).await?.map(|found| found.content) {
            Some(Content::Entry(CatalogueEntry::Deleted { .. }) | Content::Purged) => return Ok(number + 1),
            Some(_) => break,
            None => {}
        }
    }
    Err(StoreError::AlreadyExists { id: id.to_owned() })
}

/// Looks at the entries of an id that others create, bury and purge meanwhile.
pub(crate) const LOOKS: usize = 8;

/// The newest entry of one id, if there is any and it was not purged.
pub(crate) async fn newest(objects: &dyn ObjectStore, id: &str) -> Result<Option<CatalogueEntry>, StoreError> {
    let numbers = numbers(objects, &Path::from_iter([FOLDER, id])).await?;
    let Some(&number) = numbers.get(id).and_then(|numbers| numbers.last()) else { return Ok(None) };
    Ok(match read(objects, id, number).await?.map(|found| found.content) {
        Some(Content::Entry(entry)) => Some(entry),
        Some(Content::Purged) | None => None,
    })
}

/// Adds the entry of a new session after `number`; somebody else's entry there is [`StoreError::AlreadyExists`].
pub(crate) async fn create(objects: &dyn ObjectStore, place: &SessionPlace, record: &[u8]) -> Result<(), StoreError> {
    let mut bytes = format!("{CREATED}{}\n", place.generation).into_bytes();
    bytes.extend_from_slice(record);
    match append(objects, &place.id, place.number, bytes).await {
        // A request that was sent twice finds its own entry: no other session has this generation.
        Err(StoreError::AlreadyExists { .. }) if is_entry_of(objects, place, place.number).await? => Ok(()),
        outcome => outcome,
    }
}

/// Whether the entry of this place's number says that a session before it was purged: its number is another one then.
pub(crate) async fn is_past(objects: &dyn ObjectStore, place: &SessionPlace) -> Result<bool, StoreError> {
    let found = read(objects, &place.id, place.number).await?;
    Ok(found.is_some_and(|found| matches!(found.content, Content::Purged)))
}

/// Whether a session is there now: neither buried nor followed by another.
pub(crate) async fn is_there(objects: &dyn ObjectStore, place: &SessionPlace) -> Result<bool, StoreError> {
    let newest = newest(objects, &place.id).await?;
    Ok(newest.is_some_and(|entry| match entry {
        CatalogueEntry::Created { place: found, .. } | CatalogueEntry::Damaged { place: found } => found == *place,
        CatalogueEntry::Deleted { .. } => false,
    }))
}

/// After [`create`] where others may have created, too: whether an earlier session of this id is there after all,
/// which is possible for one who slept for [`PURGED_STAYS`] between looking and creating. It is the later one that
/// goes then.
pub(crate) async fn confirm(objects: &dyn ObjectStore, place: &SessionPlace) -> Result<(), StoreError> {
    let numbers = numbers(objects, &Path::from_iter([FOLDER, &place.id])).await?;
    let earlier = numbers.get(&place.id).into_iter().flatten().rev().find(|number| **number < place.number);
    let Some(&earlier) = earlier else { return Ok(()) };
    let found = read(objects, &place.id, earlier).await?;
    if !matches!(found.map(|found| found.content), Some(Content::Entry(CatalogueEntry::Created { .. }))) {
        return Ok(());
    }
    let deleted = objects.delete(&path(&place.id, place.number)).await;
    unless_missing(deleted).map_err(|error| StoreError::from_object("delete a catalogue entry", error))?;
    Err(StoreError::AlreadyExists { id: place.id.clone() })
}

/// Adds the entry that says that a session is gone, unless it is purged already.
pub(crate) async fn bury(objects: &dyn ObjectStore, place: &SessionPlace) -> Result<(), StoreError> {
    // Another session may have come since, whose entry has the number that this one had.
    if !is_entry_of(objects, place, place.number).await? {
        return Ok(());
    }
    let bytes = format!("{DELETED}{}\n", place.generation).into_bytes();
    match append(objects, &place.id, place.number + 1, bytes).await {
        // It was said before.
        Err(StoreError::AlreadyExists { .. }) => Ok(()),
        outcome => outcome,
    }
}

/// Removes a buried session's entries and older ones, the one that says `deleted` last; with `shared`, one that says
/// `purged` is left in their place.
pub(crate) async fn forget(objects: &dyn ObjectStore, place: &SessionPlace, shared: bool) -> Result<(), StoreError> {
    let last = place.number + 1;
    if !is_entry_of(objects, place, last).await? {
        return Ok(());
    }
    if shared {
        let bytes = format!("{PURGED}{}\n", place.generation).into_bytes();
        match append(objects, &place.id, last + 1, bytes).await {
            // Said before, or a new session is there.
            Ok(()) | Err(StoreError::AlreadyExists { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    let numbers = numbers(objects, &Path::from_iter([FOLDER, &place.id])).await?;
    for number in numbers.get(&place.id).into_iter().flatten().filter(|number| **number <= last) {
        let deleted = objects.delete(&path(&place.id, *number)).await;
        unless_missing(deleted).map_err(|error| StoreError::from_object("delete a catalogue entry", error))?;
    }
    Ok(())
}

async fn append(objects: &dyn ObjectStore, id: &str, number: u64, bytes: Vec<u8>) -> Result<(), StoreError> {
    match objects.put_opts(&path(id, number), PutPayload::from(bytes), PutOptions::from(PutMode::Create)).await {
        Ok(_) => Ok(()),
        Err(Error::AlreadyExists { .. }) => Err(StoreError::AlreadyExists { id: id.to_owned() }),
        Err(error) => Err(StoreError::from_object("write a catalogue entry", error)),
    }
}

/// Numbers of entries by id, ascending; foreign names are passed over.
async fn numbers(objects: &dyn ObjectStore, below: &Path) -> Result<BTreeMap<String, Vec<u64>>, StoreError> {
    let mut found: BTreeMap<String, Vec<u64>> = BTreeMap::new();
    let mut listed = objects.list(Some(below));
    while let Some(meta) = listed.next().await {
        let meta = meta.map_err(|error| StoreError::from_object("list the catalogue", error))?;
        let parts: Vec<_> = meta.location.parts().collect();
        let [_, id, number] = parts.as_slice() else { continue };
        if let Ok(number) = u64::from_str_radix(number.as_ref(), 16) {
            found.entry(id.as_ref().to_owned()).or_default().push(number);
        }
    }
    found.values_mut().for_each(|numbers| numbers.sort_unstable());
    Ok(found)
}

/// Whether the entry of this number speaks of just this session.
async fn is_entry_of(objects: &dyn ObjectStore, place: &SessionPlace, number: u64) -> Result<bool, StoreError> {
    let Some(Found { content: Content::Entry(entry), .. }) = read(objects, &place.id, number).await? else {
        return Ok(false);
    };
    let (CatalogueEntry::Created { place: found, .. }
    | CatalogueEntry::Deleted { place: found }
    | CatalogueEntry::Damaged { place: found }) = entry;
    Ok(found == *place)
}

/// An entry that was read.
struct Found {
    content: Content,
    meta: ObjectMeta,
}

enum Content {
    Entry(CatalogueEntry),
    Purged,
}

/// One entry; `None` if it is not there.
async fn read(objects: &dyn ObjectStore, id: &str, number: u64) -> Result<Option<Found>, StoreError> {
    let io = |error| StoreError::from_object("read a catalogue entry", error);
    let found = match objects.get(&path(id, number)).await {
        Ok(found) => found,
        Err(Error::NotFound { .. }) => return Ok(None),
        Err(error) => return Err(io(error)),
    };
    let meta = found.meta.clone();
    let bytes = match found.bytes().await {
        Ok(bytes) => bytes,
        Err(Error::NotFound { .. }) => return Ok(None),
        Err(error) => return Err(io(error)),
    };
    Ok(Some(Found { content: parse(id, number, &bytes), meta }))
}

fn parse(id: &str, number: u64, bytes: &Bytes) -> Content {
    let place =
        |number, generation: &str| SessionPlace { id: id.to_owned(), number, generation: generation.to_owned() };
    let damaged = Content::Entry(CatalogueEntry::Damaged { place: place(number, "unknown") });
    let Some(end) = bytes.iter().position(|byte| *byte == b'\n') else { return damaged };
    let line = std::str::from_utf8(&bytes[..end]).unwrap_or_default();
    if let Some(generation) = line.strip_prefix(CREATED).filter(|text| check_id(text).is_ok()) {
        let record = bytes.slice(end + 1..);
        return Content::Entry(CatalogueEntry::Created { place: place(number, generation), record });
    }
    if let Some(generation) = line.strip_prefix(DELETED).filter(|text| check_id(text).is_ok() && number > 0) {
        return Content::Entry(CatalogueEntry::Deleted { place: place(number - 1, generation) });
    }
    if line.starts_with(PURGED) { Content::Purged } else { damaged }
}

/// What is gone need not be deleted.
fn unless_missing(deleted: Result<(), Error>) -> Result<(), Error> {
    match deleted {
        Err(Error::NotFound { .. }) => Ok(()),
        outcome => outcome,
    }
}

fn path(id: &str, number: u64) -> Path {
    Path::from_iter([FOLDER, id, &format!("{number:016x}")])
}
