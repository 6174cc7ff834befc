//! Objects, and what people say of them.

use super::rooms::refused;
use super::sessions::{Page, page_by_number, page_size};
use crate::session::command::Corrected;
use crate::session::handle::Session;
use crate::{Error, ErrorCode, Result, Service, check_id, reason};
use percept_geometry::ObjectClass;
use percept_pipeline::Snapshot;
use percept_scene::rooms::RoomId;
use percept_scene::{Correction, CorrectionError, Object, ObjectFilter, ObjectId, ObjectState};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Examples of classes in a session, at most: each takes 64 bytes, and a search looks at classes alone.
const MAX_EXAMPLES: usize = 10_000;
/// Classes that are learned from examples, at most: each costs a search some microseconds a thing.
const MAX_LEARNED: usize = 200;

/// Which objects are listed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ObjectQuery {
    /// What has to hold.
    pub filter: ObjectFilter,
    /// Only those in this room.
    pub room: Option<RoomId>,
    /// Those that people deleted, and parts of others, too.
    pub include_set_aside: bool,
}

/// A class of objects in a session.
#[derive(Debug, Clone, PartialEq)]
pub struct ClassInfo {
    /// The class.
    pub class: ObjectClass,
    /// Known without examples.
    pub is_built_in: bool,
    /// Examples that people gave.
    pub num_examples: usize,
    /// Objects of it that are told and not gone.
    pub num_objects: usize,
}

