//! Which objects somebody asks for.

use crate::{Object, ObjectState};
use nalgebra::Point3;
use percept_geometry::{Aabb3, ObjectClass, Timestamp};

/// All that is set has to hold.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ObjectFilter {
    /// The class.
    pub class: Option<ObjectClass>,
    /// A part of the class' name, upper and lower case alike; empty: any.
    pub text: String,
    /// Its middle lies in it, map frame, metres.
    pub region: Option<Aabb3>,
    /// It was seen then or later.
    pub seen_since: Option<Timestamp>,
    /// It was seen then or earlier.
    pub seen_until: Option<Timestamp>,
    /// What is gone, too.
    pub include_gone: bool,
    /// Objects as they were then.
    pub at: Option<Timestamp>,
    /// Nearest to there first, map frame, metres; else by number.
    pub near: Option<Point3<f64>>,
}

impl ObjectFilter {
    /// Those of `objects` that are asked for.
    pub fn of(&self, objects: &[Object]) -> Vec<Object> {
        let text = self.text.to_lowercase();
        let mut out: Vec<Object> = match self.at {
            Some(at) => objects.iter().filter_map(|o| o.at(at)).filter(|o| self.wants(o, &text)).collect(),
            None => objects.iter().filter(|o| self.wants(o, &text)).cloned().collect(),
        };
        if let Some(near) = self.near {
            let distance = |o: &Object| (o.bbox.center() - near).norm();
            out.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.id.cmp(&b.id)));
        }
        out
    }

    /// Whether an object is asked for, as it is.
    pub fn fits(&self, o: &Object) -> bool {
        self.wants(o, &self.text.to_lowercase())
    }

    fn wants(&self, o: &Object, text: &str) -> bool {
        self.class.is_none_or(|class| class == o.class)
            && (self.include_gone || o.state != ObjectState::Gone)
            && (text.is_empty() || o.class.name().contains(text))
            && self.region.is_none_or(|region| region.contains(&o.bbox.center()))
            && self.seen_since.is_none_or(|since| o.last_seen >= since)
            && self.seen_until.is_none_or(|until| o.first_seen <= until)
    }
}
