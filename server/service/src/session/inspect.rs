//! Reads the records of a session one by one, for those who look at what is stored without running it.

use super::records::{KeyframeRecord, MetaRecord, StateRecord, TrajectoryRecord, Unreadable, parse};
use percept_pipeline::Loop;
use percept_scene::Object;
use percept_store::{BlobId, Key, Prefix, keys};

/// The blobs that a record of a session names; records of kinds that this version does not know name none.
///
/// # Errors
/// Why the record cannot be read, for the operator.
pub fn read_record(key: &Key, value: &[u8]) -> Result<Vec<BlobId>, String> {
    read(key, value).map_err(|e| e.to_string())
}

fn read(key: &Key, value: &[u8]) -> Result<Vec<BlobId>, Unreadable> {
    let is_below = |prefix: Prefix| key.as_str().starts_with(prefix.as_str());
    if is_below(keys::keyframes()) {
        let record: KeyframeRecord = parse("a keyframe", value)?;
        let blob = record.blob.map(|text| text.parse().map_err(|e| Unreadable::new("a keyframe's scan", e)));
        return blob.transpose().map(|blob| blob.into_iter().collect());
    }
    if *key == keys::meta() {
        parse::<MetaRecord>("meta", value)?;
    } else if *key == keys::state() {
        parse::<StateRecord>("state", value)?;
    } else if *key == keys::objects_in_one() {
        parse::<Vec<Object>>("the objects", value)?;
    } else if is_below(keys::objects()) {
        parse::<Object>("an object", value)?;
    } else if is_below(keys::loop_closures()) {
        parse::<Loop>("a loop", value)?;
    } else if is_below(keys::trajectories()) {
        parse::<TrajectoryRecord>("a part of the trajectory", value)?;
    }
    Ok(Vec::new())
}
