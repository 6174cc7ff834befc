//! The OpenAPI 3.1 document, made of the table of routes and the contract's descriptors.

use super::comments::Comments;
use super::fields;
use super::files::FILES;
use super::pages::PAGES;
use super::patch::MASK;
use super::routes::{Bound, Kind as Answer, Verb};
use percept_service::caller::rules::{About, rule};
use percept_service::reason;
use percept_wire::json;
use prost_reflect::{EnumDescriptor, FieldDescriptor, Kind, MessageDescriptor, MethodDescriptor, OneofDescriptor};
use serde_json::{Map, Value, json};
use std::collections::BTreeSet;

const ABOUT: &str = "Spatial perception as a service. Every message is one of `percept.v1` in its canonical JSON form, \
with the proto's own field names: 64-bit integers are strings, bytes are base64, enums are names, absent optional fields \
are left out, and numbers that are not finite are the strings \"NaN\", \"Infinity\" and \"-Infinity\". Values of other \
kinds are refused, null as well. Bodies and \
answers may also be `application/x-protobuf`. A stream of sensor messages needs gRPC or zenoh.";

/// The document of these routes.
pub(super) fn document(routes: &[Bound]) -> Value {
    let comments = Comments::of_contract();
    let mut paths = Map::new();
    for bound in routes {
        let operations = paths.entry(bound.route.path).or_insert_with(|| json!({}));
        operations[bound.route.verb.name()] = operation(bound, &comments);
    }
    for page in PAGES {
        let answer = json!({"description": page.about, "content": {page.media_type: {"schema": page.schema()}}});
        let mut responses = json!({"200": answer});
        if page.path == "/readyz" || page.path == "/healthz" {
            responses["503"] = json!({"description": "Not ready; the body says why.", "content": answer["content"]});
        }
        paths.insert(
            page.path.to_owned(),
            json!({"get": {
                "tags": ["Server"], "summary": page.about, "operationId": page.id, "responses": responses,
            }}),
        );
    }
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "percept", "version": env!("CARGO_PKG_VERSION"), "description": ABOUT,
            "license": {"name": "Apache-2.0", "identifier": "Apache-2.0"},
        },
        "tags": tags(&comments),
        "paths": paths,
        "components": {
            "schemas": schemas(&comments),
            "securitySchemes": {"bearer": {
                "type": "http", "scheme": "bearer",
                "description": "A key of `percept keys`, or a token of the identity provider. Not needed where auth.mode is none.",
            }},
            "responses": {"Problem": {
                "description": "Why the request was not served.",
                "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}},
            }},
        },
    })
}

fn tag(service: &str) -> &str {
    service.strip_suffix("Service").unwrap_or(service)
}

fn tags(comments: &Comments) -> Value {
    let of_services = json::pool()
        .services()
        .map(|s| json!({"name": tag(s.name()), "description": comments.at(s.parent_file().name(), s.path())}));
    let server = json!({"name": "Server", "description": "The server itself, and pages for people."});
    of_services.chain([server]).collect()
}

