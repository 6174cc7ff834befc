//! Whether a JSON text has its values in the kinds that the OpenAPI document says.
//!
//! Protobuf's own reading takes null for any default, numbers for names and for 64-bit integers, and text for numbers. Here
//! each kind has one spelling: a 64-bit number that went through a JavaScript engine is no longer the one that was meant, and
//! null is no default that somebody chose.

use prost_reflect::{FieldDescriptor, Kind, MessageDescriptor};
use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::Value;

/// Checks a text without keeping it.
///
/// # Errors
/// What the parser finds; what a value should have been.
pub(super) fn check(message: &MessageDescriptor, text: &[u8]) -> serde_json::Result<()> {
    let mut reader = serde_json::Deserializer::from_slice(text);
    Shape::One(Kind::Message(message.clone())).deserialize(&mut reader)?;
    reader.end()
}

/// Path of the first value of another kind, and what it should have been.
pub(super) fn first_misfit(message: &MessageDescriptor, value: &Value) -> Option<(String, String)> {
    walk(&Shape::One(Kind::Message(message.clone())), value).map(|(path, words)| (path, words.to_owned()))
}

/// What a value should be.
#[derive(Clone)]
enum Shape {
    One(Kind),
    List(Kind),
    Map(Kind),
    /// Of a field that does not exist, or of a type with a JSON of its own: somebody else judges that.
    Anything,
}

/// What a value is.
#[derive(Clone, Copy, PartialEq)]
enum Given {
    Nothing,
    Truth,
    /// Its value, if it is a whole one of 32 bits.
    Number(Option<i32>),
    Text,
    /// NaN, Infinity or -Infinity.
    NotFinite,
    List,
    Object,
}

impl Given {
    fn text(text: &str) -> Self {
        if matches!(text, "NaN" | "Infinity" | "-Infinity") { Self::NotFinite } else { Self::Text }
    }
}

impl Shape {
    fn of(field: &FieldDescriptor) -> Self {
        match field.kind() {
            Kind::Message(entry) if field.is_map() => Self::Map(entry.map_entry_value_field().kind()),
            Kind::Message(known) if known.package_name() == "google.protobuf" => Self::Anything,
            kind if field.is_list() => Self::List(kind),
            kind => Self::One(kind),
        }
    }

    fn of_member(&self, name: &str) -> Self {
        match self {
            Self::One(Kind::Message(message)) => {
                let field = message.get_field_by_name(name).or_else(|| message.get_field_by_json_name(name));
                field.map_or(Self::Anything, |f| Self::of(&f))
            }
            Self::Map(kind) => Self::One(kind.clone()),
            _ => Self::Anything,
        }
    }

    fn of_item(&self) -> Self {
        if let Self::List(kind) = self { Self::One(kind.clone()) } else { Self::Anything }
    }

    /// What it should have been, if it is not.
    fn misfit(&self, given: Given) -> Option<&'static str> {
        use Given as G;
        let (fits, words) = match self {
            Self::Anything => (true, ""),
            _ if given == G::Nothing => (false, "null says nothing; leave the field out"),
            Self::List(_) => (given == G::List, "expected a list"),
            Self::Map(_) | Self::One(Kind::Message(_)) => (given == G::Object, "expected an object"),
            Self::One(Kind::Bool) => (given == G::Truth, "expected true or false"),
            Self::One(Kind::String | Kind::Bytes) => (matches!(given, G::Text | G::NotFinite), "expected text"),
            // A number that has no name here may have one in a newer contract: the operation says what of that.
            Self::One(Kind::Enum(choice)) => match given {
                G::Number(Some(number)) => (choice.get_value(number).is_none(), "expected a name"),
                _ => (given == G::Text, "expected a name"),
            },
            Self::One(Kind::Double | Kind::Float) => {
                (matches!(given, G::Number(_) | G::NotFinite), "expected a number")
            }
            Self::One(Kind::Int32 | Kind::Sint32 | Kind::Sfixed32 | Kind::Uint32 | Kind::Fixed32) => {
                (matches!(given, G::Number(_)), "expected a number")
            }
            Self::One(_) => (given == G::Text, "expected a whole number as text, since it may have 64 bits"),
        };
        (!fits).then_some(words)
    }

    fn checked<E: Error>(&self, given: Given) -> Result<(), E> {
        self.misfit(given).map_or(Ok(()), |words| Err(E::custom(words)))
    }
}

