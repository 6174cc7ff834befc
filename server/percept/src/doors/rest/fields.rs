//! Fields of a request from the words of a path and a query string.

use super::refused::Refused;
use axum::extract::Query;
use axum::http::Uri;
use percept_service::Error;
use percept_service::reason;
use prost_reflect::{DynamicMessage, EnumDescriptor, FieldDescriptor, Kind, MessageDescriptor, ReflectMessage, Value};

/// Names in a query string that are no field: they choose the form of the answer.
const FORM: &str = "format";

/// Every scalar of a request, and every list of scalars, by its dotted path.
pub(super) fn leaves(message: &MessageDescriptor) -> Vec<(String, FieldDescriptor)> {
    let mut out = vec![];
    for field in message.fields().filter(|f| !f.is_map()) {
        match field.kind() {
            Kind::Message(_) if field.is_list() => {}
            Kind::Message(inner) => {
                out.extend(leaves(&inner).into_iter().map(|(path, f)| (format!("{}.{path}", field.name()), f)));
            }
            _ => out.push((field.name().to_owned(), field)),
        }
    }
    out
}

fn pairs(uri: &Uri) -> Result<Vec<(String, String)>, Error> {
    let read = Query::<Vec<(String, String)>>::try_from_uri(uri);
    Ok(read.map_err(|e| Error::invalid(reason::QUERY_INVALID, "", format!("the query cannot be read: {e}")))?.0)
}

/// Refuses a query where the body says everything.
pub(super) fn no_query(uri: &Uri) -> Result<(), Refused> {
    let Some((name, _)) = pairs(uri)?.into_iter().next() else { return Ok(()) };
    let message = format!("{name} stands in the query; this request says everything in its body");
    Err(Error::invalid(reason::QUERY_INVALID, name, message).into())
}

/// A request of the query's words; `allowed` are the dotted paths that may occur.
///
/// # Errors
/// `QUERY_INVALID` naming the field: unknown, given twice, or of another kind.
pub(super) fn from_query(message: MessageDescriptor, uri: &Uri, allowed: &[String]) -> Result<DynamicMessage, Refused> {
    let mut request = DynamicMessage::new(message);
    let pairs = pairs(uri)?;
    for (i, (name, text)) in pairs.iter().enumerate() {
        let refuse = |words: String| Error::invalid(reason::QUERY_INVALID, name.as_str(), words);
        if !allowed.iter().any(|a| a == name) {
            let known = if allowed.is_empty() { "none".to_owned() } else { allowed.join(", ") };
            return Err(refuse(format!("{name} is not a parameter of this request; there are: {known}")).into());
        }
        let is_list = request.descriptor().get_field_by_name(name).is_some_and(|field| field.is_list());
        if !is_list && pairs[..i].iter().any(|(earlier, _)| earlier == name) {
            return Err(refuse(format!("{name} is given twice; give it once")).into());
        }
        // A field of that name is the request's own.
        if name != FORM || request.descriptor().get_field_by_name(FORM).is_some() {
            set(&mut request, name, text).map_err(|wanted| refuse(not_as_wanted(name, text, &wanted)))?;
        }
    }
    Ok(request)
}

/// The paths of a mask, `name` of the query, with commas between them. Nothing else may be in the query.
///
/// # Errors
/// `QUERY_INVALID`.
pub(super) fn mask(uri: &Uri, name: &str) -> Result<Option<Vec<String>>, Refused> {
    let pairs = pairs(uri)?;
    if let Some((other, _)) = pairs.iter().find(|(n, _)| n != name) {
        let message = format!("{other} is not a parameter of this request; there are: {name}");
        return Err(Error::invalid(reason::QUERY_INVALID, other.as_str(), message).into());
    }
    if pairs.len() > 1 {
        let message = format!("{name} is given twice; give it once, with commas between the paths");
        return Err(Error::invalid(reason::QUERY_INVALID, name, message).into());
    }
    let paths = pairs.first().map(|(_, text)| text.split(',').map(|path| path.trim().to_owned()).collect());
    Ok(paths)
}

