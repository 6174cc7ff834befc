//! Maps that come from elsewhere, in the name of a caller.

use super::Caller;
use super::audit::Act;
use crate::ops::map_import::{GivenMap, ImportOptions, ImportedMap};
use crate::toolbox::{SessionCloud, Toolbox};
use crate::{Result, check_id};

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
        let maps = self.service.session_clouds(wanted).await?;
        let given = self.service.toolbox(self.owner(), maps, read).await?;
        let act = Act::begin(&self.context, NAME, session);
        let done = self.service.import_map(session, given, options).await;
        act.end(&done);
        done
    }
}
