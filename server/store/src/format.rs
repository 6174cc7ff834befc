//! The number that says how the data are laid out, in an object of its own: readable before anything is
//! opened, so that data of a newer version are left untouched.

use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload};

use crate::error::{StoreError, shortened};

/// The layout that this version writes, and the newest that it reads.
pub(crate) const SUPPORTED: u32 = 1;

const NAME: &str = "FORMAT";
const TITLE: &str = "percept-store ";

/// Checks the number, or writes it into new data.
pub(crate) async fn check_or_create(objects: &dyn ObjectStore) -> Result<(), StoreError> {
    let path = Path::from(NAME);
    let line = PutPayload::from(format!("{TITLE}{SUPPORTED}\n"));
    match objects.put_opts(&path, line, PutOptions::from(PutMode::Create)).await {
        Ok(_) => Ok(()),
        Err(object_store::Error::AlreadyExists { .. }) => check(objects, &path).await,
        Err(error) => Err(StoreError::from_object("write FORMAT", error)),
    }
}

async fn check(objects: &dyn ObjectStore, path: &Path) -> Result<(), StoreError> {
    let io = |error| StoreError::from_object("read FORMAT", error);
    let bytes = objects.get(path).await.map_err(io)?.bytes().await.map_err(io)?;
    let text = String::from_utf8_lossy(&bytes);
    match text.strip_prefix(TITLE).and_then(|rest| rest.trim_end().parse::<u32>().ok()) {
        Some(found) if (1..=SUPPORTED).contains(&found) => Ok(()),
        Some(found) if found > SUPPORTED => Err(StoreError::FormatTooNew { found, supported: SUPPORTED }),
        _ => Err(StoreError::FormatUnreadable { text: shortened(&text) }),
    }
}
