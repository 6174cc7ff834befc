//! The root of the data: which sessions there are, and a store of its own for each.

mod open;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use bytes::Bytes;
use futures::stream::TryStreamExt;
use object_store::path::Path;
use object_store::prefix::PrefixStore;
use object_store::{Error, ObjectStore, ObjectStoreExt, PutPayload};
use tokio::sync::{Mutex, watch};
use tokio::task::AbortHandle;

use crate::cache::{BlobCache, CachedBlobs};
use crate::catalogue::{self, CatalogueEntry, SessionPlace, check_id};
use crate::config::StoreConfig;
use crate::directory::DirectoryLock;
use crate::error::StoreError;
use crate::lease::{self, Claim};
use crate::node::{Node, NodeState};
use crate::observed::Failures;
use crate::reader::SessionReader;
use crate::room::check_room;
use crate::slate::{Place, SlateStore};
use crate::threads::blocking;

/// Objects that are deleted at a time.
const DELETES_AT_ONCE: usize = 64;
/// Name of a session's summary, below its folder.
const SUMMARY: &str = "summary";

/// All data of a server.
///
/// A session is created and deleted by one object each in the catalogue; all else lies in a folder of the
/// session, in a [`SlateStore`] that only one writer at a time can hold. So a damaged session harms no other one,
/// one that sleeps costs nothing, and several processes may share the data.
pub struct DataRoot {
    objects: Arc<dyn ObjectStore>,
    directory: Option<PathBuf>,
    fsync: bool,
    session: StoreConfig,
    cache: Option<Arc<BlobCache>>,
    failures: watch::Receiver<Failures>,
    last_generation: AtomicU64,
    shared: bool,
    /// The catalogue is changed by one at a time.
    changing: Mutex<()>,
    node: Option<(Arc<Node>, AbortOnDrop)>,
    name: String,
    _lock: Option<DirectoryLock>,
}

impl std::fmt::Debug for DataRoot {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("DataRoot").field("directory", &self.directory).finish_non_exhaustive()
    }
}

