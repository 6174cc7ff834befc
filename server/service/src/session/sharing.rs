//! Sessions of data that others have open, too: which there are by now, and whose each of them is.
//!
//! A session that is awake belongs to this node, by a claim in the store; one that sleeps belongs to nobody. A node that
//! was silent for too long has lost all that it claimed: its sessions end at once, without storing anything, and are
//! read anew by whoever is asked for them next.

use super::fault::{Fault, Trouble, store_error};
use super::meta::SessionMeta;
use super::records::{MetaRecord, parse};
use super::registry::Registry;
use super::slot::{Phase, Slot};
use crate::reason;
use crate::{Error, Health, Part};
use percept_store::{CatalogueEntry, Claim, SessionPlace};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Weak};
use std::time::{Duration, SystemTime};

/// How often the catalogue is looked through where it is shared: each look is a listing by the thousand.
const LOOK_SHARED: Duration = Duration::from_secs(5);
/// How often it is asked whether something was added to a directory of this server alone, as an import does.
const LOOK_OWN: Duration = Duration::from_secs(2);

/// Why a session cannot be had here.
pub(super) enum Unclaimed {
    /// Another node has it, or it cannot be said.
    Trouble(Trouble),
    /// It was deleted, or deleted and created anew.
    Gone,
}

impl<E: Into<Trouble>> From<E> for Unclaimed {
    fn from(trouble: E) -> Self {
        Self::Trouble(trouble.into())
    }
}

impl Registry {
    /// Takes a session for this node and reads the record that it was created with.
    pub(super) async fn claim(&self, slot: &Slot) -> Result<(SessionPlace, MetaRecord), Unclaimed> {
        let place = slot.place.get().ok_or_else(|| Error::internal("a session without a place"))?;
        let life = self.root.watch_node().map_or(0, |node| node.borrow().life);
        match self.root.claim(place).await? {
            Claim::Ours => slot.claimed_in.store(life, Ordering::SeqCst),
            Claim::Elsewhere { address } => return Err(Error::elsewhere(&slot.id, &address).into()),
            Claim::Gone => return Err(Unclaimed::Gone),
        }
        match self.root.entry(place.id()).await? {
            Some(CatalogueEntry::Created { place: found, record }) if found == *place => {
                Ok((place.clone(), parse("the catalogue entry", &record)?))
            }
            Some(CatalogueEntry::Damaged { .. }) => {
                Err(Trouble::Lasting(Fault::new(reason::DATA_DAMAGED, "its catalogue entry cannot be read")).into())
            }
            _ => Err(Unclaimed::Gone),
        }
    }

    /// Gives a session back after its store was closed.
    pub(super) async fn release(&self, slot: &Slot) {
        let Some(place) = slot.place.get() else { return };
        if let Err(error) = self.root.release(place).await {
            tracing::warn!(session = slot.id, %error, "a session stays with this server for as long as it runs");
        }
    }

    /// Where a session is that another server has: what happens to it is told there.
    pub(crate) async fn elsewhere(&self, id: &str) -> Option<Error> {
        let slot = self.slot(id).filter(|_| self.root.is_shared())?;
        if matches!(slot.phase(), Phase::Awake(_) | Phase::Retiring(_)) {
            return None;
        }
        match self.root.holder(slot.place.get()?).await {
            Ok(address) => address.map(|address| Error::elsewhere(id, &address)),
            Err(error) => {
                tracing::warn!(session = id, %error, "who has the session was not read");
                None
            }
        }
    }

    /// The session that the same request has created at another server.
    pub(super) async fn created_before(&self, meta: &SessionMeta) -> Result<SessionPlace, Error> {
        let exists = super::registry::exists(&meta.id);
        match self.root.entry(&meta.id).await.map_err(|e| store_error(&e))? {
            Some(CatalogueEntry::Created { place, record }) if !meta.request_id.is_empty() => {
                let record: MetaRecord = parse("the catalogue entry", &record).map_err(|_| exists.clone())?;
                let is_same = record.request_id == meta.request_id && record.tenant == meta.tenant;
                if is_same { Ok(place) } else { Err(exists) }
            }
            _ => Err(exists),
        }
    }

    /// Takes in a session that another server has created, if there is one of this id that is not known here.
    pub(crate) async fn look_for(&self, id: &str) {
        if self.root.is_shared() && self.slot(id).is_none() {
            self.adopt(id).await;
        }
    }

