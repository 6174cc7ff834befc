//! Create, find, list, delete sessions.

use super::labels::{check_display_name, check_labels};
use crate::clock::now_ns;
use crate::reason;
use crate::session::meta::{SensorDeclaration, SessionMeta, SessionMode};
use crate::{Error, EventLog, Result, Service, Session, SessionState, SessionView, check_id};
use percept_identity::Pattern;
use percept_pipeline::{KeyframeInfo, PipelineParams};
use std::collections::BTreeMap;
use std::sync::Arc;

/// What a session is created with.
#[derive(Debug, Clone)]
pub struct NewSession {
    /// Identifier; none: one is chosen.
    pub id: Option<String>,
    /// For people.
    pub display_name: String,
    /// For programs.
    pub labels: BTreeMap<String, String>,
    /// What it does with frames.
    pub mode: SessionMode,
    /// Sensors known already.
    pub sensors: Vec<SensorDeclaration>,
    /// Every parameter.
    pub params: PipelineParams,
    /// Makes the call idempotent; empty: not.
    pub request_id: String,
}

/// Everything that can be said of a session without waking it.
#[derive(Clone)]
pub struct SessionDescription {
    /// What lists say.
    pub view: SessionView,
    /// What it is, and its sensors; none if that cannot be read.
    pub whole: Option<(SessionMeta, Vec<crate::SensorStatus>)>,
}

/// Which sessions a list is of, and how.
#[derive(Debug, Clone, Default)]
pub struct SessionList {
    /// Only those in this state.
    pub state: Option<SessionState>,
    /// Only those whose id fits.
    pub pattern: Option<Pattern>,
    /// Only those that have all of these labels, with the value if one is given.
    pub labels: Vec<(String, Option<String>)>,
    /// In this order.
    pub order: SessionOrder,
    /// Elements of a page: 0 means 100, 1000 at most.
    pub page_size: u32,
    /// From the page before; empty: from the start.
    pub page_token: String,
}

/// The order of a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SessionOrder {
    /// By what.
    pub by: SessionOrderKey,
    /// Whether the last comes first.
    pub is_descending: bool,
}

/// By what lists are ordered; where it is the same, by id.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SessionOrderKey {
    /// Ids, by their bytes.
    #[default]
    Id,
    /// When they were created.
    CreateTime,
    /// When they were last used: it changes while a list is read.
    LastUsed,
}

impl SessionList {
    fn wants(&self, view: &SessionView) -> bool {
        self.state.is_none_or(|state| state == view.state) && self.pattern.as_ref().is_none_or(|p| p.matches(&view.id))
    }

    fn has_labels(&self, view: &SessionView) -> bool {
        let has = |(key, value): &(String, Option<String>)| {
            view.labels.get(key).is_some_and(|there| value.as_ref().is_none_or(|value| value == there))
        };
        self.labels.iter().all(has)
    }
}

/// Cuts a page out of all that are wanted; the token says where the page before ended: key, colon, id.
fn page_in_order(mut all: Vec<SessionView>, list: &SessionList) -> Result<Page<SessionView>> {
    let SessionOrder { by, is_descending } = list.order;
    let key = |view: &SessionView| match by {
        SessionOrderKey::Id => 0,
        SessionOrderKey::CreateTime => view.create_time_ns,
        SessionOrderKey::LastUsed => view.last_used_ns,
    };
    let compare = |a: (i64, &str), b: (i64, &str)| if is_descending { b.cmp(&a) } else { a.cmp(&b) };
    all.sort_by(|a, b| compare((key(a), &a.id), (key(b), &b.id)));
    let start = if list.page_token.is_empty() {
        0
    } else {
        let bad = || {
            Error::invalid(
                reason::PAGE_TOKEN_INVALID,
                "page_token",
                "page_token is not one of this list's; start without it",
            )
        };
        let (last, id) = list.page_token.split_once(':').ok_or_else(bad)?;
        let last: i64 = last.parse().map_err(|_| bad())?;
        all.partition_point(|view| compare((key(view), &view.id), (last, id)).is_le())
    };
    let end = (start + page_size(list.page_size)).min(all.len());
    let is_last = end == all.len();
    let items: Vec<SessionView> = all.drain(start..end).collect();
    let last = items.last().filter(|_| !is_last);
    let next_page_token = last.map(|view| format!("{}:{}", key(view), view.id)).unwrap_or_default();
    Ok(Page { items, next_page_token })
}

