//! Keys of percept's own making.

use percept_identity::{
    Access, AuthMode, AuthSettings, Authenticator, Credentials, Grant, KeyFile, KeyFileError, NewKey, Pattern,
    Principal, Reason, now_s,
};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

struct Site {
    _dir: tempfile::TempDir,
    file: PathBuf,
}

impl Site {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        Self { file: dir.path().join("keys.json"), _dir: dir }
    }

    fn create(&self, name: &str, expires_s: Option<u64>) -> (String, String) {
        let grants = vec![Grant { access: Access::Write, sessions: Pattern::new("robot-*").unwrap() }];
        let new = NewKey { name: name.to_owned(), tenant: "site-a".to_owned(), grants, expires_s };
        let (record, text) = KeyFile::change(&self.file, |f| f.create(new, now_s())).unwrap();
        (record.id, text)
    }

    fn open(&self) -> Authenticator {
        let keys_file = self.file.display().to_string();
        let settings = AuthSettings { mode: AuthMode::Required, keys_file, ..AuthSettings::default() };
        Authenticator::open(&settings, Arc::new(|| panic!("no keys of a provider are asked for"))).unwrap()
    }
}

async fn known(server: &Authenticator, token: &str) -> Result<Arc<Principal>, Reason> {
    let credentials = Credentials { token: Some(token.to_owned()), certificate: None };
    server.authenticate(&credentials, now_s()).await.map_err(|e| e.reason)
}

#[tokio::test]
async fn a_key_is_its_holder_and_nothing_else_is() {
    let site = Site::new();
    let (id, key) = site.create("driver", None);
    let server = site.open();
    let holder = known(&server, &key).await.unwrap();
    assert_eq!((holder.name.as_str(), holder.tenant.as_str()), ("driver", "site-a"));
    assert!(holder.may(Access::Write, "robot-7") && !holder.may(Access::Read, "lift-1"));
    let (_, stranger) = Site::new().create("driver", None);
    let secret = stranger.splitn(3, '_').nth(2).unwrap();
    for wrong in [
        &stranger,
        &format!("pk_{id}_{secret}"),
        &key[..key.len() - 1],
        &format!("{key}A"),
        &key.to_uppercase(),
        "pk_",
        "x",
    ] {
        assert_eq!(known(&server, wrong).await.unwrap_err(), Reason::Invalid, "{wrong}");
    }
    assert_eq!(server.authenticate(&Credentials::default(), now_s()).await.unwrap_err().reason, Reason::Missing);
}

#[tokio::test]
async fn a_revoked_key_ends_without_a_restart_even_for_calls_under_way() {
    let site = Site::new();
    let (id, key) = site.create("driver", None);
    let (_, other) = site.create("operator", None);
    let server = site.open();
    let (holder, bystander) = (known(&server, &key).await.unwrap(), known(&server, &other).await.unwrap());
    KeyFile::change(&site.file, |f| f.revoke(&id, false, now_s())).unwrap();
    server.refresh_keys();
    assert_eq!(known(&server, &key).await.unwrap_err(), Reason::Revoked);
    assert!(!holder.standing.holds(now_s()));
    assert!(bystander.standing.holds(now_s()) && known(&server, &other).await.is_ok());
}

#[tokio::test]
async fn a_key_taken_out_of_the_file_is_no_key() {
    let site = Site::new();
    let (_, key) = site.create("driver", None);
    let server = site.open();
    let holder = known(&server, &key).await.unwrap();
    KeyFile::change(&site.file, |f| Ok(std::mem::take(&mut f.keys))).unwrap();
    server.refresh_keys();
    assert_eq!(known(&server, &key).await.unwrap_err(), Reason::Invalid);
    assert!(!holder.standing.holds(now_s()));
}

#[tokio::test]
async fn new_keys_are_known_without_a_restart() {
    let site = Site::new();
    site.create("driver", None);
    let server = site.open();
    let (_, key) = site.create("late", None);
    server.refresh_keys();
    assert_eq!(known(&server, &key).await.unwrap().name, "late");
}

#[tokio::test]
async fn a_file_that_is_lost_or_broken_locks_nobody_out() {
    let site = Site::new();
    let (_, key) = site.create("driver", None);
    let server = site.open();
    std::fs::write(&site.file, "{").unwrap();
    server.refresh_keys();
    assert!(known(&server, &key).await.is_ok());
    std::fs::remove_file(&site.file).unwrap();
    server.refresh_keys();
    assert!(known(&server, &key).await.is_ok());
}

#[tokio::test]
async fn an_expired_key_says_so_to_its_holder_alone() {
    let site = Site::new();
    let (id, key) = site.create("driver", Some(now_s()));
    let server = site.open();
    assert_eq!(known(&server, &key).await.unwrap_err(), Reason::Expired);
    let guessed = format!("pk_{id}_{}", "A".repeat(43));
    assert_eq!(known(&server, &guessed).await.unwrap_err(), Reason::Invalid);
}

fn mode(path: &Path) -> u32 {
    std::fs::metadata(path).unwrap().permissions().mode() & 0o777
}

#[test]
fn the_file_holds_no_secret_and_is_its_owners_alone() {
    let site = Site::new();
    let (id, key) = site.create("driver", None);
    let text = std::fs::read_to_string(&site.file).unwrap();
    // The secret may have the separator in it, too.
    let secret = key.splitn(3, '_').nth(2).unwrap();
    assert!(text.contains(&id) && !text.contains(secret));
    assert_eq!(mode(&site.file), 0o600);
    // A file that somebody has opened to others is closed again by the next change.
    std::fs::set_permissions(&site.file, std::fs::Permissions::from_mode(0o644)).unwrap();
    site.create("other", None);
    assert_eq!(mode(&site.file), 0o600);
}

#[test]
fn a_file_that_anybody_can_write_is_refused() {
    let site = Site::new();
    site.create("driver", None);
    std::fs::set_permissions(&site.file, std::fs::Permissions::from_mode(0o666)).unwrap();
    assert!(matches!(KeyFile::read(&site.file), Err(KeyFileError::WritableByAll { mode: 0o666, .. })));
}

#[test]
fn a_name_that_several_keys_have_is_revoked_only_with_all() {
    let site = Site::new();
    let (first, _) = site.create("driver", None);
    site.create("driver", None);
    let revoke = |name: &str, all| KeyFile::change(&site.file, |f| f.revoke(name, all, 7));
    assert!(matches!(revoke("driver", false), Err(KeyFileError::Ambiguous(2, _))));
    assert!(KeyFile::read(&site.file).unwrap().keys.iter().all(|k| k.revoked_s.is_none()));
    assert_eq!(revoke(&first, false).unwrap(), 1);
    assert_eq!(revoke("driver", false).unwrap(), 1);
    assert!(matches!(revoke("driver", true), Err(KeyFileError::NotFound(_))));
    assert!(matches!(revoke("nobody", true), Err(KeyFileError::NotFound(_))));
}

#[test]
fn keys_made_at_the_same_time_are_all_there() {
    let site = Site::new();
    std::thread::scope(|scope| {
        for i in 0..8 {
            let site = &site;
            scope.spawn(move || site.create(&format!("driver-{i}"), None));
        }
    });
    assert_eq!(KeyFile::read(&site.file).unwrap().keys.len(), 8);
}
