//! Object classes: those of the built-in classifiers, and any other that people or models name.

use serde::{Deserialize, Serialize};

/// What an object is.
///
/// An open set: a name is a class. In JSON it is that name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum ObjectClass {
    /// A compact thing that fits no class.
    Unknown,
    /// Table or desk.
    Table,
    /// Chair.
    Chair,
    /// Shelf, cabinet or bookcase: tall and against a wall as a rule.
    Shelf,
    /// Box or crate.
    Box,
    /// Upright cylinder: bin, barrel, column.
    Cylinder,
    /// Person.
    Person,
    /// Car.
    Car,
    /// Van or minibus.
    Van,
    /// Truck.
    Truck,
    /// Bus.
    Bus,
    /// Bicycle with its rider.
    Cyclist,
    /// Motorcycle or scooter, with its rider if it has one.
    Motorcycle,
    /// What people or models call it; none of the names above.
    Named(ClassName),
}

/// Name of a class that is not built in: 1 to 31 bytes, lower case, without control characters.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ClassName {
    /// UTF-8, zeros after it.
    bytes: [u8; ClassName::MAX_BYTES],
    len: u8,
}

/// Why a text is no name of a class.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{text:?} is no name of a class: it takes 1 to {max} bytes without control characters",
    max = ClassName::MAX_BYTES
)]
pub struct ClassNameError {
    /// Its beginning.
    text: String,
}

impl ClassName {
    /// Bytes of a name, at most.
    pub const MAX_BYTES: usize = 31;

    /// The name.
    pub fn as_str(&self) -> &str {
        std::str::from_utf8(&self.bytes[..usize::from(self.len)]).unwrap_or_default()
    }
}

impl std::fmt::Debug for ClassName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.as_str().fmt(f)
    }
}

impl ObjectClass {
    /// All classes that are built in, `Unknown` first. New ones are added at the end: what was stored by earlier versions is a
    /// beginning of it.
    pub const BUILT_IN: [Self; 13] = [
        Self::Unknown,
        Self::Table,
        Self::Chair,
        Self::Shelf,
        Self::Box,
        Self::Cylinder,
        Self::Person,
        Self::Car,
        Self::Van,
        Self::Truck,
        Self::Bus,
        Self::Cyclist,
        Self::Motorcycle,
    ];

    /// The class of a name: white space around it is cut, and upper and lower case are alike.
    ///
    /// # Errors
    /// If it is empty, longer than [`ClassName::MAX_BYTES`], or has control characters.
    pub fn parse(name: &str) -> Result<Self, ClassNameError> {
        let refused = || ClassNameError { text: name.chars().take(ClassName::MAX_BYTES).collect() };
        let trimmed = name.trim();
        // Lower case may be longer than upper case, by a few bytes a letter at most.
        if trimmed.is_empty() || trimmed.len() > ClassName::MAX_BYTES || trimmed.chars().any(char::is_control) {
            return Err(refused());
        }
        let lower = trimmed.to_lowercase();
        if let Some(class) = Self::BUILT_IN.into_iter().find(|c| c.name() == lower) {
            return Ok(class);
        }
        let mut bytes = [0; ClassName::MAX_BYTES];
        bytes.get_mut(..lower.len()).ok_or_else(refused)?.copy_from_slice(lower.as_bytes());
        Ok(Self::Named(ClassName { bytes, len: lower.len() as u8 }))
    }

    /// Lower-case name, as in JSON.
    pub fn name(&self) -> &str {
        match self {
            Self::Unknown => "unknown",
            Self::Table => "table",
            Self::Chair => "chair",
            Self::Shelf => "shelf",
            Self::Box => "box",
            Self::Cylinder => "cylinder",
            Self::Person => "person",
            Self::Car => "car",
            Self::Van => "van",
            Self::Truck => "truck",
            Self::Bus => "bus",
            Self::Cyclist => "cyclist",
            Self::Motorcycle => "motorcycle",
            Self::Named(name) => name.as_str(),
        }
    }
}

impl std::fmt::Display for ObjectClass {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

impl From<ObjectClass> for String {
    fn from(class: ObjectClass) -> Self {
        class.name().to_owned()
    }
}

impl TryFrom<String> for ObjectClass {
    type Error = ClassNameError;

    fn try_from(name: String) -> Result<Self, ClassNameError> {
        Self::parse(&name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_a_class_and_a_built_in_one_is_itself() {
        assert_eq!(ObjectClass::parse(" Table "), Ok(ObjectClass::Table));
        let plant = ObjectClass::parse("Office Plant").unwrap();
        assert_eq!(plant.name(), "office plant");
        assert_eq!(plant, ObjectClass::parse("office plant").unwrap());
        for class in ObjectClass::BUILT_IN {
            assert_eq!(ObjectClass::parse(class.name()), Ok(class));
        }
    }

    #[test]
    fn stored_as_its_name() {
        let plant = ObjectClass::parse("büro-pflanze").unwrap();
        let json = serde_json::to_string(&[plant, ObjectClass::Cyclist]).unwrap();
        assert_eq!(json, r#"["büro-pflanze","cyclist"]"#);
        assert_eq!(serde_json::from_str::<[ObjectClass; 2]>(&json).unwrap(), [plant, ObjectClass::Cyclist]);
    }

    #[test]
    fn what_is_no_name_is_refused() {
        // Of the last one the lower case is longer than what fits.
        for bad in ["", "  ", "a\nb", "\u{0}", &"x".repeat(32), &"İ".repeat(15)] {
            assert!(ObjectClass::parse(bad).is_err(), "{bad:?}");
            assert!(serde_json::from_value::<ObjectClass>(bad.into()).is_err());
        }
    }
}
