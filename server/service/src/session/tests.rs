//! What only can be tried from within: pipelines that fail, records that other versions wrote, very many objects.

use super::actor::Ending;
use super::fault::Trouble;
use super::job::Job;
use super::meta::{DEFAULT_TENANT, OverloadPolicy, SensorDeclaration, SessionMeta, SessionMode};
use super::recordings::RecordingSettings;
use super::records::{MetaRecord, json};
use super::recover::recover;
use super::registry::Registry;
use super::scratch::Scratch;
use super::shelf::{OwnDetectors, Shelf};
use super::state::SessionState;
use super::writer::{Stored, Writer};
use crate::{ComputePool, EventKind, Health, Limits};
use nalgebra::{Point3, Vector3};
use percept_geometry::{ObjectClass, OrientedBox3, SensorId, SensorKind, SensorSpec, Timestamp};
use percept_pipeline::PipelineParams;
use percept_scene::{Object, ObjectId, ObjectState};
use percept_store::{DataRoot, RootConfig, SlateStore, Store, keys};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::time::Duration;

fn compute() -> ComputePool {
    ComputePool::new(rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap(), 1)
}

async fn registry(config: &RootConfig) -> Arc<Registry> {
    let root = DataRoot::open(config.clone()).await.unwrap();
    let (limits, params) = (Arc::new(Limits::default()), PipelineParams::default());
    super::open::open(
        root,
        compute(),
        limits,
        (params, RecordingSettings::default()),
        OwnDetectors::none(),
        Health::starting(),
    )
    .await
    .unwrap()
}

fn meta(id: &str) -> SessionMeta {
    let spec = SensorSpec {
        id: SensorId::from("wheels"),
        kind: SensorKind::Odometry,
        t_base_sensor: percept_geometry::Pose::identity(),
        intrinsics: None,
        time_offset_s: 0.0,
        range_max_m: None,
    };
    SessionMeta {
        id: id.to_owned(),
        tenant: DEFAULT_TENANT.to_owned(),
        display_name: String::new(),
        labels: Default::default(),
        zones: Vec::new(),
        zone_masks: Vec::new(),
        room_names: Vec::new(),
        class_examples: Vec::new(),
        revision: 0,
        mode: SessionMode::Mapping,
        create_time_ns: 1,
        request_id: String::new(),
        params: PipelineParams::default(),
        sensors: vec![SensorDeclaration { spec, overload: OverloadPolicy::Block }],
    }
}

#[tokio::test]
async fn a_pipeline_that_fails_is_read_anew_and_one_that_goes_on_failing_is_set_apart() {
    let registry = registry(&RootConfig::in_memory()).await;
    for id in ["robot", "other"] {
        registry.create(meta(id)).await.unwrap();
    }
    let events = registry.events("robot").unwrap();
    for time in 1..=3 {
        let session = registry.get("robot").await.unwrap();
        let token = events.newest_token();
        let slot = registry.slots().into_iter().find(|s| s.id == "robot").unwrap();
        let store: Arc<dyn Store> = Arc::new(SlateStore::in_memory().await.unwrap());
        Arc::clone(&registry).attend(slot, Arc::clone(&session), std::future::ready(Ending::Panicked), store).await;
        // The actor that the failed one stands for.
        session.discard().await;
        let state = registry.view("robot").await.unwrap().state;
        if time < 3 {
            assert_eq!(state, SessionState::Asleep);
            let told = events.after(token, 10).await.unwrap();
            let is_resync = |event: &crate::Event| matches!(event.kind, EventKind::Resync(_));
            assert!(!told.is_empty() && told.iter().all(is_resync), "{told:?}");
        } else {
            assert_eq!(state, SessionState::Faulted);
        }
    }
    let view = registry.view("robot").await.unwrap();
    assert_eq!(view.fault.unwrap().reason, "PIPELINE_FAILED");
    // What is whole can be read; nothing more is taken, and it says so at once.
    assert!(registry.get("robot").await.is_ok());
    let refused = registry.change("robot", |_, m| {
        m.display_name = "x".to_owned();
        Ok(None)
    });
    assert_eq!(refused.await.err().unwrap().reason, "SESSION_FAULTED");
    assert_eq!(registry.view("other").await.unwrap().state, SessionState::Asleep);
    registry.delete("robot").await.unwrap();
    registry.create(meta("robot")).await.unwrap();
    assert!(registry.get("robot").await.is_ok());
}

