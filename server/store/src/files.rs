//! Files of tenants that belong to no session: created whole, never changed, deleted whole.
//!
//! `files/<kind>/<tenant in hexadecimal>/<name>`: a line with the SHA-256 of what follows, then the bytes. Creating is one
//! atomic step on every object store, so that of two writers one alone succeeds, whichever server they are at.

use std::sync::Arc;

use bytes::Bytes;
use futures::stream::TryStreamExt;
use object_store::path::Path;
use object_store::{Error, ObjectStoreExt, PutMode, PutOptions, PutPayload};

use crate::blob_id::BlobId;
use crate::catalogue::check_id;
use crate::error::{StoreError, shortened};
use crate::root::DataRoot;
use crate::threads::blocking;

/// Folder of all of them.
const FOLDER: &str = "files";
/// Kind of learned detectors that callers have uploaded.
pub const DETECTORS: &str = "detectors";
/// First word of a file.
const MAGIC: &str = "percept-file ";
/// Bytes of the first line: the word, 64 digits, a line feed.
const HEAD: usize = MAGIC.len() + 64 + 1;
/// The longest name of a tenant, bytes: its digits are part of a path.
const MAX_TENANT_BYTES: usize = 120;

/// Which file.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FilePlace {
    /// Whose it is.
    pub tenant: String,
    /// What it is called there: 1 to 256 characters of a-z A-Z 0-9 _ -.
    pub name: String,
}

impl DataRoot {
    /// The files of a kind, those of all tenants, by tenant and name; foreign names are passed over.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn list_files(&self, kind: &str) -> Result<Vec<FilePlace>, StoreError> {
        check_id(kind)?;
        let folder = Path::from_iter([FOLDER, kind]);
        let place = |location: &Path| {
            let parts: Vec<_> = location.parts().collect();
            let [_, _, tenant, name] = parts.as_slice() else { return None };
            check_id(name.as_ref()).ok()?;
            Some(FilePlace { tenant: from_hex(tenant.as_ref())?, name: name.as_ref().to_owned() })
        };
        let listed = self.objects().list(Some(&folder)).try_collect::<Vec<_>>().await;
        let listed = listed.map_err(|error| StoreError::from_object("list files", error))?;
        let mut found: Vec<FilePlace> = listed.iter().filter_map(|meta| place(&meta.location)).collect();
        found.sort();
        Ok(found)
    }

    /// Stores a file, durably.
    ///
    /// # Errors
    /// [`StoreError::AlreadyExists`], [`StoreError::InvalidKey`], [`StoreError::Full`], [`StoreError::Io`].
    pub async fn create_file(&self, kind: &str, place: &FilePlace, bytes: Bytes) -> Result<(), StoreError> {
        let path = path(kind, place)?;
        let whole = blocking(move || {
            let mut whole = format!("{MAGIC}{}\n", BlobId::of(&bytes)).into_bytes();
            whole.extend_from_slice(&bytes);
            whole
        });
        let payload = PutPayload::from(whole.await?);
        match self.objects().put_opts(&path, payload, PutOptions::from(PutMode::Create)).await {
            Ok(_) => Ok(()),
            Err(Error::AlreadyExists { .. }) => Err(StoreError::AlreadyExists { id: place.name.clone() }),
            Err(error) => Err(StoreError::from_object("write a file", error)),
        }
    }

    /// A file; none if it is not there.
    ///
    /// # Errors
    /// [`StoreError::InvalidKey`], [`StoreError::Io`]; [`StoreError::Corrupt`] if it is not what was stored.
    pub async fn read_file(&self, kind: &str, place: &FilePlace) -> Result<Option<Bytes>, StoreError> {
        let io = |error| StoreError::from_object("read a file", error);
        let bytes = match self.objects().get(&path(kind, place)?).await {
            Ok(found) => found.bytes().await.map_err(io)?,
            Err(Error::NotFound { .. }) => return Ok(None),
            Err(error) => return Err(io(error)),
        };
        let content = blocking(move || {
            let head = bytes.get(..HEAD).and_then(|head| std::str::from_utf8(head).ok())?;
            let id: BlobId = head.strip_prefix(MAGIC)?.strip_suffix('\n')?.parse().ok()?;
            let content = bytes.slice(HEAD..);
            (BlobId::of(&content) == id).then_some(content)
        });
        let damaged = || StoreError::Corrupt {
            operation: "read a file",
            source: Arc::from(Box::<dyn std::error::Error + Send + Sync>::from("its digest is another's")),
        };
        content.await?.ok_or_else(damaged).map(Some)
    }

    /// Removes a file, durably; whether it was there.
    ///
    /// # Errors
    /// [`StoreError::InvalidKey`], [`StoreError::Io`].
    pub async fn delete_file(&self, kind: &str, place: &FilePlace) -> Result<bool, StoreError> {
        let path = path(kind, place)?;
        let io = |error| StoreError::from_object("delete a file", error);
        // Some object stores delete what is not there without a word.
        match self.objects().head(&path).await {
            Ok(_) => {}
            Err(Error::NotFound { .. }) => return Ok(false),
            Err(error) => return Err(io(error)),
        }
        match self.objects().delete(&path).await {
            Ok(()) => Ok(true),
            Err(Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(io(error)),
        }
    }

    /// Copies the files of a kind that `to` does not have; how many.
    ///
    /// # Errors
    /// Those of reading here and of writing there.
    pub(crate) async fn copy_files(&self, kind: &str, to: &Self) -> Result<u64, StoreError> {
        let there = to.list_files(kind).await?;
        let mut num_copied = 0;
        for place in self.list_files(kind).await?.iter().filter(|place| !there.contains(place)) {
            // One that was deleted since it was listed is left out.
            let Some(bytes) = self.read_file(kind, place).await? else { continue };
            to.create_file(kind, place, bytes).await?;
            num_copied += 1;
        }
        Ok(num_copied)
    }
}

fn path(kind: &str, place: &FilePlace) -> Result<Path, StoreError> {
    check_id(kind)?;
    check_id(&place.name)?;
    if !(1..=MAX_TENANT_BYTES).contains(&place.tenant.len()) {
        let requirement = "a tenant of 1 to 120 bytes";
        return Err(StoreError::InvalidKey { segment: shortened(&place.tenant), requirement });
    }
    let tenant: String = place.tenant.bytes().map(|byte| format!("{byte:02x}")).collect();
    Ok(Path::from_iter([FOLDER, kind, &tenant, &place.name]))
}

fn from_hex(digits: &str) -> Option<String> {
    let byte = |i: usize| u8::from_str_radix(digits.get(i..i + 2)?, 16).ok();
    let bytes: Option<Vec<u8>> = (0..digits.len()).step_by(2).map(byte).collect();
    String::from_utf8(bytes?).ok().filter(|tenant| !tenant.is_empty())
}