/// A part of a list.
#[derive(Debug, Clone)]
pub struct Page<T> {
    /// The elements.
    pub items: Vec<T>,
    /// Where the next page starts; empty on the last.
    pub next_page_token: String,
}

/// Elements of a page: 100 unless asked otherwise, 1000 at most.
pub(crate) fn page_size(asked: u32) -> usize {
    if asked == 0 { 100 } else { asked.min(1000) as usize }
}

/// Cuts a page out of a list ordered by number; the token is the number of the last element of the page before.
pub(crate) fn page_by_number<T: Clone>(
    items: &[T],
    number: impl Fn(&T) -> u64,
    size: u32,
    token: &str,
) -> Result<Page<T>> {
    let after: Option<u64> = if token.is_empty() {
        None
    } else {
        let bad = || {
            Error::invalid(reason::PAGE_TOKEN_INVALID, "page_token", "page_token is not one of ours; start without it")
        };
        Some(token.parse().map_err(|_| bad())?)
    };
    let start = after.map_or(0, |n| items.partition_point(|i| number(i) <= n));
    let end = (start + page_size(size)).min(items.len());
    let items_of_page = items[start..end].to_vec();
    let next_page_token = match items_of_page.last() {
        Some(last) if end < items.len() => number(last).to_string(),
        _ => String::new(),
    };
    Ok(Page { items: items_of_page, next_page_token })
}

impl Service {
    /// The parameters that a session gets where it sets none.
    pub fn default_params(&self) -> &PipelineParams {
        self.registry.defaults()
    }

    /// Creates a session of a tenant, durably; its id. It sleeps until it is used. Ids are unique among all tenants: whose
    /// keys are for a pattern of ids leaves the others to others.
    ///
    /// # Errors
    /// Bad ids or parameters, `SESSION_EXISTS`, limits.
    pub async fn create_session(&self, tenant: &str, new: NewSession) -> Result<String> {
        let id = match new.id {
            Some(id) => id,
            None => fresh_id(),
        };
        check_id("session_id", &id)?;
        if new.sensors.len() > self.limits.max_sensors_per_session {
            let message =
                format!("{} sensors, the limit is {}", new.sensors.len(), self.limits.max_sensors_per_session);
            return Err(Error::exhausted(reason::TOO_MANY_SENSORS, "sensors", message));
        }
        let mut sensors = new.sensors;
        sensors.sort_by(|a, b| a.spec.id.cmp(&b.spec.id));
        if let Some(pair) = sensors.windows(2).find(|p| p[0].spec.id == p[1].spec.id) {
            let message = format!("sensor_id {:?} is declared twice; names are unique in a session", pair[0].spec.id.0);
            return Err(Error::invalid(reason::SENSOR_DECLARED_TWICE, "sensors", message));
        }
        new.params.validate().map_err(|e| super::params_error(&e))?;
        // Until it is written that the session names it.
        let _named = self.registry.naming(!new.params.detection.learned.is_empty()).await;
        super::check_learned(&new.params, &self.registry.shelf.of_tenant(tenant))?;
        check_display_name(&new.display_name)?;
        check_labels(&new.labels)?;
        let meta = SessionMeta {
            id,
            tenant: tenant.to_owned(),
            display_name: new.display_name,
            labels: new.labels,
            mode: new.mode,
            create_time_ns: now_ns(),
            request_id: new.request_id,
            params: new.params,
            sensors,
            zones: Vec::new(),
            zone_masks: Vec::new(),
            room_names: Vec::new(),
            class_examples: Vec::new(),
            revision: 0,
        };
        self.registry.create(meta).await
    }