    /// Takes in what the catalogue says of an id.
    pub(super) async fn adopt(&self, id: &str) {
        match self.root.entry(id).await {
            Ok(Some(CatalogueEntry::Created { place, record })) => {
                tracing::info!(session = id, ?place, "a session was created elsewhere");
                self.take_in(place, &record);
            }
            Ok(Some(CatalogueEntry::Damaged { place })) => self.take_in_damaged(place),
            Ok(Some(CatalogueEntry::Deleted { .. }) | None) => {}
            Err(error) => tracing::warn!(session = id, %error, "its catalogue entry was not read"),
        }
    }

    /// Compares what is known here with the catalogue. What is awake here, or under way, is left alone.
    async fn look(&self) -> Result<(), percept_store::StoreError> {
        let before: Vec<Arc<Slot>> = self.slots().into_iter().filter(|slot| slot.place.get().is_some()).collect();
        let newest = self.root.newest_numbers().await?;
        for slot in before {
            let Some(place) = slot.place.get() else { continue };
            let is_same = newest.get(&slot.id).is_some_and(|number| *number == place.number());
            if !is_same && slot.step(|phase| is_nobodys(phase).then_some(Phase::Gone(Ok(())))) {
                tracing::info!(session = slot.id, ?place, newest = ?newest.get(&slot.id), "a session was deleted elsewhere");
                self.remove(&slot);
                slot.events.close();
            }
        }
        for id in newest.into_keys().filter(|id| self.slot(id).is_none()) {
            self.adopt(&id).await;
        }
        Ok(())
    }

    /// Ends all sessions that were claimed in an earlier life of the node, without storing anything.
    async fn lose(&self, is_lost: impl Fn(u64) -> bool) {
        let lost = self.slots().into_iter().filter(|slot| is_lost(slot.claimed_in.load(Ordering::SeqCst)));
        let sessions = lost.filter_map(|slot| match slot.phase() {
            Phase::Awake(session) | Phase::Retiring(session) => Some(session),
            _ => None,
        });
        futures::future::join_all(sessions.map(|session| async move { session.discard().await })).await;
    }

    /// Ends a session that has just woken if its claim was lost meanwhile: [`Self::lose`] did not see it.
    pub(super) async fn check_claim(&self, slot: &Slot) {
        let Some(node) = self.root.watch_node() else { return };
        let state = *node.borrow();
        if (!state.is_alive || slot.claimed_in.load(Ordering::SeqCst) != state.life)
            && let Phase::Awake(session) = slot.phase()
        {
            session.discard().await;
        }
    }
}

fn is_nobodys(phase: &Phase) -> bool {
    matches!(phase, Phase::Asleep(_) | Phase::Faulted(..))
}

/// Follows the catalogue, until the registry is gone.
pub(super) async fn follow_catalogue(registry: Weak<Registry>) {
    let mut seen = None::<SystemTime>;
    loop {
        let Some(registry) = registry.upgrade() else { return };
        let is_shared = registry.root.is_shared();
        // Whatever is added to a directory changes its time.
        let changed = registry.root.catalogue_changed();
        let is_due = is_shared || (changed.is_some() && changed != seen);
        if is_due && let Err(error) = registry.look().await {
            tracing::warn!(%error, "the catalogue was not looked through");
        }
        registry.refresh_detectors().await;
        seen = changed;
        drop(registry);
        tokio::time::sleep(if is_shared { LOOK_SHARED } else { LOOK_OWN }).await;
    }
}

/// Follows the life of this node, where data are shared, until the registry is gone.
pub(super) async fn follow_node(registry: Weak<Registry>, health: Health) {
    let Some(mut node) = registry.upgrade().and_then(|registry| registry.root.watch_node()) else { return };
    while node.changed().await.is_ok() {
        let state = *node.borrow_and_update();
        let Some(registry) = registry.upgrade() else { return };
        if state.is_alive {
            registry.lose(|life| life < state.life).await;
            health.report(Part::Node, crate::HEALTHY);
        } else {
            health.report(Part::Node, Err(store_error(&percept_store::StoreError::NodeSilent)));
            registry.lose(|life| life <= state.life).await;
        }
    }
}
