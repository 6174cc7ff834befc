//! The number that says how the data are laid out, in an object of its own: readable before anything is
//! opened, so that data of a newer version are left untouched.
//!
//! - 1: one database for all sessions in `records/`, blobs of all in `blobs/<two hex digits>/`.
//! - 2: `catalogue/` says which sessions there are, `sessions/<id>/<generation>/` holds all that one has.

use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload};

use crate::error::{StoreError, shortened};

/// The layout that this version writes, and the newest that it reads.
pub(crate) const CURRENT: u32 = 2;

const NAME: &str = "FORMAT";
const TITLE: &str = "percept-store ";

/// The number of the data as they are; new data get the current one.
pub(crate) async fn read_or_create(objects: &dyn ObjectStore) -> Result<u32, StoreError> {
    match write(objects, PutMode::Create).await {
        Ok(()) => Ok(CURRENT),
        Err(object_store::Error::AlreadyExists { .. }) => read(objects).await,
        Err(error) => Err(StoreError::from_object("write FORMAT", error)),
    }
}

/// Says that the data are of the current format now.
pub(crate) async fn set_current(objects: &dyn ObjectStore) -> Result<(), StoreError> {
    write(objects, PutMode::Overwrite).await.map_err(|error| StoreError::from_object("write FORMAT", error))
}

async fn write(objects: &dyn ObjectStore, mode: PutMode) -> Result<(), object_store::Error> {
    let line = PutPayload::from(format!("{TITLE}{CURRENT}\n"));
    objects.put_opts(&Path::from(NAME), line, PutOptions::from(mode)).await.map(|_| ())
}

/// The number of data that are there.
pub(crate) async fn read(objects: &dyn ObjectStore) -> Result<u32, StoreError> {
    let io = |error| match error {
        object_store::Error::NotFound { .. } => StoreError::NoData,
        error => StoreError::from_object("read FORMAT", error),
    };
    let bytes = objects.get(&Path::from(NAME)).await.map_err(io)?.bytes().await.map_err(io)?;
    let text = String::from_utf8_lossy(&bytes);
    match text.strip_prefix(TITLE).and_then(|rest| rest.trim_end().parse::<u32>().ok()) {
        Some(found) if (1..=CURRENT).contains(&found) => Ok(found),
        Some(found) if found > CURRENT => Err(StoreError::FormatTooNew { found, supported: CURRENT }),
        _ => Err(StoreError::FormatUnreadable { text: shortened(&text) }),
    }
}
