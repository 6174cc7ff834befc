//! A whole store as one stream of bytes, and back.
//!
//! Framing, all numbers little-endian:
//!
//! ```text
//! "PERCEPT-STORE\n"  u32 version = 1
//! 'R'  u32 key length   u32 value length   key   value      one record, in the order of the keys
//! 'B'  u64 length       32 bytes SHA-256   bytes            one blob with its content
//! 'L'  u64 length       32 bytes SHA-256                    one blob without its content
//! 'E'  u64 records      u64 blobs          32 bytes SHA-256 of everything before this 'E'
//! ```
//!
//! The records are those of one moment; the blobs are those found after it, so that every blob that a
//! record names is among them, unless garbage was collected meanwhile.

use bytes::Bytes;
use futures::TryStreamExt;
use sha2::{Digest, Sha256};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

use crate::blobs::BlobId;
use crate::error::StoreError;
use crate::keys::{Key, MAX_KEY_BYTES, Prefix};
use crate::store::{Record, Store};

const MAGIC: &[u8] = b"PERCEPT-STORE\n";
const VERSION: u32 = 1;

/// Records are imported in batches of about this size.
const BATCH_BYTES: usize = 1 << 20;

/// Bytes read at once, so that a false length does not allocate.
const READ_BYTES: u64 = 1 << 20;

/// Whether blobs travel with their content.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BlobContent {
    /// Everything; the export stands for itself.
    Included,
    /// Identities and sizes only, for stores whose blobs are copied by other means.
    ListedOnly,
}

/// What an export or import carried.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Carried {
    /// Number of records.
    pub num_records: u64,
    /// Number of blobs, listed ones included.
    pub num_blobs: u64,
    /// Import only: listed blobs that are not in the store.
    pub missing_blobs: Vec<BlobId>,
}

/// Writes all records and blobs of `store`.
///
/// # Errors
/// Those of [`Store::scan`] and [`Store::get_blob`]; [`StoreError::Full`] or [`StoreError::Io`] of the writer.
pub async fn export(
    store: &dyn Store,
    writer: &mut (dyn AsyncWrite + Unpin + Send),
    content: BlobContent,
) -> Result<Carried, StoreError> {
    let mut out = Output { writer, hash: Sha256::new() };
    let mut carried = Carried::default();
    out.write(MAGIC).await?;
    out.write(&VERSION.to_le_bytes()).await?;
    let mut records = store.scan(&Prefix::everything(), None);
    while let Some((key, value)) = records.try_next().await? {
        out.write(b"R").await?;
        out.write(&length(key.as_str().len())).await?;
        out.write(&length(value.len())).await?;
        out.write(key.as_str().as_bytes()).await?;
        out.write(&value).await?;
        carried.num_records += 1;
    }
    let mut blobs = store.blobs();
    while let Some((id, num_bytes)) = blobs.try_next().await? {
        let bytes = match content {
            BlobContent::Included => Some(store.get_blob(id).await?),
            BlobContent::ListedOnly => None,
        };
        let num_bytes = bytes.as_ref().map_or(num_bytes, |bytes| bytes.len() as u64);
        out.write(if bytes.is_some() { b"B" } else { b"L" }).await?;
        out.write(&num_bytes.to_le_bytes()).await?;
        out.write(id.as_bytes()).await?;
        out.write(&bytes.unwrap_or_default()).await?;
        carried.num_blobs += 1;
    }
    let hash: [u8; 32] = out.hash.clone().finalize().into();
    out.write(b"E").await?;
    out.write(&carried.num_records.to_le_bytes()).await?;
    out.write(&carried.num_blobs.to_le_bytes()).await?;
    out.write(&hash).await?;
    out.writer.flush().await.map_err(|error| StoreError::from_io("write the export", error))?;
    Ok(carried)
}

