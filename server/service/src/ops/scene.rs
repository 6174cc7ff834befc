//! Objects.

use super::sessions::{Page, page_by_number};
use crate::reason;
use crate::{Error, Result, Service};
use percept_geometry::ObjectClass;
use percept_pipeline::Snapshot;
use percept_scene::{Object, ObjectState};
use std::sync::Arc;

impl Service {
    /// The newest snapshot of a session.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn snapshot(&self, session: &str) -> Result<Arc<Snapshot>> {
        Ok(self.session(session).await?.snapshot())
    }

    /// Objects by id, with the version of the map that their boxes refer to.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `PAGE_TOKEN_INVALID`.
    pub async fn list_objects(
        &self,
        session: &str,
        class: Option<ObjectClass>,
        include_gone: bool,
        page_size: u32,
        page_token: &str,
    ) -> Result<(Page<Object>, u64)> {
        let snapshot = self.snapshot(session).await?;
        let wanted = |o: &&Object| class.is_none_or(|c| c == o.class) && (include_gone || o.state != ObjectState::Gone);
        let objects: Vec<Object> = snapshot.objects.iter().filter(wanted).cloned().collect();
        Ok((page_by_number(&objects, |o| o.id.0, page_size, page_token)?, snapshot.map_version))
    }

    /// One object.
    ///
    /// # Errors
    /// `OBJECT_NOT_FOUND`, `SESSION_NOT_FOUND`.
    pub async fn object(&self, session: &str, id: u64) -> Result<Object> {
        let snapshot = self.snapshot(session).await?;
        snapshot.objects.iter().find(|o| o.id.0 == id).cloned().ok_or_else(|| {
            Error::not_found(
                reason::OBJECT_NOT_FOUND,
                "object_id",
                format!("object_id {id} does not exist in this session; list the objects"),
            )
        })
    }
}