impl Service {
    /// The newest snapshot of a session.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn snapshot(&self, session: &str) -> Result<Arc<Snapshot>> {
        Ok(self.session(session).await?.snapshot())
    }

    /// Objects by id, or by distance, with the version of the map that their boxes refer to.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `PAGE_TOKEN_INVALID`, `FILTERS_INVALID`, `ROOM_NOT_FOUND`.
    pub async fn list_objects(
        &self,
        session: &str,
        query: ObjectQuery,
        size: u32,
        page_token: &str,
    ) -> Result<(Page<Object>, u64)> {
        if query.filter.near.is_some() && !page_token.is_empty() {
            let message = "the nearest objects are one page; leave page_token out, or ask without near";
            return Err(Error::invalid(reason::PAGE_TOKEN_INVALID, "page_token", message));
        }
        if query.include_set_aside && query.filter.at.is_some() {
            let message = "what people set aside is not known by time; leave out at_ns or include_set_aside";
            return Err(Error::invalid(reason::FILTERS_INVALID, "include_set_aside", message));
        }
        let snapshot = self.snapshot(session).await?;
        let (map_version, max_cells) = (snapshot.map_version, self.limits.max_planning_cells);
        let is_by_distance = query.filter.near.is_some();
        let select = move || {
            let mut found = if query.include_set_aside {
                // Listed ones as they are told, with what was merged into them.
                let listed = |o: &Object| snapshot.objects.binary_search_by_key(&o.id, |l| l.id).ok();
                let told = |o: &Object| listed(o).map_or(o, |i| &snapshot.objects[i]).clone();
                query.filter.of(&snapshot.tracked.iter().map(told).collect::<Vec<_>>())
            } else {
                query.filter.of(&snapshot.objects)
            };
            if let Some(room) = query.room {
                let rooms = snapshot.rooms(max_cells).map_err(refused)?;
                rooms.get(room).ok_or_else(|| super::rooms::unknown(room.0))?;
                found.retain(|o| rooms.at(&o.bbox.center().xy()).is_some_and(|r| r.id == room));
            }
            Ok::<_, Error>(found)
        };
        let mut found = self.compute.query(&self.asker(session)?, select).await??;
        let page = if is_by_distance {
            found.truncate(page_size(size));
            Page { items: found, next_page_token: String::new() }
        } else {
            page_by_number(&found, |o| o.id.0, size, page_token)?
        };
        Ok((page, map_version))
    }

    /// One object, also one that people set aside.
    ///
    /// # Errors
    /// `OBJECT_NOT_FOUND`, `SESSION_NOT_FOUND`.
    pub async fn object(&self, session: &str, id: u64) -> Result<Object> {
        let snapshot = self.snapshot(session).await?;
        let of = |objects: &[Object]| objects.iter().find(|o| o.id.0 == id).cloned();
        of(&snapshot.objects).or_else(|| of(&snapshot.tracked)).ok_or_else(|| unknown("object_id", id))
    }

    /// Does as a person says of an object; the object, those that it made or changed, and the version of the map. Durable when this
    /// answers. `learn`: what looks like it is taken for the class, too.
    ///
    /// # Errors
    /// `OBJECT_NOT_FOUND`, `CORRECTION_INVALID`, `OBJECT_NOT_IN_MAP`, `TOO_MANY_EXAMPLES`, `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn correct_object(
        &self,
        session: &str,
        id: u64,
        correction: Correction,
        learn: bool,
    ) -> Result<(Vec<Object>, u64)> {
        check_id("session_id", session)?;
        let example = if learn { Some(self.example(session, id, &correction).await?) } else { None };
        let correct = |s: Arc<Session>| {
            let correction = correction.clone();
            async move {
                let done = s.correct(ObjectId(id), correction).await?.map_err(|e| correction_error(id, &e))?;
                s.wait_durable(done.moved.ticket).await.map(|()| done)
            }
        };
        let Corrected { ids, moved } = self.registry.awake(session, correct).await?;
        if let Some(example) = example {
            self.registry
                .change(session, move |_, meta| {
                    let classes = meta.class_examples.iter().map(|e| e.class).chain([example.class]);
                    let num_classes = classes.collect::<std::collections::BTreeSet<_>>().len();
                    if meta.class_examples.len() >= MAX_EXAMPLES || num_classes > MAX_LEARNED {
                        let message = format!(
                            "{MAX_EXAMPLES} examples of at most {MAX_LEARNED} classes are kept; forget a class. The label is set."
                        );
                        return Err(Error::exhausted(reason::TOO_MANY_EXAMPLES, "learn", message));
                    }
                    meta.class_examples.push(example);
                    Ok(None)
                })
                .await?;
        }
        let snapshot = self.snapshot(session).await?;
        let is_changed = |o: &&Object| ids.binary_search(&o.id).is_ok();
        let told = |o: &Object| snapshot.objects.iter().find(|t| t.id == o.id).unwrap_or(o).clone();
        Ok((snapshot.tracked.iter().filter(is_changed).map(told).collect(), moved.map_version))
    }

    async fn example(
        &self,
        session: &str,
        id: u64,
        correction: &Correction,
    ) -> Result<percept_perception::detection::ClassExample> {
        let Correction::Class(Some(class)) = *correction else {
            let message = "a class is learned from a label; give one, or leave learn out";
            return Err(Error::invalid(reason::CORRECTION_INVALID, "learn", message));
        };
        let snapshot = self.snapshot(session).await?;
        if !snapshot.tracked.iter().any(|o| o.id.0 == id) {
            return Err(unknown("object_id", id));
        }
        let found =
            self.compute.query(&self.asker(session)?, move || snapshot.class_example(ObjectId(id), class)).await?;
        found.ok_or_else(|| {
            let message = format!(
                "object {id} is not found in the map as it is now, so that nothing can be learned from it; label it without learn"
            );
            Error { field: "learn".into(), ..Error::new(ErrorCode::FailedPrecondition, reason::OBJECT_NOT_IN_MAP, message) }
        })
    }

    /// Classes that objects of a session may have, or have: built-in ones first, then by name.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`.
    pub async fn object_classes(&self, session: &str) -> Result<Vec<ClassInfo>> {
        let session = self.session(session).await?;
        let (snapshot, meta) = (session.snapshot(), session.meta());
        let mut counts: BTreeMap<ObjectClass, (usize, usize)> =
            ObjectClass::BUILT_IN.into_iter().map(|class| (class, (0, 0))).collect();
        meta.class_examples.iter().for_each(|e| counts.entry(e.class).or_default().0 += 1);
        let there = snapshot.objects.iter().filter(|o| o.state != ObjectState::Gone);
        there.for_each(|o| counts.entry(o.class).or_default().1 += 1);
        let info = |(class, (num_examples, num_objects))| {
            let is_built_in = !matches!(class, ObjectClass::Named(_));
            ClassInfo { class, is_built_in, num_examples, num_objects }
        };
        Ok(counts.into_iter().map(info).collect())
    }

    /// Forgets what was learned of a class: how many examples there were. Labels that people gave stay.
    ///
    /// # Errors
    /// `CLASS_NOT_FOUND`, `SESSION_NOT_FOUND`, `STORAGE_FAULT`.
    pub async fn forget_object_class(&self, session: &str, class: ObjectClass) -> Result<usize> {
        let num = std::sync::atomic::AtomicUsize::new(0);
        self.registry
            .change(session, |_, meta| {
                let before = meta.class_examples.len();
                meta.class_examples.retain(|e| e.class != class);
                let forgotten = before - meta.class_examples.len();
                num.store(forgotten, std::sync::atomic::Ordering::Relaxed);
                if forgotten == 0 {
                    let message =
                        format!("no examples of {:?} were given in this session; list its classes", class.name());
                    return Err(Error::not_found(reason::CLASS_NOT_FOUND, "label", message));
                }
                Ok(None)
            })
            .await?;
        Ok(num.into_inner())
    }
}

fn unknown(field: &str, id: u64) -> Error {
    let message = format!("{field} {id} does not exist in this session; list the objects");
    Error::not_found(reason::OBJECT_NOT_FOUND, field, message)
}

fn correction_error(id: u64, error: &CorrectionError) -> Error {
    let invalid = |field: &str| Error::invalid(reason::CORRECTION_INVALID, field, error.to_string());
    match error {
        CorrectionError::Unknown(ObjectId(missing)) if *missing == id => unknown("object_id", id),
        CorrectionError::Unknown(ObjectId(missing)) => unknown("part_of", *missing),
        CorrectionError::PartOfItself(_) | CorrectionError::NoWhole(_) => invalid("part_of"),
        CorrectionError::Deleted(_) => invalid("object_id"),
        CorrectionError::Pieces(_) => invalid("pieces"),
        CorrectionError::Box(i) | CorrectionError::Elsewhere { index: i, .. } => invalid(&format!("pieces.boxes[{i}]")),
        CorrectionError::TooMany { .. } => invalid("pieces"),
    }
}
