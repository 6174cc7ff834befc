//! Files of tenants: there until they are deleted, each tenant's its own, never half.

use bytes::Bytes;
use percept_store::{DataRoot, FilePlace, RootConfig, StoreError};

fn place(tenant: &str, name: &str) -> FilePlace {
    FilePlace { tenant: tenant.to_owned(), name: name.to_owned() }
}

#[tokio::test]
async fn a_file_outlives_the_process_and_is_its_tenants_alone() {
    let directory = tempfile::tempdir().unwrap();
    let config = RootConfig::directory(directory.path());
    let (a, b) = (place("north/ä", "cars"), place("south", "cars"));
    let root = DataRoot::open(config.clone()).await.unwrap();
    assert_eq!(root.list_files("detectors").await.unwrap(), []);
    root.create_file("detectors", &a, Bytes::from_static(b"first")).await.unwrap();
    let again = root.create_file("detectors", &a, Bytes::from_static(b"second")).await;
    assert!(matches!(again, Err(StoreError::AlreadyExists { id }) if id == "cars"));
    root.create_file("detectors", &b, Bytes::from_static(b"other")).await.unwrap();
    drop(root);

    let root = DataRoot::open(config).await.unwrap();
    assert_eq!(root.list_files("detectors").await.unwrap(), [a.clone(), b.clone()]);
    assert_eq!(root.read_file("detectors", &a).await.unwrap().unwrap(), "first");
    assert!(root.delete_file("detectors", &a).await.unwrap());
    assert!(!root.delete_file("detectors", &a).await.unwrap());
    assert_eq!(root.read_file("detectors", &a).await.unwrap(), None);
    assert_eq!(root.read_file("detectors", &b).await.unwrap().unwrap(), "other");
}

#[tokio::test]
async fn a_file_that_was_changed_on_the_disk_is_told_apart() {
    let directory = tempfile::tempdir().unwrap();
    let root = DataRoot::open(RootConfig::directory(directory.path())).await.unwrap();
    let place = place("a", "model");
    root.create_file("detectors", &place, Bytes::from_static(b"weights")).await.unwrap();
    let path = directory.path().join("files/detectors/61/model");
    let mut bytes = std::fs::read(&path).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    assert!(matches!(root.read_file("detectors", &place).await, Err(StoreError::Corrupt { .. })));
    std::fs::write(&path, b"percept-file ").unwrap();
    assert!(matches!(root.read_file("detectors", &place).await, Err(StoreError::Corrupt { .. })));
}

#[tokio::test]
async fn names_that_are_no_part_of_a_path_are_refused() {
    let root = DataRoot::open(RootConfig::in_memory()).await.unwrap();
    for bad in ["", "..", "a/b", "a b"] {
        let refused = root.create_file("detectors", &place("a", bad), Bytes::new()).await;
        assert!(matches!(refused, Err(StoreError::InvalidKey { .. })), "{bad}");
    }
    assert!(matches!(root.read_file("detectors", &place("", "a")).await, Err(StoreError::InvalidKey { .. })));
}