impl DataRoot {
    /// The newest entry of every id, in the order of ids.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn list(&self) -> Result<Vec<CatalogueEntry>, StoreError> {
        let mut listed = vec![];
        self.for_each(|entry| listed.push(entry)).await?;
        Ok(listed)
    }

    /// Tells the newest entry of every id, in the order of ids, one after the other as they are read.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn for_each(&self, tell: impl FnMut(CatalogueEntry)) -> Result<(), StoreError> {
        catalogue::for_each(self.objects.as_ref(), self.shared, tell).await
    }

    /// The newest entry of one id.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn entry(&self, id: &str) -> Result<Option<CatalogueEntry>, StoreError> {
        check_id(id)?;
        catalogue::newest(self.objects.as_ref(), id).await
    }

    /// Creates a session, durably; `record` is given back by [`DataRoot::list`].
    ///
    /// # Errors
    /// [`StoreError::AlreadyExists`], [`StoreError::InvalidKey`] for an id that cannot be part of a path everywhere,
    /// [`StoreError::Full`], [`StoreError::Io`].
    pub async fn create(&self, id: &str, record: &[u8]) -> Result<SessionPlace, StoreError> {
        let _alone = self.changing.lock().await;
        let mut place = self.reserve(id).await?;
        for _ in 0..catalogue::LOOKS {
            match self.publish(&place, record).await {
                // Whoever purges the session that was there before says so with the number that was free a moment ago.
                Err(StoreError::AlreadyExists { .. }) if catalogue::is_past(self.objects.as_ref(), &place).await? => {
                    place.number = catalogue::free_number(self.objects.as_ref(), id).await?;
                }
                published => return published.map(|()| place),
            }
        }
        Err(StoreError::AlreadyExists { id: id.to_owned() })
    }

    /// Says, durably, that a session is gone. What it stored stays until [`DataRoot::purge`]. Saying it twice is no
    /// error. Where data are shared, only the node that the session belongs to can say it; one that nobody has is
    /// claimed for it.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::Io`]; [`StoreError::Elsewhere`], [`StoreError::NodeSilent`],
    /// [`StoreError::Fenced`].
    pub async fn bury(&self, place: &SessionPlace) -> Result<(), StoreError> {
        let _alone = self.changing.lock().await;
        if let Some((node, _)) = &self.node
            && !lease::condemn(self.objects.as_ref(), node, place).await?
        {
            return Ok(());
        }
        catalogue::bury(self.objects.as_ref(), place).await
    }

    /// Whether a deletion that [`DataRoot::bury`] reported as failed will be carried out all the same, by whoever looks at
    /// the session next. Where that cannot be read it is taken for so if data are shared.
    pub async fn is_decided(&self, place: &SessionPlace) -> bool {
        match &self.node {
            Some(_) => lease::is_condemned(self.objects.as_ref(), place).await.unwrap_or(true),
            None => matches!(
                catalogue::newest(self.objects.as_ref(), place.id()).await,
                Ok(Some(CatalogueEntry::Deleted { place: found })) if found == *place
            ),
        }
    }

    /// Removes all that a buried session stored, then its entries in the catalogue. Can be done again after it broke
    /// off.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn purge(&self, place: &SessionPlace) -> Result<(), StoreError> {
        self.remove_folder(&place.folder()).await?;
        if let Some(cache) = &self.cache {
            cache.clone().delete_folder(folder_on_disk(place)).await;
        }
        let _alone = self.changing.lock().await;
        catalogue::forget(self.objects.as_ref(), place, self.shared).await?;
        if let Some(directory) = self.directory.clone() {
            let id = place.id.clone();
            // Only if nothing is left in them: another session of this id may have come.
            let empty =
                move || ["sessions", "catalogue"].map(|folder| std::fs::remove_dir(directory.join(folder).join(&id)));
            drop(blocking(empty).await?);
        }
        Ok(())
    }

    /// Whether other nodes may have sessions of these data.
    #[must_use]
    pub fn is_shared(&self) -> bool {
        self.shared
    }

    /// The number of the newest entry in the catalogue by id, whatever the entry says.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn newest_numbers(&self) -> Result<BTreeMap<String, u64>, StoreError> {
        catalogue::newest_numbers(self.objects.as_ref()).await
    }

    /// When an id was last added to the catalogue or removed, as the directory's file system tells; `None` where there is
    /// no directory.
    #[must_use]
    pub fn catalogue_changed(&self) -> Option<SystemTime> {
        std::fs::metadata(self.directory.as_ref()?.join(catalogue::FOLDER)).ok()?.modified().ok()
    }

    /// Takes a session for this node. Where data are not shared it is always ours, and asking costs nothing; else it is
    /// to be asked before [`DataRoot::open_session`]. A claim ends with [`DataRoot::release`], or when
    /// [`DataRoot::watch_node`] tells of another life.
    ///
    /// # Errors
    /// [`StoreError::NodeSilent`], [`StoreError::Full`], [`StoreError::Io`].
    pub async fn claim(&self, place: &SessionPlace) -> Result<Claim, StoreError> {
        match &self.node {
            Some((node, _)) => lease::claim(self.objects.as_ref(), node, place).await,
            None => Ok(Claim::Ours),
        }
    }

    /// The address of another node that has a session now; none where data are not shared.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn holder(&self, place: &SessionPlace) -> Result<Option<String>, StoreError> {
        match &self.node {
            Some((node, _)) => lease::holder(self.objects.as_ref(), node, place).await,
            None => Ok(None),
        }
    }

    /// Gives a session back after its store was closed, so that another node can take it at once.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::Io`].
    pub async fn release(&self, place: &SessionPlace) -> Result<(), StoreError> {
        match &self.node {
            Some((node, _)) => lease::release(self.objects.as_ref(), node, place).await,
            None => Ok(()),
        }
    }

    /// Whether this node can be sure of what it claimed. Once it was not, all claims before are void; always true where
    /// data are not shared.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        self.node.as_ref().is_none_or(|(node, _)| node.life().is_alive())
    }

    /// Tells when this node lost all that it claimed, and when it can claim again; `None` where data are not shared.
    #[must_use]
    pub fn watch_node(&self) -> Option<watch::Receiver<NodeState>> {
        self.node.as_ref().map(|(node, _)| node.watch())
    }

    /// Ends this node's claims, to be called last: the others need not wait for it to be silent. Without it nothing is
    /// lost but that time.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn leave(&self) -> Result<(), StoreError> {
        match &self.node {
            Some((node, beating)) => {
                beating.0.abort();
                node.stop().await
            }
            None => Ok(()),
        }
    }

    /// Opens a session's own store and takes its next epoch.
    ///
    /// # Errors
    /// Those of [`SlateStore::open`].
    pub async fn open_session(&self, place: &SessionPlace) -> Result<SlateStore, StoreError> {
        self.open_folder(&place.folder()).await
    }

    /// Reads a session as it is, without taking it from whoever writes it.
    #[must_use]
    pub fn read_session(&self, place: &SessionPlace) -> SessionReader {
        SessionReader::new(Arc::new(PrefixStore::new(self.objects.clone(), place.folder())))
    }

    /// A place for a session of this id, of which the catalogue says nothing before [`DataRoot::publish`].
    pub(crate) async fn reserve(&self, id: &str) -> Result<SessionPlace, StoreError> {
        check_id(id)?;
        let number = catalogue::free_number(self.objects.as_ref(), id).await?;
        Ok(SessionPlace { id: id.to_owned(), number, generation: self.fresh_generation() })
    }

    /// Says in the catalogue that a session is there.
    pub(crate) async fn publish(&self, place: &SessionPlace, record: &[u8]) -> Result<(), StoreError> {
        catalogue::create(self.objects.as_ref(), place, record).await?;
        if self.shared { catalogue::confirm(self.objects.as_ref(), place).await } else { Ok(()) }
    }

    pub(crate) async fn open_folder(&self, folder: &Path) -> Result<SlateStore, StoreError> {
        let objects = Arc::new(PrefixStore::new(self.objects.clone(), folder.clone()));
        let directory = self.directory.as_ref().filter(|_| self.fsync).map(|root| root.join(folder.as_ref()));
        let life = self.node.as_ref().map(|(node, _)| node.life());
        let cached =
            |cache: &Arc<BlobCache>| CachedBlobs { cache: cache.clone(), folder: PathBuf::from(folder.as_ref()) };
        let cache = self.cache.as_ref().map(cached);
        let disk = self.directory.clone();
        SlateStore::open_at(Place { objects, directory, disk, life, cache }, self.session.clone()).await
    }

    /// What was last noted of a session without waking it; `None` if nothing was.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn summary(&self, place: &SessionPlace) -> Result<Option<Bytes>, StoreError> {
        let io = |error| StoreError::from_object("read a summary", error);
        match self.objects.get(&place.folder().join(SUMMARY)).await {
            Ok(found) => found.bytes().await.map(Some).map_err(io),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(io(error)),
        }
    }

    /// Notes what is to be known of a session while it sleeps. Of two writers the later stands.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::Io`], [`StoreError::NodeSilent`].
    pub async fn set_summary(&self, place: &SessionPlace, summary: Bytes) -> Result<(), StoreError> {
        if !self.is_alive() {
            return Err(StoreError::NodeSilent);
        }
        let written = self.objects.put(&place.folder().join(SUMMARY), PutPayload::from(summary)).await;
        written.map(|_| ()).map_err(|error| StoreError::from_object("write a summary", error))
    }

    /// Bytes that a session has stored.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub async fn stored_bytes(&self, place: &SessionPlace) -> Result<u64, StoreError> {
        let listed = self.objects.list(Some(&place.folder()));
        let sizes = listed.map_err(|error| StoreError::from_object("list a session", error));
        sizes.try_fold(0, |sum, meta| async move { Ok(sum + meta.size) }).await
    }

    /// Tries whether data can be written, and says how that fails: on a disk also if what is free is kept for deletions.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::Io`].
    pub async fn probe(&self) -> Result<(), StoreError> {
        self.directory.as_deref().map_or(Ok(()), check_room)?;
        let written = self.objects.put(&Path::from("PROBE"), PutPayload::from_static(b"percept\n")).await;
        written.map(|_| ()).map_err(|error| StoreError::from_object("write a probe", error))
    }

    /// The directory that the data are in, if they are in one.
    #[must_use]
    pub fn directory(&self) -> Option<&std::path::Path> {
        self.directory.as_deref()
    }

    /// How many writes have failed since the data were opened.
    #[must_use]
    pub fn num_failures(&self) -> u64 {
        self.failures.borrow().count
    }

    pub(crate) fn objects(&self) -> &Arc<dyn ObjectStore> {
        &self.objects
    }

    /// Removes a folder with all that is in it.
    pub(crate) async fn remove_folder(&self, folder: &Path) -> Result<(), StoreError> {
        if let Some(root) = &self.directory {
            let path = root.join(folder.as_ref());
            let removed = blocking(move || std::fs::remove_dir_all(path)).await?;
            return match removed {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    Err(StoreError::from_io("remove a folder", error))
                }
                _ => Ok(()),
            };
        }
        let failed = |error| StoreError::from_object("remove a folder", error);
        self.objects
            .list(Some(folder))
            .map_err(failed)
            .try_for_each_concurrent(DELETES_AT_ONCE, |meta| async move {
                match self.objects.delete(&meta.location).await {
                    Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
                    Err(error) => Err(failed(error)),
                }
            })
            .await
    }

    /// A name that no generation had before: of the time, for the order, and of this process.
    fn fresh_generation(&self) -> String {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let now = u64::try_from(since.as_nanos()).unwrap_or(u64::MAX);
        let advance = |last: u64| Some(now.max(last + 1));
        let last = self.last_generation.fetch_update(Ordering::Relaxed, Ordering::Relaxed, advance).unwrap_or(now);
        format!("{:016x}-{}", now.max(last + 1), self.name)
    }
}

/// Where a session's folder is below a directory.
fn folder_on_disk(place: &SessionPlace) -> PathBuf {
    PathBuf::from(place.folder().as_ref())
}

/// Ends a task with what it belongs to.
struct AbortOnDrop(AbortHandle);

impl Drop for AbortOnDrop {
    fn drop(&mut self) {
        self.0.abort();
    }
}
