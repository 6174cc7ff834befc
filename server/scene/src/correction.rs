//! What a person says of an object, and what then changes.

use crate::track::Track;
use crate::{Object, ObjectChange, ObjectChangeKind, ObjectId, ObjectState, Tracker, overlap};
use percept_geometry::{ObjectClass, OrientedBox3};

/// Boxes that an object can be split into, at most.
pub const MAX_PIECES: usize = 16;
/// A piece reaches out of what was seen of the thing by less, metres: a bed's foot end, say.
const PIECE_OFF_M: f64 = 1.0;

/// What a person says of an object.
#[derive(Debug, Clone, PartialEq)]
pub enum Correction {
    /// What it is; none takes back what was said.
    Class(Option<ObjectClass>),
    /// It is no thing.
    Delete,
    /// It is a thing of its own after all. If it was split, its pieces are forgotten.
    Restore,
    /// It is a part of that object.
    PartOf(ObjectId),
    /// It is so many things: their upright boxes, map frame, metres. It is deleted itself, and its class is theirs.
    Split(Vec<OrientedBox3>),
}

/// Why a correction cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CorrectionError {
    /// There is no such object.
    #[error("object {0} does not exist")]
    Unknown(ObjectId),
    /// An object cannot be a part of itself.
    #[error("object {0} cannot be a part of itself")]
    PartOfItself(ObjectId),
    /// The whole is deleted, or a part of another.
    #[error("object {0} is deleted or a part of another: nothing can be a part of it")]
    NoWhole(ObjectId),
    /// It is no thing any more.
    #[error("object {0} is deleted, or was split before; restore it first")]
    Deleted(ObjectId),
    /// Too few or too many boxes.
    #[error("{0} boxes: a thing is split into 2 to {MAX_PIECES}")]
    Pieces(usize),
    /// A box that cannot be.
    #[error("box {0} is not finite, or has an edge that is not from 1 mm to 10 km")]
    Box(usize),
    /// A piece that lies elsewhere.
    #[error("box {index} is {off_m:.1} m away from the thing; pieces lie within it: give boxes in the map frame")]
    Elsewhere {
        /// Which.
        index: usize,
        /// From the thing's box, metres.
        off_m: f64,
    },
    /// The list is at its limit.
    #[error("{limit} objects are followed, the limit")]
    TooMany {
        /// `max_objects`.
        limit: usize,
    },
}

impl Tracker {
    /// Does as a person says, and tells what changed, ascending by object.
    ///
    /// # Errors
    /// [`CorrectionError`]; nothing was changed.
    pub fn annotate(&mut self, id: ObjectId, correction: Correction) -> Result<Vec<ObjectChange>, CorrectionError> {
        let index = self.index_of(id)?;
        let change = |id, kind| ObjectChange { id, kind };
        let mut changes = Vec::new();
        match correction {
            Correction::Class(class) => {
                let from = self.tracks[index].class().0;
                self.tracks[index].annotation.class = class;
                let to = self.tracks[index].class().0;
                if from != to {
                    self.tracks[index].remember();
                    changes.push(change(id, ObjectChangeKind::Reclassified { from, to }));
                }
            }
            Correction::Delete => {
                changes
                    .extend(self.tracks[index].annotation.is_listed().then(|| change(id, ObjectChangeKind::Forgotten)));
                self.set_aside(index);
            }
            Correction::Restore => {
                let annotation = &mut self.tracks[index].annotation;
                let was_listed = annotation.is_listed();
                (annotation.is_deleted, annotation.part_of) = (false, None);
                changes.extend((!was_listed).then(|| change(id, ObjectChangeKind::Appeared)));
                for piece in self.take_back_pieces(id) {
                    changes.push(change(piece, ObjectChangeKind::Forgotten));
                }
            }
            Correction::PartOf(whole) => {
                let of = self.index_of(whole)?;
                if whole == id {
                    return Err(CorrectionError::PartOfItself(id));
                }
                if !self.tracks[of].annotation.is_listed() {
                    return Err(CorrectionError::NoWhole(whole));
                }
                for track in self.tracks.iter_mut().filter(|t| t.annotation.part_of == Some(id)) {
                    track.annotation.part_of = Some(whole);
                }
                let annotation = &mut self.tracks[index].annotation;
                (annotation.is_deleted, annotation.part_of) = (false, Some(whole));
                changes.push(change(id, ObjectChangeKind::Merged { into: whole }));
                changes.push(change(whole, ObjectChangeKind::Updated));
            }
            Correction::Split(_) if self.tracks[index].annotation.is_deleted => {
                return Err(CorrectionError::Deleted(id));
            }
            Correction::Split(boxes) => {
                self.split(index, &boxes)?;
                changes.push(change(id, ObjectChangeKind::Forgotten));
                let ids = self.next_id() - boxes.len() as u64..self.next_id();
                changes.extend(ids.map(|piece| change(ObjectId(piece), ObjectChangeKind::Appeared)));
            }
        }
        changes.sort_by_key(|c| c.id);
        Ok(changes)
    }

