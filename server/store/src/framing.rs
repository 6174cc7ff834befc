//! The frames of which an export consists; see [`crate::archive`].

use bytes::Bytes;
use sha2::{Digest, Sha256};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

use crate::blob_id::BlobId;
use crate::error::StoreError;
use crate::keys::{Key, MAX_KEY_BYTES};
use crate::store::{Record, Store};

pub(crate) const MAGIC: &[u8] = b"PERCEPT-STORE\n";

/// Records are imported in batches of about this size.
const BATCH_BYTES: usize = 1 << 20;

/// Bytes read at once, so that a false length does not allocate.
const READ_BYTES: u64 = 1 << 20;

/// Lengths of keys and values are bounded far below `u32::MAX` by the store's limits.
pub(crate) fn length(num_bytes: usize) -> [u8; 4] {
    u32::try_from(num_bytes).unwrap_or(u32::MAX).to_le_bytes()
}

/// Records on their way into a store.
#[derive(Default)]
pub(crate) struct Batch {
    records: Vec<Record>,
    num_bytes: usize,
}

impl Batch {
    pub(crate) async fn add(&mut self, store: &dyn Store, record: Record) -> Result<(), StoreError> {
        self.num_bytes += record.0.as_str().len() + record.1.len();
        self.records.push(record);
        if self.num_bytes >= BATCH_BYTES { self.flush(store).await } else { Ok(()) }
    }

    pub(crate) async fn flush(&mut self, store: &dyn Store) -> Result<(), StoreError> {
        self.num_bytes = 0;
        store.put_batch(std::mem::take(&mut self.records), Vec::new()).await
    }
}

/// What is written, and the hash of it.
pub(crate) struct Output<'a> {
    pub(crate) writer: &'a mut (dyn AsyncWrite + Unpin + Send),
    hash: Sha256,
}

impl<'a> Output<'a> {
    pub(crate) fn new(writer: &'a mut (dyn AsyncWrite + Unpin + Send)) -> Self {
        Self { writer, hash: Sha256::new() }
    }

    pub(crate) fn hash(&self) -> [u8; 32] {
        self.hash.clone().finalize().into()
    }

    pub(crate) async fn record(&mut self, key: &Key, value: &[u8]) -> Result<(), StoreError> {
        self.write(b"R").await?;
        self.write(&length(key.as_str().len())).await?;
        self.write(&length(value.len())).await?;
        self.write(key.as_str().as_bytes()).await?;
        self.write(value).await
    }

    pub(crate) async fn blob(&mut self, id: BlobId, bytes: &[u8]) -> Result<(), StoreError> {
        self.write(b"B").await?;
        self.write(&(bytes.len() as u64).to_le_bytes()).await?;
        self.write(id.as_bytes()).await?;
        self.write(bytes).await
    }

    pub(crate) async fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.hash.update(bytes);
        self.writer.write_all(bytes).await.map_err(|error| StoreError::from_io("write the export", error))
    }
}

/// What is read, and the hash of it.
pub(crate) struct Input<'a> {
    reader: &'a mut (dyn AsyncRead + Unpin + Send),
    hash: Sha256,
    offset: u64,
}

impl<'a> Input<'a> {
    pub(crate) fn new(reader: &'a mut (dyn AsyncRead + Unpin + Send)) -> Self {
        Self { reader, hash: Sha256::new(), offset: 0 }
    }

    pub(crate) fn hash(&self) -> [u8; 32] {
        self.hash.clone().finalize().into()
    }

    /// An id and what comes with it, after both their lengths.
    pub(crate) async fn text_and_bytes(&mut self, max_bytes: u64) -> Result<(String, Bytes), StoreError> {
        let (text_length, num_bytes) = (self.u32().await?, self.u32().await?);
        if text_length as usize > MAX_KEY_BYTES || u64::from(num_bytes) > max_bytes {
            return Err(self.malformed("id or record too long"));
        }
        let text = String::from_utf8(self.bytes(u64::from(text_length)).await?);
        let text = text.map_err(|_| self.malformed("id is not UTF-8"))?;
        Ok((text, Bytes::from(self.bytes(u64::from(num_bytes)).await?)))
    }

    pub(crate) async fn blob(&mut self) -> Result<(BlobId, Bytes), StoreError> {
        let (num_bytes, id) = (self.u64().await?, BlobId::from_bytes(self.array().await?));
        Ok((id, Bytes::from(self.bytes(num_bytes).await?)))
    }

    pub(crate) fn malformed(&self, reason: &'static str) -> StoreError {
        StoreError::ExportMalformed { reason, offset: self.offset }
    }

    pub(crate) async fn record(&mut self) -> Result<Record, StoreError> {
        let (key_length, value_length) = (self.u32().await?, self.u32().await?);
        if key_length as usize > MAX_KEY_BYTES {
            return Err(self.malformed("key too long"));
        }
        let key = self.bytes(u64::from(key_length)).await?;
        let key = String::from_utf8(key).map_err(|_| self.malformed("key is not UTF-8"))?;
        let value = self.bytes(u64::from(value_length)).await?;
        Ok((Key::parse(&key)?, Bytes::from(value)))
    }

    pub(crate) async fn u32(&mut self) -> Result<u32, StoreError> {
        Ok(u32::from_le_bytes(self.array().await?))
    }

    pub(crate) async fn u64(&mut self) -> Result<u64, StoreError> {
        Ok(u64::from_le_bytes(self.array().await?))
    }

    pub(crate) async fn array<const N: usize>(&mut self) -> Result<[u8; N], StoreError> {
        let mut bytes = [0; N];
        let outcome = self.reader.read_exact(&mut bytes).await;
        outcome.map_err(|error| self.explain(error))?;
        self.took(&bytes);
        Ok(bytes)
    }

    pub(crate) async fn bytes(&mut self, num_bytes: u64) -> Result<Vec<u8>, StoreError> {
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