/// The word that the query gives for the form of the answer.
pub(super) fn form(uri: &Uri) -> Result<Option<String>, Refused> {
    Ok(pairs(uri)?.into_iter().find(|(name, _)| name == FORM).map(|(_, text)| text))
}

/// Sets the field at a dotted path from a word of the path; the body may leave it out or repeat it.
///
/// # Errors
/// `PATH_INVALID`, `PATH_MISMATCH` if the body says something else.
pub(super) fn fill_from_path(message: &mut DynamicMessage, name: &str, field: &str, text: &str) -> Result<(), Error> {
    let said = at(message, field);
    set(message, field, text)
        .map_err(|wanted| Error::invalid(reason::PATH_INVALID, name, not_as_wanted(name, text, &wanted)))?;
    if said.is_some() && said != at(message, field) {
        let message = format!("{field} in the body is not the {name} of the path; leave it out, or give the same");
        return Err(Error::invalid(reason::PATH_MISMATCH, field, message));
    }
    Ok(())
}

fn not_as_wanted(name: &str, text: &str, wanted: &str) -> String {
    let shown: String = text.chars().take(80).collect();
    format!("{name} is {shown:?}; it must be {wanted}")
}

/// What stands at a dotted path, if something does.
fn at(message: &DynamicMessage, path: &str) -> Option<Value> {
    let (name, rest) = path.split_once('.').map_or((path, None), |(name, rest)| (name, Some(rest)));
    let field = message.descriptor().get_field_by_name(name).filter(|f| message.has_field(f))?;
    let value = message.get_field(&field);
    match rest {
        None => Some(value.into_owned()),
        Some(rest) => at(value.as_message()?, rest),
    }
}

/// Sets a field; the error says what it must be.
fn set(message: &mut DynamicMessage, path: &str, text: &str) -> Result<(), String> {
    let (name, rest) = path.split_once('.').map_or((path, None), |(name, rest)| (name, Some(rest)));
    let unknown = || "a field of the request".to_owned();
    let field = message.descriptor().get_field_by_name(name).ok_or_else(unknown)?;
    match rest {
        None => {
            let value = parse(&field.kind(), text)?;
            match message.get_field_mut(&field).as_list_mut() {
                Some(list) => list.push(value),
                None => message.set_field(&field, value),
            }
            Ok(())
        }
        Some(rest) => set(message.get_field_mut(&field).as_message_mut().ok_or_else(unknown)?, rest, text),
    }
}

fn parse(kind: &Kind, text: &str) -> Result<Value, String> {
    let value = match kind {
        Kind::String => Some(Value::String(text.to_owned())),
        Kind::Bool => text.parse().ok().map(Value::Bool),
        Kind::Double => text.parse().ok().filter(|v: &f64| v.is_finite()).map(Value::F64),
        Kind::Float => text.parse().ok().filter(|v: &f32| v.is_finite()).map(Value::F32),
        Kind::Int32 | Kind::Sint32 | Kind::Sfixed32 => text.parse().ok().map(Value::I32),
        Kind::Int64 | Kind::Sint64 | Kind::Sfixed64 => text.parse().ok().map(Value::I64),
        Kind::Uint32 | Kind::Fixed32 => text.parse().ok().map(Value::U32),
        Kind::Uint64 | Kind::Fixed64 => text.parse().ok().map(Value::U64),
        Kind::Enum(kind) => named(kind, text).map(Value::EnumNumber),
        Kind::Bytes | Kind::Message(_) => None,
    };
    value.ok_or_else(|| match kind {
        Kind::Bool => "true or false".to_owned(),
        Kind::Double | Kind::Float => "a finite number".to_owned(),
        Kind::Uint32 | Kind::Fixed32 => "a whole number from 0 to 4294967295".to_owned(),
        Kind::Uint64 | Kind::Fixed64 => "a whole number from 0 to 18446744073709551615".to_owned(),
        Kind::Enum(kind) => format!("one of {}", short_names(kind).join(", ")),
        Kind::Bytes | Kind::Message(_) => "given in a body".to_owned(),
        _ => "a whole number".to_owned(),
    })
}