    /// A session, woken if it slept.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn session(&self, id: &str) -> Result<Arc<Session>> {
        check_id("session_id", id)?;
        self.registry.get(id).await
    }

    /// What can be said of a session without waking it.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn view_session(&self, id: &str) -> Result<SessionView> {
        check_id("session_id", id)?;
        self.registry.view(id).await
    }

    /// Everything that can be said of a session without waking it; of one whose data cannot be read, less.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`; faults of the storage.
    pub async fn describe_session(&self, id: &str) -> Result<SessionDescription> {
        let view = self.view_session(id).await?;
        if view.fault.is_some() && view.live.is_none() {
            return Ok(SessionDescription { view, whole: None });
        }
        let whole = Some((self.session_meta(id).await?, self.list_sensors(id).await?));
        Ok(SessionDescription { view, whole })
    }

    /// What a session was created with and what was changed since, without waking it.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `SESSION_FAULTED` if that cannot be read; faults of the storage.
    pub async fn session_meta(&self, id: &str) -> Result<SessionMeta> {
        check_id("session_id", id)?;
        self.registry.meta(id).await
    }

    /// Events of a session, awake or not.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn session_events(&self, id: &str) -> Result<Arc<EventLog>> {
        check_id("session_id", id)?;
        self.registry.events(id)
    }

    /// Sessions that fit `list`, of those that `is_visible`, without waking any. By default in the order of ids; a list by
    /// labels, or in another order, looks at all sessions for each page.
    ///
    /// # Errors
    /// `PAGE_TOKEN_INVALID`.
    pub async fn list_sessions(
        &self,
        list: &SessionList,
        is_visible: impl Fn(&SessionView) -> bool,
    ) -> Result<Page<SessionView>> {
        let is_wanted = |view: &SessionView| is_visible(view) && list.wants(view);
        if list.order == SessionOrder::default() && list.labels.is_empty() {
            return Ok(self.list_by_id(list.page_size, &list.page_token, is_wanted).await);
        }
        let all = self.registry.list_all(is_wanted).await;
        page_in_order(all.into_iter().filter(|view| list.has_labels(view)).collect(), list)
    }

    async fn list_by_id(&self, size: u32, token: &str, is_wanted: impl Fn(&SessionView) -> bool) -> Page<SessionView> {
        let size = page_size(size);
        let mut items = self.registry.list(token, size + 1, is_wanted).await;
        let is_last = items.len() <= size;
        items.truncate(size);
        let last = items.last().filter(|_| !is_last);
        let next_page_token = last.map(|view| view.id.clone()).unwrap_or_default();
        Page { items, next_page_token }
    }

    /// Keyframes that the map is made of, by number.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `PAGE_TOKEN_INVALID`.
    pub async fn list_keyframes(&self, session: &str, page_size: u32, page_token: &str) -> Result<Page<KeyframeInfo>> {
        let snapshot = self.snapshot(session).await?;
        let living: Vec<KeyframeInfo> = snapshot.living_keyframes().cloned().collect();
        page_by_number(&living, |k| k.id.0, page_size, page_token)
    }

    /// Deletes a session with all that is stored for it.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, faults of the storage.
    pub async fn delete_session(&self, id: &str) -> Result<()> {
        check_id("session_id", id)?;
        self.registry.delete(id).await
    }

    /// How many sessions are in each state.
    pub fn count_sessions(&self) -> std::collections::HashMap<SessionState, usize> {
        self.registry.census()
    }
}

/// An id that no other session of this server has: the time, and a counter for calls within a tick.
pub(crate) fn fresh_id() -> String {
    use std::sync::atomic::{AtomicU32, Ordering};
    static COUNTER: AtomicU32 = AtomicU32::new(0);
    format!("s-{:x}-{:x}", now_ns(), COUNTER.fetch_add(1, Ordering::Relaxed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_join_to_the_whole_list() {
        let all: Vec<u64> = (0..250).map(|i| i * 3).collect();
        let (mut joined, mut token) = (vec![], String::new());
        loop {
            let page = page_by_number(&all, |n| *n, 100, &token).unwrap();
            joined.extend(page.items);
            if page.next_page_token.is_empty() {
                break;
            }
            token = page.next_page_token;
        }
        assert_eq!(joined, all);
        assert_eq!(page_by_number(&all, |n| *n, 0, "x").unwrap_err().reason, "PAGE_TOKEN_INVALID");
    }
}
