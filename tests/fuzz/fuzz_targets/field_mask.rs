//! Changes of sessions and sensors with their masks, as gRPC brings them: the first byte chooses which.
#![no_main]
use percept_service::Limits;
use percept_wire::convert::updates;
use percept_wire::v1::{UpdateSensorRequest, UpdateSessionRequest};
use prost::Message;
use std::collections::{BTreeMap, BTreeSet};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((choice, body)) = bytes.split_first() else { return };
    if choice % 2 == 0 {
        if let Ok(request) = UpdateSessionRequest::decode(body) {
            session(&request);
        }
    } else if let Ok(request) = UpdateSensorRequest::decode(body) {
        sensor(&request);
    }
});

/// The paths that a mask names; all of them are meant where there are none.
fn named(mask: Option<&[String]>) -> Option<BTreeSet<&str>> {
    mask.filter(|paths| !paths.is_empty()).map(|paths| paths.iter().map(String::as_str).collect())
}

fn session(request: &UpdateSessionRequest) {
    let limits = Limits { max_planning_cells: 1 << 16, ..Limits::default() };
    let Ok(update) = updates::session(request, &limits) else { return };
    let changes = &update.changes;
    let mut times: BTreeMap<&str, usize> = BTreeMap::new();
    for change in &changes.params {
        *times.entry(&change.path).or_default() += 1;
    }
    let Some(paths) = named(request.update_mask.as_ref().map(|mask| mask.paths.as_slice())) else {
        assert!(times.into_values().all(|count| count == 1));
        return;
    };
    assert_eq!(changes.display_name.is_some(), paths.contains("display_name"));
    assert_eq!(changes.labels.is_some(), paths.contains("labels"));
    assert_eq!(changes.zone_masks.is_some(), paths.contains("zone_masks"));
    assert!(changes.mode.is_none() || paths.contains("mode"));
    // Once for itself and once for each section of it that is named, however often: what a request costs is bounded by
    // the contract.
    for (path, count) in times {
        let whole = format!("params.{path}");
        let sections = whole.match_indices('.').map(|(end, _)| &whole[..end]);
        assert_eq!(sections.chain([whole.as_str()]).filter(|section| paths.contains(section)).count(), count, "{path}");
    }
}

fn sensor(request: &UpdateSensorRequest) {
    let Ok(update) = updates::sensor(request) else { return };
    let changes = &update.changes;
    let Some(paths) = named(request.update_mask.as_ref().map(|mask| mask.paths.as_slice())) else { return };
    for (field, changes) in [
        ("kind", changes.kind.is_some()),
        ("t_base_sensor", changes.t_base_sensor.is_some()),
        ("intrinsics", changes.intrinsics.is_some()),
        ("time_offset_s", changes.time_offset_s.is_some()),
        ("overload_policy", changes.overload.is_some()),
    ] {
        assert_eq!(changes, paths.contains(field), "{field}");
    }
}