    /// The objects as they are told: without what is deleted, parts within their wholes. Ascending by id.
    pub fn listed(&self) -> Vec<Object> {
        let all = self.objects();
        let mut listed: Vec<Object> = all.iter().filter(|o| o.annotation.is_listed()).cloned().collect();
        for part in all.iter().filter(|o| o.state != ObjectState::Gone && !o.annotation.is_deleted) {
            let Some(whole) = part.annotation.part_of else { continue };
            if let Ok(i) = listed.binary_search_by_key(&whole, |o| o.id) {
                listed[i].bbox = overlap::hull(&listed[i].bbox, &part.bbox);
            }
        }
        listed
    }

    fn index_of(&self, id: ObjectId) -> Result<usize, CorrectionError> {
        self.tracks.iter().position(|t| t.id == Some(id)).ok_or(CorrectionError::Unknown(id))
    }

    /// Deletes a track; its parts are things of their own again.
    fn set_aside(&mut self, index: usize) {
        let id = self.tracks[index].id;
        self.tracks[index].annotation.is_deleted = true;
        self.tracks[index].annotation.part_of = None;
        for track in self.tracks.iter_mut().filter(|t| t.annotation.part_of.is_some() && t.annotation.part_of == id) {
            track.annotation.part_of = None;
        }
    }

    /// Forgets the pieces that a thing was split into, and theirs, so that what is detected there is the whole again; which
    /// of them were told.
    fn take_back_pieces(&mut self, whole: ObjectId) -> Vec<ObjectId> {
        let (mut pieces, mut next) = (vec![], vec![whole]);
        while let Some(of) = next.pop() {
            let theirs = self.tracks.iter().filter(|t| t.annotation.piece_of == Some(of)).filter_map(|t| t.id);
            next.extend(theirs.clone());
            pieces.extend(theirs);
        }
        let is_piece = |id: Option<ObjectId>| id.is_some_and(|id| pieces.contains(&id));
        let told =
            self.tracks.iter().filter(|t| is_piece(t.id) && t.annotation.is_listed()).filter_map(|t| t.id).collect();
        self.tracks.retain(|t| !is_piece(t.id));
        for track in self.tracks.iter_mut().filter(|t| is_piece(t.annotation.part_of)) {
            track.annotation.part_of = None;
        }
        told
    }

    fn split(&mut self, index: usize, boxes: &[OrientedBox3]) -> Result<(), CorrectionError> {
        if !(2..=MAX_PIECES).contains(&boxes.len()) {
            return Err(CorrectionError::Pieces(boxes.len()));
        }
        let usable = |b: &OrientedBox3| {
            let placed = b.center().iter().all(|v| v.abs() <= 1e6);
            placed
                && b.t_frame_box.rotation.coords.iter().all(|v| v.is_finite())
                && b.size.iter().all(|s| (1e-3..=1e4).contains(s))
        };
        if let Some(i) = boxes.iter().position(|b| !usable(b)) {
            return Err(CorrectionError::Box(i));
        }
        // As it is told: with what was merged into it.
        let id = self.tracks[index].id;
        let parts = self.tracks.iter().filter(|t| id.is_some() && t.annotation.part_of == id);
        let whole = parts.fold(self.tracks[index].bbox, |whole, part| overlap::hull(&whole, &part.bbox));
        if let Some((index, off_m)) =
            boxes.iter().map(|b| overlap::gap(&whole, b)).enumerate().find(|(_, off)| *off > PIECE_OFF_M)
        {
            return Err(CorrectionError::Elsewhere { index, off_m });
        }
        let limit = self.params.max_objects;
        if self.tracks.len() + boxes.len() > limit {
            return Err(CorrectionError::TooMany { limit });
        }
        let whole = self.tracks[index].clone();
        self.set_aside(index);
        for bbox in boxes {
            let id = ObjectId(self.next_id);
            self.next_id += 1;
            self.tracks.push(Track::drawn(&whole, id, bbox));
        }
        Ok(())
    }
}