/// Values of an enum without the enum's name before them, lower case: `chair` for `OBJECT_CLASS_CHAIR`.
pub(super) fn short_names(kind: &EnumDescriptor) -> Vec<String> {
    let mut prefix = String::new();
    for c in kind.name().chars() {
        if c.is_ascii_uppercase() && !prefix.is_empty() {
            prefix.push('_');
        }
        prefix.push(c.to_ascii_uppercase());
    }
    prefix.push('_');
    let short = |name: &str| name.strip_prefix(&prefix).unwrap_or(name).to_ascii_lowercase();
    kind.values().map(|v| short(v.name())).collect()
}

fn named(kind: &EnumDescriptor, text: &str) -> Option<i32> {
    let whole = kind.values().find(|v| v.name() == text);
    let found = whole.or_else(|| kind.values().zip(short_names(kind)).find(|(_, short)| short == text).map(|(v, _)| v));
    found.map(|v| v.number())
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_wire::{json, v1};

    fn read<M: prost::Message + Default>(name: &str, query: &str) -> Option<M> {
        let message = json::descriptor(name).unwrap();
        let allowed: Vec<String> = leaves(&message).into_iter().map(|(path, _)| path).collect();
        let uri: Uri = format!("/x?{query}").parse().unwrap();
        from_query(message, &uri, &allowed).ok().map(|m| m.transcode_to().unwrap())
    }

    #[test]
    fn words_become_fields_of_their_kind() {
        let r: v1::ListObjectsRequest =
            read("ListObjectsRequest", "page_size=7&object_class=chair&include_gone=true").unwrap();
        assert_eq!((r.page_size, r.object_class(), r.include_gone), (7, v1::ObjectClass::Chair, true));
        let r: v1::ListObjectsRequest = read("ListObjectsRequest", "object_class=OBJECT_CLASS_TABLE").unwrap();
        assert_eq!(r.object_class(), v1::ObjectClass::Table);
        let r: v1::GetOccupancyGridRequest =
            read("GetOccupancyGridRequest", "region.min.x=-1.5&region.max.y=2&resolution_m=0.1").unwrap();
        let region = r.region.unwrap();
        assert_eq!((region.min.unwrap().x, region.max.unwrap().y, r.resolution_m), (-1.5, 2.0, Some(0.1)));
        let r: v1::WatchSessionRequest = read("WatchSessionRequest", "").unwrap();
        assert_eq!(r.resume_token, None);
        let r: v1::WatchSessionRequest = read("WatchSessionRequest", "resume_token=0").unwrap();
        assert_eq!(r.resume_token, Some(0));
        let r: v1::WatchSessionsRequest = read("WatchSessionsRequest", "kinds=pose&kinds=life").unwrap();
        assert_eq!(r.kinds, [1, 6]);
    }

    #[test]
    fn words_that_do_not_fit_are_refused() {
        let bad = [
            "page_size=-1",
            "page_size=many",
            "object_class=sofa",
            "include_gone=1",
            "colour=red",
            "page_size=1&page_size=1",
        ];
        for query in bad {
            assert!(read::<v1::ListObjectsRequest>("ListObjectsRequest", query).is_none(), "{query}");
        }
        for query in ["resolution_m=NaN", "resolution_m=", "region.min=1"] {
            assert!(read::<v1::GetOccupancyGridRequest>("GetOccupancyGridRequest", query).is_none(), "{query}");
        }
    }

    #[test]
    fn the_path_fills_what_the_body_leaves_out() {
        let mut request = DynamicMessage::new(json::descriptor("PlanPathRequest").unwrap());
        fill_from_path(&mut request, "session_id", "source.session_id", "a").unwrap();
        fill_from_path(&mut request, "session_id", "source.session_id", "a").unwrap();
        assert!(fill_from_path(&mut request, "session_id", "source.session_id", "b").is_err());
        let mut request = DynamicMessage::new(json::descriptor("GetObjectRequest").unwrap());
        assert!(fill_from_path(&mut request, "object_id", "object_id", "seven").is_err());
    }
}
