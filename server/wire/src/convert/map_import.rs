//! Maps that come from elsewhere.

use super::{geometry, navigation, required, sensors, toolbox};
use crate::convert::toolbox::sources::Sources;
use crate::v1;
use percept_service::toolbox::Toolbox;
use percept_service::{Error, GivenMap, ImportOptions, ImportedMap, Result, reason};

impl Sources for v1::ImportMapRequest {
    fn sources(&self) -> Vec<(&'static str, Option<&v1::CloudSource>)> {
        match &self.map {
            Some(v1::import_map_request::Map::Cloud(cloud)) => vec![("cloud", Some(cloud))],
            _ => vec![],
        }
    }
}

/// The map.
///
/// # Errors
/// `FIELD_MISSING`, `SIZE_MISMATCH`, `OUT_OF_RANGE`, `FILE_INVALID`, `GRID_TOO_LARGE`, and those of a cloud.
pub fn given(toolbox: &Toolbox, r: &v1::ImportMapRequest) -> Result<GivenMap> {
    use v1::import_map_request::Map as M;
    Ok(match required("map", r.map.as_ref())? {
        M::Grid(grid) => GivenMap::Grid(navigation::grid(grid).map_err(|e| e.within("grid"))?),
        M::Nav2(files) => GivenMap::Grid(navigation::nav2(files, toolbox.limits()).map_err(|e| e.within("nav2"))?),
        M::Octomap(bytes) => {
            let limits = super::format_limits(toolbox.limits());
            let refused =
                |e: percept_formats::FormatError| Error::invalid(reason::FILE_INVALID, "octomap", e.to_string());
            GivenMap::Octree(percept_formats::octomap::decode(bytes, &limits).map_err(refused)?)
        }
        M::Cloud(source) => GivenMap::Cloud { cloud: toolbox::cloud(toolbox, "cloud", Some(source))?, stood: vec![] },
    })
}

/// How it is taken in.
///
/// # Errors
/// A pose that is none.
pub fn options(r: &v1::ImportMapRequest) -> Result<ImportOptions> {
    let set = |v: f64| (v != 0.0).then_some(v);
    Ok(ImportOptions {
        start: r.start.as_ref().map(|start| geometry::pose("start", Some(start))).transpose()?,
        sensor_height_m: set(r.sensor_height_m),
        voxel_size_m: set(r.voxel_size_m),
    })
}

/// What became of it, as a message.
pub fn imported_to(done: &ImportedMap) -> v1::ImportMapResponse {
    v1::ImportMapResponse {
        num_keyframes: done.num_keyframes as u64,
        occupied_share: done.occupied_share,
        free_share: done.free_share,
        map_version: done.map_version,
        found_by: sensors::kind_to(done.found_by).into(),
    }
}