fn operation(bound: &Bound, comments: &Comments) -> Value {
    let (route, rpc) = (bound.route, &bound.rpc);
    let service = rpc.parent_service();
    let words = comments.at(service.parent_file().name(), rpc.path());
    let summary = words.split_inclusive(['.', ';']).next().unwrap_or_default().trim_end_matches([';', '.']);
    let mut out = json!({
        "tags": [tag(service.name())],
        "operationId": rpc.name(),
        "summary": summary,
        "description": format!("{words} {} (`percept.v1.{}`)", needs(route.rpc), route.rpc.replace('/', ".")),
        "security": [{"bearer": []}, {}],
        "parameters": parameters(bound, comments),
        "responses": {"200": answer(bound), "default": {"$ref": "#/components/responses/Problem"}},
    });
    if route.verb == Verb::Post {
        let filled: Vec<&str> = route.fill.iter().map(|f| f.1).collect();
        let note = if filled.is_empty() { String::new() } else { format!("The path fills {}.", filled.join(", ")) };
        out["requestBody"] = json!({
            "required": true,
            "description": note,
            "content": {"application/json": {"schema": body(bound)}},
        });
    }
    if route.verb == Verb::Patch {
        let resource = rpc.input().get_field_by_name(route.body).map(|f| f.kind());
        let name = resource.as_ref().and_then(Kind::as_message).map(|m| m.name().to_owned()).unwrap_or_default();
        out["requestBody"] = json!({
            "required": true,
            "description": format!("What changes. The path fills {}.", route.fill.iter().map(|f| f.1).collect::<Vec<_>>().join(", ")),
            "content": {"application/json": {"schema": reference(&name)}},
        });
        out["responses"]["412"] = json!({"$ref": "#/components/responses/Problem"});
    }
    if matches!(route.kind, Answer::Tagged(..)) {
        out["responses"]["200"]["headers"] = json!({"ETag": {
            "schema": {"type": "string"}, "description": "The etag of what is in the answer: callers' settings, not what frames do.",
        }});
    }
    if matches!(route.kind, Answer::File | Answer::OperationResult) {
        out["responses"]["206"] = json!({"description": "The part that Range asked for."});
        out["responses"]["304"] = json!({"description": "If-None-Match holds the file's ETag."});
        out["responses"]["416"] = json!({"$ref": "#/components/responses/Problem"});
    }
    out
}

/// What a request cannot do without where it has it, unless it is marked as optional.
const NEEDED: [&str; 8] = [
    "CloudSource",
    "CloudFile",
    "DepthImage",
    "ColourImage",
    "CameraIntrinsics",
    "SensorMessage",
    "SensorSpec",
    "Vector2",
];

/// The request's message with what it needs, without what the path says.
fn body(bound: &Bound) -> Value {
    let (input, mut more) = (bound.rpc.input(), json!({}));
    let is_needed = |f: &FieldDescriptor| {
        let is_optional = f.containing_oneof().is_some() || f.is_list();
        !is_optional && f.kind().as_message().is_some_and(|m| NEEDED.contains(&m.name()))
    };
    let needed: Vec<String> = input.fields().filter(is_needed).map(|f| f.name().to_owned()).collect();
    if !needed.is_empty() {
        more["required"] = json!(needed);
    }
    for (_, field) in bound.route.fill {
        let (mut place, mut path) = (&mut more, *field);
        while let Some((outer, rest)) = path.split_once('.') {
            (place, path) = (&mut place["properties"][outer], rest);
        }
        place["not"] = json!({"required": [path]});
    }
    let whole = reference(input.name());
    if more == json!({}) { whole } else { json!({"allOf": [whole, more]}) }
}

/// The access that an rpc needs.
fn needs(rpc: &str) -> String {
    let of = |about| if about == About::Session { " to the session" } else { "" };
    rule(rpc).map(|r| format!("Needs {} access{}.", r.access, of(r.about))).unwrap_or_default()
}