fn walk(shape: &Shape, value: &Value) -> Option<(String, &'static str)> {
    let given = match value {
        Value::Null => Given::Nothing,
        Value::Bool(_) => Given::Truth,
        Value::Number(number) => Given::Number(number.as_i64().and_then(|n| n.try_into().ok())),
        Value::String(text) => Given::text(text),
        Value::Array(_) => Given::List,
        Value::Object(_) => Given::Object,
    };
    if let Some(words) = shape.misfit(given) {
        return Some((String::new(), words));
    }
    let within = |outer: String, inner: Option<(String, &'static str)>| {
        let dotted = |path: String| if path.is_empty() || path.starts_with('[') { path } else { format!(".{path}") };
        inner.map(|(path, words)| (outer + &dotted(path), words))
    };
    match value {
        Value::Object(members) => {
            members.iter().find_map(|(name, inner)| within(name.clone(), walk(&shape.of_member(name), inner)))
        }
        Value::Array(items) => {
            let item = shape.of_item();
            items.iter().enumerate().find_map(|(i, inner)| within(format!("[{i}]"), walk(&item, inner)))
        }
        _ => None,
    }
}

impl<'de> DeserializeSeed<'de> for Shape {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, from: D) -> Result<(), D::Error> {
        from.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Shape {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        self.checked(Given::Nothing)
    }

    fn visit_bool<E: Error>(self, _: bool) -> Result<(), E> {
        self.checked(Given::Truth)
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<(), E> {
        self.checked(Given::Number(number.try_into().ok()))
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<(), E> {
        self.checked(Given::Number(number.try_into().ok()))
    }

    fn visit_f64<E: Error>(self, _: f64) -> Result<(), E> {
        self.checked(Given::Number(None))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<(), E> {
        self.checked(Given::text(text))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<(), A::Error> {
        self.checked(Given::List)?;
        let item = self.of_item();
        while items.next_element_seed(item.clone())?.is_some() {}
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<(), A::Error> {
        self.checked(Given::Object)?;
        while let Some(name) = members.next_key::<String>()? {
            match self.of_member(&name) {
                Self::Anything => members.next_value::<IgnoredAny>().map(|_| ())?,
                shape => members.next_value_seed(shape)?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_wire::json::descriptor;

    fn misfit(name: &str, text: &str) -> Option<(String, String)> {
        let message = descriptor(name).unwrap();
        let found = first_misfit(&message, &serde_json::from_str(text).unwrap());
        assert_eq!(check(&message, text.as_bytes()).is_err(), found.is_some(), "{text}");
        found
    }

    fn place(name: &str, text: &str) -> String {
        misfit(name, text).unwrap().0
    }

    #[test]
    fn each_kind_has_one_spelling() {
        let fine =
            r#"{"session_id": "a", "sensors": [{"kind": "SENSOR_KIND_IMU", "time_offset_s": 0.5}], "params": {}}"#;
        assert_eq!(misfit("CreateSessionRequest", fine), None);
        assert_eq!(misfit("SensorMessage", r#"{"stamp_ns": "1700000000000000000"}"#), None);
        assert_eq!(misfit("EstimateNormalsRequest", r#"{"radius_m": "Infinity", "max_neighbours": 9}"#), None);
        assert_eq!(place("SensorMessage", r#"{"stamp_ns": 1700000000000000000}"#), "stamp_ns");
        assert_eq!(place("EstimateNormalsRequest", r#"{"radius_m": "0.5"}"#), "radius_m");
        assert_eq!(place("EstimateNormalsRequest", r#"{"max_neighbours": "9"}"#), "max_neighbours");
        assert_eq!(place("EstimateNormalsRequest", r#"{"orientation": 1}"#), "orientation");
        assert_eq!(misfit("EstimateNormalsRequest", r#"{"orientation": 99}"#), None, "of a newer contract");
        assert_eq!(place("EstimateNormalsRequest", r#"{"keep_result": "true"}"#), "keep_result");
    }

    #[test]
    fn null_is_no_way_to_leave_a_field_out() {
        assert_eq!(place("CreateSessionRequest", r#"{"session_id": "a", "params": null}"#), "params");
        assert_eq!(place("CreateSessionRequest", r#"{"sensors": [{}, {"kind": null}]}"#), "sensors[1].kind");
        assert_eq!(place("CreateSessionRequest", r#"{"sensors": [null]}"#), "sensors[0]");
        assert_eq!(place("CreateSessionRequest", "null"), "");
        assert_eq!(place("CreateSessionRequest", "[1]"), "");
    }

    #[test]
    fn what_is_no_field_is_for_others_to_say() {
        assert_eq!(misfit("CreateSessionRequest", r#"{"nonsense": {"a": [1, null]}}"#), None);
    }
}
