//! A store over the network. With `PERCEPT_TEST_S3` naming the address of an S3 server that may be written to, e.g.
//! `http://127.0.0.1:9000`; the bucket `percept-test` has to be there.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::future::join_all;
use object_store::{ObjectStore, PutMode, PutOptions, PutPayload};
use percept_store::{Claim, DataRoot, Location, RootConfig, S3Options, Store, StoreError};

use crate::{created, key, value};

/// Data of the test's own, or nothing if there is no server.
fn config(name: &str) -> Option<RootConfig> {
    let Ok(endpoint) = std::env::var("PERCEPT_TEST_S3") else {
        println!("skipped: PERCEPT_TEST_S3 names no S3 server");
        return None;
    };
    let options = S3Options { endpoint: Some(endpoint), allow_http: true, region: None };
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos();
    let location = Location::parse(&format!("s3://percept-test/{name}-{now}"), &options).unwrap();
    Some(RootConfig::at(location))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sessions_live_in_a_bucket() {
    let Some(config) = config("life") else { return };
    let root = DataRoot::open(config.clone()).await.unwrap();
    let place = root.create("robot", b"record").await.unwrap();
    assert_eq!(root.claim(&place).await.unwrap(), Claim::Ours);
    let store = root.open_session(&place).await.unwrap();
    let scan = Bytes::from(vec![7; 3 << 20]);
    let blob = store.put_blob(scan.clone()).await.unwrap();
    assert_eq!(store.put_blob(scan.clone()).await.unwrap(), blob);
    for number in 0..20 {
        store.put(key("r").numbered(number).unwrap(), value("x")).await.unwrap();
    }
    store.close().await.unwrap();
    root.set_summary(&place, value("a")).await.unwrap();
    root.set_summary(&place, value("b")).await.unwrap();
    root.release(&place).await.unwrap();
    root.leave().await.unwrap();

    let root = DataRoot::open(config).await.unwrap();
    assert_eq!(created(&root, "robot").await.unwrap(), (place.clone(), value("record")));
    assert_eq!(root.summary(&place).await.unwrap(), Some(value("b")));
    assert_eq!(root.claim(&place).await.unwrap(), Claim::Ours);
    let store = root.open_session(&place).await.unwrap();
    assert_eq!(store.scan_all(&key("r").prefix()).await.unwrap().len(), 20);
    assert_eq!(store.get_blob(blob).await.unwrap(), scan);
    store.close().await.unwrap();
    root.bury(&place).await.unwrap();
    root.purge(&place).await.unwrap();
    assert!(root.list().await.unwrap().is_empty());
    let again = root.create("robot", b"").await.unwrap();
    assert_ne!(again.generation(), place.generation());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn of_sixteen_that_create_one_id_in_a_bucket_one_wins() {
    let Some(config) = config("race") else { return };
    let roots = join_all((0..16).map(|_| DataRoot::open(config.clone()))).await;
    let roots: Vec<_> = roots.into_iter().map(Result::unwrap).collect();
    for round in 0..10 {
        let id = format!("robot-{round}");
        let outcomes = join_all(roots.iter().map(|root| root.create(&id, b""))).await;
        assert_eq!(outcomes.iter().filter(|outcome| outcome.is_ok()).count(), 1);
        let place = created(&roots[0], &id).await.unwrap().0;
        let claims = join_all(roots.iter().map(|root| root.claim(&place))).await;
        let ours = claims.iter().filter(|claim| matches!(claim, Ok(Claim::Ours)));
        assert_eq!(ours.count(), 1, "{claims:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_silent_nodes_session_in_a_bucket_is_anothers_and_the_old_one_is_fenced() {
    let Some(config) = config("fence") else { return };
    let a = DataRoot::open(RootConfig { address: "a:1".to_owned(), ..config.clone() }).await.unwrap();
    let b = DataRoot::open(RootConfig { address: "b:1".to_owned(), ..config }).await.unwrap();
    let place = a.create("robot", b"").await.unwrap();
    assert_eq!(a.claim(&place).await.unwrap(), Claim::Ours);
    let old = a.open_session(&place).await.unwrap();
    old.put(key("a"), value("1")).await.unwrap();
    assert_eq!(b.claim(&place).await.unwrap(), Claim::Elsewhere { address: "a:1".to_owned() });
    // Its heart stops, its writers do not know.
    drop(a);
    let start = Instant::now();
    while b.claim(&place).await.unwrap() != Claim::Ours {
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    println!("taken over after {:?}", start.elapsed());
    assert!(matches!(old.put(key("a"), value("2")).await, Err(StoreError::Fenced { .. })));
    let new = b.open_session(&place).await.unwrap();
    assert_eq!(new.get(&key("a")).await.unwrap(), Some(value("1")));
    assert!(matches!(old.put(key("a"), value("3")).await, Err(StoreError::Fenced { .. })));
    new.put(key("a"), value("4")).await.unwrap();
}

/// Objects where creating overwrites, as some S3 servers have it.
#[tokio::test]
async fn a_store_that_lets_two_create_one_object_is_refused() {
    let objects = Arc::new(Careless::default());
    let error = DataRoot::open(RootConfig::at(Location::Bucket(objects))).await.unwrap_err();
    assert!(matches!(error, StoreError::CreateNotAtomic { num_won: 2.., num_writers: 16 }), "{error}");
    let honest: Arc<dyn ObjectStore> = Arc::new(object_store::memory::InMemory::new());
    let config = RootConfig::at(Location::Bucket(honest.clone()));
    assert!(config.shared);
    DataRoot::open(config.clone()).await.unwrap();
    DataRoot::open(config).await.unwrap();
    // What it left says only that it was passed.
    let left = honest.list_with_delimiter(None).await.unwrap();
    assert_eq!(left.common_prefixes, ["nodes".into()]);
}

#[derive(Debug, Default)]
struct Careless(object_store::memory::InMemory);

impl std::fmt::Display for Careless {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "Careless")
    }
}

#[async_trait::async_trait]
impl ObjectStore for Careless {
    async fn put_opts(
        &self,
        location: &object_store::path::Path,
        payload: PutPayload,
        options: PutOptions,
    ) -> object_store::Result<object_store::PutResult> {
        self.0.put_opts(location, payload, PutOptions { mode: PutMode::Overwrite, ..options }).await
    }

    async fn put_multipart_opts(
        &self,
        location: &object_store::path::Path,
        options: object_store::PutMultipartOptions,
    ) -> object_store::Result<Box<dyn object_store::MultipartUpload>> {
        self.0.put_multipart_opts(location, options).await
    }

    async fn get_opts(
        &self,
        location: &object_store::path::Path,
        options: object_store::GetOptions,
    ) -> object_store::Result<object_store::GetResult> {
        self.0.get_opts(location, options).await
    }

    fn delete_stream(
        &self,
        locations: futures::stream::BoxStream<'static, object_store::Result<object_store::path::Path>>,
    ) -> futures::stream::BoxStream<'static, object_store::Result<object_store::path::Path>> {
        self.0.delete_stream(locations)
    }

    fn list(
        &self,
        prefix: Option<&object_store::path::Path>,
    ) -> futures::stream::BoxStream<'static, object_store::Result<object_store::ObjectMeta>> {
        self.0.list(prefix)
    }

    async fn list_with_delimiter(
        &self,
        prefix: Option<&object_store::path::Path>,
    ) -> object_store::Result<object_store::ListResult> {
        self.0.list_with_delimiter(prefix).await
    }

    async fn copy_opts(
        &self,
        from: &object_store::path::Path,
        to: &object_store::path::Path,
        options: object_store::CopyOptions,
    ) -> object_store::Result<()> {
        self.0.copy_opts(from, to, options).await
    }
}
