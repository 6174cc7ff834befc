//! Objects in memory that fail, hang and break off when the test says so.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use futures::stream::{BoxStream, StreamExt};
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore, ObjectStoreExt,
    PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use tokio::sync::Notify;

use crate::Random;

/// What happens to writes; deletions and copies are writes, too.
#[derive(Debug, Clone)]
pub(crate) enum Plan {
    /// All goes well.
    Well,
    /// No space is left.
    Full,
    /// Every write fails.
    Broken,
    /// Writes wait until the plan is another one.
    Hanging,
    /// Write number `write` never returns, nor does any later one; [`Faulty::cut`] hears of it.
    CutAt {
        /// Counted from 0.
        write: u64,
        /// Whether it was done all the same.
        applied: bool,
    },
    /// Writes fail after so many bytes, for want of space.
    FullAfter {
        /// Bytes of payload left.
        bytes: u64,
    },
    /// Of a hundred writes so many fail, are done but answered with an error, or take longer than a commit waits; of a
    /// hundred reads a quarter of that many fail.
    Random {
        /// Chooses.
        random: Random,
        /// Of a hundred.
        percent: u64,
    },
}

/// What a write has to do.
enum Verdict {
    Go,
    Fail(std::io::ErrorKind),
    DoAndFail,
    Wait(Duration),
    Never { applied: bool },
}

#[derive(Debug)]
struct State {
    plan: Mutex<Plan>,
    num_writes: AtomicU64,
    cut: Notify,
}

/// The objects; a clone shares them.
#[derive(Debug, Clone)]
pub(crate) struct Faulty {
    inner: Arc<InMemory>,
    state: Arc<State>,
}

impl Faulty {
    pub(crate) fn new() -> Self {
        Self::over(Arc::new(InMemory::new()))
    }

    /// With plans of its own over objects that are there.
    pub(crate) fn over(inner: Arc<InMemory>) -> Self {
        let state = State { plan: Mutex::new(Plan::Well), num_writes: AtomicU64::new(0), cut: Notify::new() };
        Self { inner, state: Arc::new(state) }
    }

    /// The objects themselves.
    pub(crate) fn inner(&self) -> Arc<InMemory> {
        self.inner.clone()
    }

    pub(crate) fn set(&self, plan: Plan) {
        *self.state.plan.lock().unwrap() = plan;
    }

    /// Writes so far.
    pub(crate) fn num_writes(&self) -> u64 {
        self.state.num_writes.load(Ordering::SeqCst)
    }

    /// Returns when the write of [`Plan::CutAt`] was reached.
    pub(crate) async fn cut(&self) {
        self.state.cut.notified().await;
    }

    fn judge(&self, num_bytes: u64) -> Verdict {
        let number = self.state.num_writes.fetch_add(1, Ordering::SeqCst);
        match &mut *self.state.plan.lock().unwrap() {
            Plan::Well => Verdict::Go,
            Plan::Full => Verdict::Fail(std::io::ErrorKind::StorageFull),
            Plan::Broken => Verdict::Fail(std::io::ErrorKind::Other),
            Plan::Hanging => Verdict::Wait(Duration::from_millis(5)),
            Plan::CutAt { write, .. } if number < *write => Verdict::Go,
            Plan::CutAt { write, applied } => Verdict::Never { applied: *applied && number == *write },
            Plan::FullAfter { bytes } if *bytes < num_bytes => Verdict::Fail(std::io::ErrorKind::StorageFull),
            Plan::FullAfter { bytes } => {
                *bytes -= num_bytes;
                Verdict::Go
            }
            Plan::Random { random, percent } => match (random.below(100) < *percent, random.below(4)) {
                (false, _) => Verdict::Go,
                (true, 0) => Verdict::DoAndFail,
                (true, 1) => Verdict::Wait(Duration::from_secs(1)),
                (true, _) => Verdict::Fail(std::io::ErrorKind::Other),
            },
        }
    }

    async fn write<T>(&self, num_bytes: u64, work: impl Future<Output = Result<T>> + Send) -> Result<T> {
        match self.judge(num_bytes) {
            Verdict::Go => work.await,
            Verdict::Fail(kind) => Err(failure(kind)),
            Verdict::DoAndFail => {
                work.await?;
                Err(failure(std::io::ErrorKind::Other))
            }
            Verdict::Never { applied } => {
                if applied {
                    work.await?;
                }
                self.state.cut.notify_one();
                std::future::pending().await
            }
            Verdict::Wait(time) => {
                tokio::time::sleep(time).await;
                while matches!(&*self.state.plan.lock().unwrap(), Plan::Hanging) {
                    tokio::time::sleep(time).await;
                }
                work.await
            }
        }
    }

    fn read(&self) -> Result<()> {
        let mut plan = self.state.plan.lock().unwrap();
        if let Plan::Random { random, percent } = &mut *plan
            && random.below(400) < *percent
        {
            return Err(failure(std::io::ErrorKind::Other));
        }
        Ok(())
    }
}

fn failure(kind: std::io::ErrorKind) -> Error {
    Error::Generic { store: "faulty", source: Box::new(std::io::Error::from(kind)) }
}

impl std::fmt::Display for Faulty {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "Faulty")
    }
}

#[async_trait]
impl ObjectStore for Faulty {
    async fn put_opts(&self, location: &Path, payload: PutPayload, options: PutOptions) -> Result<PutResult> {
        let num_bytes = payload.content_length() as u64;
        self.write(num_bytes, self.inner.put_opts(location, payload, options)).await
    }

    async fn put_multipart_opts(&self, at: &Path, options: PutMultipartOptions) -> Result<Box<dyn MultipartUpload>> {
        self.write(0, self.inner.put_multipart_opts(at, options)).await
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        self.read()?;
        self.inner.get_opts(location, options).await
    }

    async fn get_ranges(&self, location: &Path, ranges: &[Range<u64>]) -> Result<Vec<Bytes>> {
        self.read()?;
        self.inner.get_ranges(location, ranges).await
    }

    fn delete_stream(&self, locations: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        let objects = self.clone();
        locations
            .then(move |location| {
                let objects = objects.clone();
                async move {
                    let location = location?;
                    objects.write(0, objects.inner.delete(&location)).await?;
                    Ok(location)
                }
            })
            .boxed()
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.inner.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.inner.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.write(0, self.inner.copy_opts(from, to, options)).await
    }
}