fn answer(bound: &Bound) -> Value {
    let binary = json!({"schema": {"type": "string", "format": "binary"}});
    let json = json!({"schema": reference(bound.rpc.output().name())});
    match bound.route.kind {
        Answer::Message(_) if bound.rpc.is_server_streaming() => json!({
            "description": "All messages of the stream, joined into one.",
            "content": {"application/json": json},
        }),
        Answer::Message(_) | Answer::Tagged(..) => json!({
            "description": "The answer.",
            "content": {"application/json": json},
        }),
        Answer::SceneGraph(_) => json!({
            "description": "The graph as JSON, or in Graphviz's DOT language.",
            "content": {
                "application/json": json,
                "text/vnd.graphviz": {"schema": {"type": "string"}},
            },
        }),
        Answer::Picture(_) => json!({
            "description": "The picture. All of the answer, the picture in it, where Accept names a message's media type.",
            "content": {"image/png": binary, "application/json": json},
        }),
        Answer::Events => json!({
            "description": "Server-sent events: each one's data is a SessionEvent, its id the event's token. \
                Last-Event-ID goes on after that event. An event of type problem (ErrorInfo) ends the stream.",
            "content": {"text/event-stream": {"schema": reference("SessionEvent")}},
        }),
        Answer::PathEvents => json!({
            "description": "Server-sent events: each one's data is a WatchPathResponse, its id the map's version. \
                An event of type problem (ErrorInfo) ends the stream.",
            "content": {"text/event-stream": {"schema": reference("WatchPathResponse")}},
        }),
        Answer::FleetEvents => json!({
            "description": "Server-sent events: each one's data is a FleetEvent, its id the event's token. \
                Last-Event-ID goes on after that event. An event of type problem (ErrorInfo) ends the stream.",
            "content": {"text/event-stream": {"schema": reference("FleetEvent")}},
        }),
        Answer::OperationResult => json!({
            "description": "The answer of the plain call. A map's file comes as it is, with ETag, Content-Digest, Repr-Digest \
                (SHA-256) and percept-map-version, unless Accept names a message's media type.",
            "content": {"application/json": json, "*/*": binary},
        }),
        Answer::File => json!({
            "description": "The file, with ETag, Content-Digest and Repr-Digest (SHA-256) and percept-map-version.",
            "headers": {
                "ETag": {"schema": {"type": "string"}},
                "percept-map-version": {"schema": {"type": "string"}},
            },
            "content": {"*/*": binary},
        }),
    }
}

fn parameters(bound: &Bound, comments: &Comments) -> Vec<Value> {
    let leaves = fields::leaves(&bound.rpc.input());
    let find = |path: &str| leaves.iter().find(|(p, _)| p == path).map(|(_, field)| field);
    let parameter = |place: &str, name: &str, field: Option<&FieldDescriptor>| {
        let words = field.map_or("", |f| comments.at(f.parent_message().parent_file().name(), f.path()));
        let mut schema = field.map_or_else(|| json!({"type": "string"}), word);
        if place == "path" && schema.get("pattern") == Some(&json!(ID)) {
            schema["minLength"] = json!(1);
        }
        json!({"name": name, "in": place, "required": place == "path", "description": words, "schema": schema})
    };
    let mut out: Vec<Value> =
        bound.route.fill.iter().map(|(name, field)| parameter("path", name, find(field))).collect();
    if matches!(bound.route.kind, Answer::File) {
        let names: Vec<&str> = FILES.iter().map(|f| f.0).collect();
        let schema = json!({"type": "string", "enum": names});
        out.push(
            json!({"name": "name", "in": "path", "required": true, "description": "Which file.", "schema": schema}),
        );
    }
    for name in bound.route.query_fields(&bound.rpc) {
        out.push(match find(&name) {
            Some(field) => parameter("query", &name, Some(field)),
            None => json!({
                "name": name, "in": "query", "required": false, "description": "Form of the answer; Accept can say it too.",
                "schema": {"type": "string", "enum": ["json", "dot"]},
            }),
        });
    }
    if bound.route.verb == Verb::Patch {
        let words = "Paths of the fields that change, with commas between them, e.g. display_name,params.planning. What is named \
            and not in the body becomes empty, a parameter its default. Absent: what the body sets.";
        out.push(
            json!({"name": MASK, "in": "query", "required": false, "description": words, "schema": {"type": "string"}}),
        );
        let words = "The ETag that was seen: refused with 412 if it is another one by now.";
        out.push(json!({"name": "If-Match", "in": "header", "required": false, "description": words, "schema": {"type": "string"}}));
    }
    if matches!(bound.route.kind, Answer::Events | Answer::FleetEvents) {
        let words = "Token of the last event seen; goes before resume_token.";
        out.push(json!({"name": "Last-Event-ID", "in": "header", "required": false, "description": words, "schema": {"type": "string"}}));
    }
    out
}

/// A scalar as it stands in a path or a query.
fn word(field: &FieldDescriptor) -> Value {
    let one = one_word(field);
    if field.is_list() { json!({"type": "array", "items": one}) } else { one }
}

