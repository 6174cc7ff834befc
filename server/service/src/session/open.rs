//! The registry, and all that runs beside it for as long as it lives.

use super::recordings::RecordingSettings;
use super::registry::Registry;
use super::shelf::OwnDetectors;
use super::{keeper, sharing};
use crate::{ComputePool, Health, Limits, Result};
use percept_pipeline::PipelineParams;
use percept_store::DataRoot;
use std::sync::Arc;

/// Reads the catalogue. Sessions found there sleep until they are used; those whose deletion broke off are removed.
///
/// # Errors
/// `STORAGE_FAULT`.
pub(crate) async fn open(
    root: DataRoot,
    compute: ComputePool,
    limits: Arc<Limits>,
    of_sessions: (PipelineParams, RecordingSettings),
    detectors: OwnDetectors,
    health: Health,
) -> Result<Arc<Registry>> {
    let (registry, buried) = Registry::of_catalogue(root, compute, limits, of_sessions, detectors).await?;
    registry.load_detectors().await;
    let this = Arc::clone(&registry);
    tokio::spawn(async move {
        for place in buried {
            this.purge(&place).await;
        }
    });
    tokio::spawn(keeper::keep(Arc::downgrade(&registry)));
    tokio::spawn(keeper::note_awake(Arc::downgrade(&registry)));
    tokio::spawn(keeper::watch_storage(Arc::downgrade(&registry), health.clone()));
    tokio::spawn(sharing::follow_catalogue(Arc::downgrade(&registry)));
    tokio::spawn(sharing::follow_node(Arc::downgrade(&registry), health));
    Ok(registry)
}