#[tokio::test]
async fn a_catalogue_entry_of_another_version_or_none_stops_nothing() {
    let config = RootConfig::in_memory();
    let root = DataRoot::open(config.clone()).await.unwrap();
    let mut newer = serde_json::to_value(MetaRecord::of(&meta("newer")).unwrap()).unwrap();
    newer["colour"] = "red".into();
    newer["params"]["magic"] = 1.into();
    root.create("newer", newer.to_string().as_bytes()).await.unwrap();
    root.create("rubbish", b"\xff{").await.unwrap();
    root.create("well", &json(&MetaRecord::of(&meta("well")).unwrap()).unwrap()).await.unwrap();
    drop(root);
    let registry = registry(&config).await;
    for id in ["newer", "well"] {
        assert!(registry.get(id).await.is_ok(), "{id}");
    }
    assert_eq!(registry.view("rubbish").await.unwrap().state, SessionState::Faulted);
    assert_eq!(registry.get("rubbish").await.err().unwrap().reason, "SESSION_FAULTED");
    assert_eq!(registry.list("", 10, |_| true).await.len(), 3);
    registry.delete("rubbish").await.unwrap();
    assert_eq!(registry.list("", 10, |_| true).await.len(), 2);
}

#[tokio::test]
async fn a_stop_stores_and_ends_every_session() {
    let config = RootConfig::in_memory();
    let registry = registry(&config).await;
    for i in 0..8 {
        registry.create(meta(&format!("s{i}"))).await.unwrap();
        registry.get(&format!("s{i}")).await.unwrap();
    }
    registry.stop().await.unwrap();
    assert!(registry.list("", 10, |v| v.state != SessionState::Asleep).await.is_empty());
    assert_eq!(registry.get("s1").await.err().unwrap().reason, "STOPPING");
    assert_eq!(registry.create(meta("late")).await.err().unwrap().reason, "STOPPING");
}

fn object(number: u64) -> Object {
    Object {
        id: ObjectId(number),
        class: ObjectClass::BUILT_IN[0],
        confidence: 0.5,
        class_probabilities: vec![],
        annotation: percept_scene::Annotation::default(),
        history: vec![],
        bbox: OrientedBox3::upright(Point3::new(number as f64, 0.0, 0.5), Vector3::new(1.0, 1.0, 1.0), 0.3),
        state: ObjectState::Static,
        velocity_mps: Vector3::zeros(),
        velocity_variance: 0.0,
        first_seen: Timestamp(1),
        last_seen: Timestamp(2),
        observation_count: 3,
        num_points: 4,
    }
}

#[tokio::test]
async fn forty_thousand_objects_are_stored_and_read_again() {
    let store: Arc<dyn Store> = Arc::new(SlateStore::in_memory().await.unwrap());
    let mut writer = Writer::new(Arc::clone(&store), Stored::default());
    let mut objects: Vec<Object> = (0..40_000).map(object).collect();
    let job = |objects: &[Object]| Job { objects: Some((Arc::new(objects.to_vec()), 40_000)), ..Job::default() };
    writer.write(&[(1, job(&objects))]).await.unwrap();
    // Of the next change only what changed is written, and what went goes.
    objects.truncate(39_990);
    objects[7].confidence = 0.9;
    writer.write(&[(2, job(&objects))]).await.unwrap();
    assert_eq!(store.scan_all(&keys::objects()).await.unwrap().len(), 39_990);
    let created = MetaRecord::of(&meta("a")).unwrap();
    let scratch = Scratch::in_directory(None, &Arc::new(AtomicUsize::new(1 << 30)));
    let recovered =
        recover(store, (&compute(), &Shelf::new(OwnDetectors::none())), created, &PipelineParams::default(), scratch)
            .await;
    let recovered = recovered.map_err(|t: Trouble| t.error());
    let recovered = recovered.unwrap();
    assert!(recovered.damage.is_none());
    assert_eq!(recovered.pipeline.snapshot().objects.len(), 39_990);
    assert_eq!(recovered.stored.state.ticket, 2);
}

#[tokio::test]
async fn a_session_is_put_to_sleep_when_nobody_uses_it() {
    let root = DataRoot::open(RootConfig::in_memory()).await.unwrap();
    let limits = Limits { sleep_after_s: 0, ..Limits::default() };
    let registry = super::open::open(
        root,
        compute(),
        Arc::new(limits),
        (PipelineParams::default(), RecordingSettings::default()),
        OwnDetectors::none(),
        Health::starting(),
    )
    .await
    .unwrap();
    registry.create(meta("robot")).await.unwrap();
    registry.get("robot").await.unwrap();
    let slot = registry.slots().remove(0);
    let asleep = slot.until(|phase| phase.state() == SessionState::Asleep);
    tokio::time::timeout(Duration::from_secs(20), asleep).await.unwrap();
    assert!(registry.get("robot").await.is_ok());
}