fn one_word(field: &FieldDescriptor) -> Value {
    match field.kind() {
        Kind::Enum(kind) => {
            let short = fields::short_names(&kind);
            let names: Vec<String> = kind.values().map(|v| v.name().to_owned()).chain(short).collect();
            json!({"type": "string", "enum": names})
        }
        _ => scalar(field),
    }
}

fn reference(name: &str) -> Value {
    json!({"$ref": format!("#/components/schemas/{name}")})
}

fn schemas(comments: &Comments) -> Value {
    let ours = |package: &str| package == "percept.v1";
    let messages = json::pool().all_messages().filter(|m| ours(m.package_name()) && !m.is_map_entry());
    let enums = json::pool().all_enums().filter(|e| ours(e.package_name()));
    let asked = reachable(MethodDescriptor::input);
    let only_answered = reachable(MethodDescriptor::output).into_iter().filter(|name| !asked.contains(name));
    let only_answered: BTreeSet<String> = only_answered.collect();
    let described = |m: MessageDescriptor| (m.name().to_owned(), message(&m, comments, &only_answered));
    let mut all: Map<String, Value> = messages.map(described).collect();
    all.extend(enums.map(|e| (e.name().to_owned(), enumeration(&e, comments))));
    all.insert("Problem".to_owned(), problem());
    all.insert("Reason".to_owned(), reasons());
    all.insert("FieldMask".to_owned(), json!({"type": "string", "description": "Paths with commas between them."}));
    Value::Object(all)
}

fn problem() -> Value {
    let text = |words: &str| json!({"type": "string", "description": words});
    json!({
        "type": "object",
        "description": "RFC 9457; the same facts as ErrorInfo.",
        "required": ["type", "title", "status", "detail", "reason", "field", "code", "trace_id"],
        "properties": {
            "type": text("urn:percept:error:<reason>."),
            "title": text("Words of the HTTP status."),
            "status": {"type": "integer", "description": "HTTP status."},
            "detail": text("One sentence: field, value, remedy."),
            "reason": reference("Reason"),
            "field": text("Path of the offending field; empty if none."),
            "code": text("Name of the gRPC code."),
            "trace_id": text("The request's trace, 32 hexadecimal digits; empty if it has none."),
            "server": text("Address (gRPC) of the server to ask instead; absent if that is no matter of where."),
        },
    })
}

/// The catalogue. Newer servers may know more.
fn reasons() -> Value {
    let mut words = "Why a request was refused; stable. Newer servers may say others.".to_owned();
    for entry in reason::CATALOGUE {
        words.push_str(&format!(" {} ({}): {}", entry.name, entry.code.name(), entry.about));
    }
    let names: Vec<&str> = reason::CATALOGUE.iter().map(|entry| entry.name).collect();
    json!({"type": "string", "description": words, "examples": names})
}

/// Full names of the messages that requests, or answers, are made of.
fn reachable(of: fn(&MethodDescriptor) -> MessageDescriptor) -> BTreeSet<String> {
    let (mut found, mut ahead) = (BTreeSet::new(), vec![]);
    ahead.extend(json::pool().services().flat_map(|s| s.methods().map(|m| of(&m)).collect::<Vec<_>>()));
    while let Some(message) = ahead.pop() {
        if found.insert(message.full_name().to_owned()) {
            ahead.extend(message.fields().filter_map(|f| f.kind().as_message().cloned()));
        }
    }
    found
}