/// Reads an export into an empty `store`.
///
/// An import that failed leaves a part behind: start again with a new directory.
///
/// # Errors
/// [`StoreError::NotEmpty`] before anything is written; [`StoreError::ExportMalformed`],
/// [`StoreError::FormatTooNew`], [`StoreError::BlobCorrupt`]; those of [`Store::put_batch`] and
/// [`Store::put_blob`]; [`StoreError::Io`] of the reader.
pub async fn import(store: &dyn Store, reader: &mut (dyn AsyncRead + Unpin + Send)) -> Result<Carried, StoreError> {
    if store.last(&Prefix::everything()).await?.is_some() {
        return Err(StoreError::NotEmpty);
    }
    let mut input = Input { reader, hash: Sha256::new(), offset: 0 };
    if input.bytes(MAGIC.len() as u64).await? != MAGIC {
        return Err(input.malformed("not an export of percept"));
    }
    let version = input.u32().await?;
    if version != VERSION {
        return Err(StoreError::FormatTooNew { found: version, supported: VERSION });
    }
    let mut carried = Carried::default();
    let mut batch = Batch::default();
    loop {
        let hash: [u8; 32] = input.hash.clone().finalize().into();
        match input.array::<1>().await? {
            [b'R'] => {
                batch.add(store, input.record().await?).await?;
                carried.num_records += 1;
            }
            [tag @ (b'B' | b'L')] => {
                let (num_bytes, id) = (input.u64().await?, BlobId::from_bytes(input.array().await?));
                if tag == b'B' {
                    let bytes = Bytes::from(input.bytes(num_bytes).await?);
                    if store.put_blob(bytes).await? != id {
                        return Err(StoreError::BlobCorrupt { id });
                    }
                } else if !store.blob_exists(id).await? {
                    carried.missing_blobs.push(id);
                }
                carried.num_blobs += 1;
            }
            [b'E'] => {
                let counts = (input.u64().await?, input.u64().await?);
                if counts != (carried.num_records, carried.num_blobs) || input.array::<32>().await? != hash {
                    return Err(input.malformed("counts or checksum do not fit"));
                }
                batch.flush(store).await?;
                return Ok(carried);
            }
            _ => return Err(input.malformed("unknown frame")),
        }
    }
}

/// Lengths of keys and values are bounded far below `u32::MAX` by the store's limits.
fn length(num_bytes: usize) -> [u8; 4] {
    u32::try_from(num_bytes).unwrap_or(u32::MAX).to_le_bytes()
}

#[derive(Default)]
struct Batch {
    records: Vec<Record>,
    num_bytes: usize,
}

impl Batch {
    async fn add(&mut self, store: &dyn Store, record: Record) -> Result<(), StoreError> {
        self.num_bytes += record.0.as_str().len() + record.1.len();
        self.records.push(record);
        if self.num_bytes >= BATCH_BYTES { self.flush(store).await } else { Ok(()) }
    }

    async fn flush(&mut self, store: &dyn Store) -> Result<(), StoreError> {
        self.num_bytes = 0;
        store.put_batch(std::mem::take(&mut self.records), Vec::new()).await
    }
}

struct Output<'a> {
    writer: &'a mut (dyn AsyncWrite + Unpin + Send),
    hash: Sha256,
}

impl Output<'_> {
    async fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.hash.update(bytes);
        self.writer.write_all(bytes).await.map_err(|error| StoreError::from_io("write the export", error))
    }
}

struct Input<'a> {
    reader: &'a mut (dyn AsyncRead + Unpin + Send),
    hash: Sha256,
    offset: u64,
}

impl Input<'_> {
    fn malformed(&self, reason: &'static str) -> StoreError {
        StoreError::ExportMalformed { reason, offset: self.offset }
    }

    async fn record(&mut self) -> Result<Record, StoreError> {
        let (key_length, value_length) = (self.u32().await?, self.u32().await?);
        if key_length as usize > MAX_KEY_BYTES {
            return Err(self.malformed("key too long"));
        }
        let key = self.bytes(u64::from(key_length)).await?;
        let key = String::from_utf8(key).map_err(|_| self.malformed("key is not UTF-8"))?;
        let value = self.bytes(u64::from(value_length)).await?;
        Ok((Key::parse(&key)?, Bytes::from(value)))
    }

    async fn u32(&mut self) -> Result<u32, StoreError> {
        Ok(u32::from_le_bytes(self.array().await?))
    }

    async fn u64(&mut self) -> Result<u64, StoreError> {
        Ok(u64::from_le_bytes(self.array().await?))
    }

    async fn array<const N: usize>(&mut self) -> Result<[u8; N], StoreError> {
        let mut bytes = [0; N];
        let outcome = self.reader.read_exact(&mut bytes).await;
        outcome.map_err(|error| self.explain(error))?;
        self.took(&bytes);
        Ok(bytes)
    }

    async fn bytes(&mut self, num_bytes: u64) -> Result<Vec<u8>, StoreError> {
        let mut bytes = Vec::new();
        while (bytes.len() as u64) < num_bytes {
            let part = READ_BYTES.min(num_bytes - bytes.len() as u64);
            let read = (&mut *self.reader).take(part).read_to_end(&mut bytes).await;
            if read.map_err(|error| self.explain(error))? == 0 {
                return Err(self.malformed("breaks off"));
            }
        }
        self.took(&bytes);
        Ok(bytes)
    }

    fn took(&mut self, bytes: &[u8]) {
        self.hash.update(bytes);
        self.offset += bytes.len() as u64;
    }

    fn explain(&self, error: std::io::Error) -> StoreError {
        match error.kind() {
            std::io::ErrorKind::UnexpectedEof => self.malformed("breaks off"),
            _ => StoreError::from_io("read the export", error),
        }
    }
}
