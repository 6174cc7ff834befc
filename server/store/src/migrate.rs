//! Brings data of older formats to the current one. Breaking off anywhere leaves the old data whole.

use bytes::Bytes;
use object_store::ObjectStoreExt;
use object_store::path::Path;

use crate::blobs;
use crate::catalogue::{self, CatalogueEntry, SessionPlace, check_id};
use crate::error::StoreError;
use crate::format;
use crate::keys::{Key, Prefix};
use crate::root::DataRoot;
use crate::slate::RECORDS;
use crate::store::{Record, Store};

/// Generation of sessions that were made before there were generations.
const GENERATION: &str = "0000000000000001";
/// Records are copied in batches of about this size.
const BATCH_BYTES: usize = 4 << 20;

/// Format 1 had one database for all sessions and shared their blobs: every session gets its own.
pub(crate) async fn from_1(root: &DataRoot) -> Result<(), StoreError> {
    let old = root.open_folder(&Path::default()).await?;
    let catalogue = old.scan_all(&Prefix::new(["catalog"])?).await?;
    tracing::info!(sessions = catalogue.len(), "bringing data of format 1 to format {}", format::CURRENT);
    for (key, record) in &catalogue {
        let id = key.segments().nth(1).unwrap_or_default();
        if check_id(id).is_err() {
            tracing::warn!(id, "left out a session whose id cannot be part of a path");
            continue;
        }
        copy(root, &old, id, record).await?;
    }
    old.close().await?;
    format::set_current(root.objects().as_ref()).await
}

async fn copy(root: &DataRoot, old: &dyn Store, id: &str, record: &Bytes) -> Result<(), StoreError> {
    let place = SessionPlace { id: id.to_owned(), number: 0, generation: GENERATION.to_owned() };
    if let Some(CatalogueEntry::Created { .. }) = catalogue::newest(root.objects().as_ref(), id).await? {
        return Ok(());
    }
    root.remove_folder(&place.folder()).await?;
    let records = old.scan_all(&Prefix::new(["sessions", id])?).await?;
    for (_, value) in &records {
        for blob in named_blobs(value) {
            let from = Path::from(format!("{}/{}/{blob}", blobs::FOLDER, &blob[..2]));
            let to = place.folder().join(blobs::FOLDER).join(blob.as_str());
            match root.objects().copy(&from, &to).await {
                Ok(()) => {}
                // The session was damaged before; it will say so itself.
                Err(object_store::Error::NotFound { .. }) => tracing::warn!(id, blob, "a scan is missing"),
                Err(error) => return Err(StoreError::from_object("copy a blob", error)),
            }
        }
    }
    if !records.is_empty() {
        let new = root.open_session(&place).await?;
        let mut batch: Vec<Record> = Vec::new();
        let mut size = 0;
        for (key, value) in records {
            size += value.len();
            batch.push((Key::new(key.segments().skip(2))?, value));
            if size >= BATCH_BYTES {
                new.put_batch(std::mem::take(&mut batch), Vec::new()).await?;
                size = 0;
            }
        }
        new.put_batch(batch, Vec::new()).await?;
        new.close().await?;
    }
    catalogue::create(root.objects().as_ref(), &place, record).await
}

/// The blobs that a keyframe's record of format 1 names: `"blob":"<64 hexadecimal digits>"`.
fn named_blobs(record: &[u8]) -> Vec<String> {
    let text = String::from_utf8_lossy(record);
    let named = text.split("\"blob\":\"").skip(1);
    let ids = named.filter_map(|rest| rest.get(..64).map(str::to_owned));
    ids.filter(|id| id.parse::<crate::BlobId>().is_ok()).collect()
}

/// Removes what the current format has no place for: the rest of a migration.
pub(crate) async fn clear_old(root: &DataRoot) -> Result<(), StoreError> {
    for folder in [RECORDS, blobs::FOLDER] {
        root.remove_folder(&Path::from(folder)).await?;
    }
    Ok(())
}