fn message(message: &MessageDescriptor, comments: &Comments, only_answered: &BTreeSet<String>) -> Value {
    let properties: Map<String, Value> =
        message.fields().map(|f| (f.name().to_owned(), property(&f, comments))).collect();
    let mut words = comments.at(message.parent_file().name(), message.path()).to_owned();
    for oneof in message.oneofs().filter(|o| !o.is_synthetic()) {
        let fields: Vec<String> = oneof.fields().map(|f| f.name().to_owned()).collect();
        words.push_str(&format!(" At most one of {} ({}).", fields.join(", "), oneof.name()));
    }
    let mut schema = json!({"type": "object", "description": words.trim(), "properties": properties});
    let twice: Vec<Value> = message.oneofs().filter(|o| !o.is_synthetic()).flat_map(|o| pairs(&o)).collect();
    if !twice.is_empty() {
        schema["not"] = json!({"anyOf": twice});
    }
    if only_answered.contains(message.full_name()) {
        // Answers hold whatever cannot be absent.
        let held = message.fields().filter(|f| !f.supports_presence());
        schema["required"] = held.map(|f| f.name().to_owned()).collect();
    } else {
        schema["additionalProperties"] = json!(false);
        // A message that is a choice and nothing else is there to choose.
        let is_choice = |o: OneofDescriptor| !o.is_synthetic() && o.fields().len() == message.fields().len();
        if message.fields().len() > 1 && message.oneofs().any(is_choice) {
            schema["minProperties"] = json!(1);
        }
    }
    schema
}

/// Any two of a choice.
fn pairs(choice: &OneofDescriptor) -> Vec<Value> {
    let names: Vec<String> = choice.fields().map(|f| f.name().to_owned()).collect();
    let of = |(i, a): (usize, &String)| names[..i].iter().map(|b| json!({"required": [a, b]})).collect::<Vec<_>>();
    names.iter().enumerate().flat_map(of).collect()
}

fn property(field: &FieldDescriptor, comments: &Comments) -> Value {
    let mut schema = match field.kind() {
        Kind::Message(entry) if field.is_map() => {
            let value = entry.map_entry_value_field();
            json!({"type": "object", "additionalProperties": property(&value, comments)})
        }
        Kind::Message(inner) => reference(inner.name()),
        Kind::Enum(inner) => reference(inner.name()),
        _ => scalar(field),
    };
    if field.is_list() {
        schema = json!({"type": "array", "items": schema});
    }
    let words = comments.at(field.parent_message().parent_file().name(), field.path());
    if words.contains("Infinity") && matches!(field.kind(), Kind::Double | Kind::Float) {
        schema = json!({"anyOf": [schema, {"enum": ["NaN", "Infinity", "-Infinity"]}]});
    }
    if !words.is_empty() {
        schema["description"] = json!(words);
    }
    if let Some(oneof) = field.containing_oneof().filter(|o| !o.is_synthetic()) {
        schema["x-oneof"] = json!(oneof.name());
    }
    schema
}

/// Names of sessions and sensors; empty where one is to be given.
const ID: &str = "^[A-Za-z0-9_-]{0,64}$";

fn scalar(field: &FieldDescriptor) -> Value {
    match field.kind() {
        Kind::Bool => json!({"type": "boolean"}),
        Kind::Double => json!({"type": "number", "format": "double"}),
        Kind::Float => json!({"type": "number", "format": "float"}),
        Kind::Int32 | Kind::Sint32 | Kind::Sfixed32 => {
            json!({"type": "integer", "format": "int32", "minimum": i32::MIN, "maximum": i32::MAX})
        }
        Kind::Uint32 | Kind::Fixed32 => {
            json!({"type": "integer", "format": "uint32", "minimum": 0, "maximum": u32::MAX})
        }
        Kind::Int64 | Kind::Sint64 | Kind::Sfixed64 => {
            json!({"type": "string", "format": "int64", "pattern": "^-?[0-9]{1,19}$"})
        }
        Kind::Uint64 | Kind::Fixed64 => json!({"type": "string", "format": "uint64", "pattern": "^[0-9]{1,20}$"}),
        Kind::Bytes => json!({"type": "string", "format": "byte", "contentEncoding": "base64"}),
        Kind::String if matches!(field.name(), "session_id" | "sensor_id") => json!({"type": "string", "pattern": ID}),
        Kind::String | Kind::Enum(_) | Kind::Message(_) => json!({"type": "string"}),
    }
}

