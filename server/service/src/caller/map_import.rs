//! Maps that come from elsewhere, to begin with or to compare with, in the name of a caller.

use super::Caller;
use super::audit::Act;
use crate::ops::map_import::{GivenMap, ImportOptions, ImportedMap};
use crate::toolbox::{SessionCloud, Toolbox};
use crate::{Limits, MapBefore, MapComparison, Result, check_id};
use std::sync::Arc;

impl Caller {
    /// Begins a session with a map, which `read` makes of what was sent; `wanted` are clouds of sessions in it.
    ///
    /// # Errors
    /// Those of `read`; `MAP_NOT_EMPTY`, `MAP_UNUSABLE`, `GRID_TOO_LARGE`, `OUT_OF_RANGE`, `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn import_map(
        &self,
        session: &str,
        wanted: Vec<SessionCloud>,
        read: impl FnOnce(&Toolbox) -> Result<GivenMap> + Send + 'static,
        options: ImportOptions,
    ) -> Result<ImportedMap> {
        const NAME: &str = "MapsService/ImportMap";
        check_id("session_id", session)?;
        self.may_with(NAME, session).await?;
        self.may_use(&wanted).await?;
        let stood = self.service.stood_in(&wanted).await?;
        let maps = self.service.session_clouds(wanted).await?;
        let given = self.service.toolbox(self.owner(), maps, read).await?.with_stood(stood);
        let act = Act::begin(&self.context, NAME, session);
        let done = self.service.import_map(session, given, options).await;
        act.end(&done);
        done
    }

    /// What appeared in the map of a session and what has gone since an older one, which `read` makes of what was sent.
    ///
    /// # Errors
    /// Those of `read`; `MAP_EMPTY`, `GRID_TOO_LARGE`, `OUT_OF_RANGE`, `SESSION_NOT_FOUND`, `PICTURE_TOO_LARGE`.
    pub async fn compare_maps(
        &self,
        session: &str,
        read: impl FnOnce(&Limits) -> Result<MapBefore> + Send + 'static,
        tolerance_m: Option<f64>,
    ) -> Result<MapComparison> {
        self.may_with("MapsService/CompareMaps", session).await?;
        let limits = Arc::clone(self.limits());
        let before = self.query(session, move || read(&limits)).await??;
        if let MapBefore::Session(other) = &before {
            self.may_with("MapsService/GetOccupancyGrid", other).await?;
        }
        self.service.compare_maps(session, before, tolerance_m).await
    }
}