fn enumeration(kind: &EnumDescriptor, comments: &Comments) -> Value {
    let file = kind.parent_file();
    let mut words = comments.at(file.name(), kind.path()).to_owned();
    for value in kind.values() {
        let about = comments.at(file.name(), value.path());
        if !about.is_empty() {
            words.push_str(&format!(" {}: {about}", value.name()));
        }
    }
    let names: Vec<String> = kind.values().map(|v| v.name().to_owned()).collect();
    json!({"type": "string", "description": words.trim(), "enum": names})
}

#[cfg(test)]
mod tests {
    use super::*;

    fn whole() -> Value {
        document(&Bound::all().unwrap())
    }

    fn references(value: &Value, out: &mut BTreeSet<String>) {
        match value {
            Value::Object(members) => {
                out.extend(members.get("$ref").and_then(Value::as_str).map(str::to_owned));
                members.values().for_each(|v| references(v, out));
            }
            Value::Array(items) => items.iter().for_each(|v| references(v, out)),
            _ => {}
        }
    }

    #[test]
    fn every_reference_leads_somewhere() {
        let document = whole();
        let mut all = BTreeSet::new();
        references(&document, &mut all);
        assert!(all.len() > 50);
        for reference in all {
            assert!(document.pointer(reference.trim_start_matches('#')).is_some(), "{reference}");
        }
    }

    #[test]
    fn every_parameter_of_a_path_is_declared() {
        let document = whole();
        for (path, operations) in document["paths"].as_object().unwrap() {
            let wanted: BTreeSet<&str> = path.split('{').skip(1).filter_map(|p| p.split('}').next()).collect();
            for operation in operations.as_object().unwrap().values() {
                let declared = operation["parameters"].as_array().cloned().unwrap_or_default();
                let declared: BTreeSet<&str> = declared
                    .iter()
                    .filter(|p| p["in"] == "path")
                    .map(|p| p["name"].as_str().unwrap().to_owned().leak() as &str)
                    .collect();
                assert_eq!(declared, wanted, "{path}");
            }
        }
    }

    #[test]
    fn operations_have_ids_of_their_own_and_say_what_they_do() {
        let document = whole();
        let mut ids = BTreeSet::new();
        for (path, operations) in document["paths"].as_object().unwrap() {
            for (verb, operation) in operations.as_object().unwrap() {
                assert!(ids.insert(operation["operationId"].as_str().unwrap().to_owned()), "{verb} {path}");
                assert!(!operation["summary"].as_str().unwrap().is_empty(), "{verb} {path}");
            }
        }
    }

    #[test]
    fn kinds_are_as_json_has_them() {
        let document = whole();
        let field = |path: &str| document.pointer(&format!("/components/schemas/{path}")).unwrap().clone();
        assert_eq!(field("SensorMessage/properties/stamp_ns/type"), "string");
        assert_eq!(field("DepthImage/properties/data/format"), "byte");
        assert_eq!(field("SensorMessage/properties/depth/x-oneof"), "data");
        assert_eq!(field("Relation/properties/kind/$ref"), "#/components/schemas/RelationKind");
        assert_eq!(field("RelationKind/enum/1"), "RELATION_KIND_ON");
        assert_eq!(field("CloudSource/not/anyOf").as_array().map(Vec::len), Some(6), "two of four cannot both be set");
        let body = &document["paths"]["/v1/sessions/{session_id}/frames"]["post"]["requestBody"]["content"];
        let said_by_path = &body["application/json"]["schema"]["allOf"][1]["properties"]["message"]["not"]["required"];
        assert_eq!(*said_by_path, json!(["session_id"]));
        let body = &document["paths"]["/v1/toolbox/register-clouds"]["post"]["requestBody"]["content"];
        assert_eq!(body["application/json"]["schema"]["allOf"][1]["required"], json!(["source", "target"]));
        // Answers always hold what has no presence; requests may leave it out.
        assert!(field("SceneGraph/required").as_array().unwrap().contains(&json!("nodes")));
        assert!(document.pointer("/components/schemas/SensorSpec/required").is_none());
        assert!(field("Vector2/properties/x/description").as_str().unwrap().contains("Metres"));
    }
}
