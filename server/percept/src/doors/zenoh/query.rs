//! Questions about sessions: some without words, answered by the newest snapshot, and every rpc of the contract that is about a
//! session and ends, by the handlers of the gRPC door.

use super::super::rest::by_name;
use super::{Failure, Names, ROOT, charged, hand_over};
use crate::doors::bounds::{Charge, Peer};
use crate::doors::status::Problem;
use crate::telemetry::operations::{self, Operation, UNKNOWN};
use crate::telemetry::requests::Request;
use bytes::Bytes;
use percept_identity::Access;
use percept_scene::RelationFilter;
use percept_service::observe::Door;
use percept_service::reason;
use percept_service::{CloudDetail, Error, ObjectQuery};
use percept_wire::{convert, v1};
use prost::Message;
use std::future::Future;
use std::sync::Arc;
use tokio::sync::{Semaphore, mpsc};
use zenoh::key_expr::keyexpr;
use zenoh::query::Query;

/// Questions answered at a time; more wait in zenoh's own queue.
const CONCURRENT: usize = 8;
/// Sessions that a wildcard is answered for.
const MOST_SESSIONS: usize = 100;

/// What can be asked of a session without a word more.
pub(super) const QUESTIONS: [&str; 7] =
    ["map/occupancy", "map/cloud", "scene/graph", "scene/objects", "scene/rooms", "sensors", "pose"];
/// Stands before the service and method of an rpc, whose request is the query's payload.
pub(super) const RPC: &str = "rpc";

/// A query, and which of the questions it is; none: an rpc.
struct Asked {
    query: Query,
    question: Option<&'static str>,
    /// Of the payload; given back when it is answered.
    memory: Charge,
}

/// Declares the queryables; the future that comes back answers until it is dropped.
pub(super) async fn serve(zenoh: &zenoh::Session, names: Names) -> Result<impl Future<Output = ()>, Failure> {
    // One for each question: a wildcard over all keys would catch other people's queries, too.
    let (asked, questions) = mpsc::channel::<Asked>(CONCURRENT);
    let mut queryables = Vec::new();
    let runtime = tokio::runtime::Handle::current();
    for question in QUESTIONS.into_iter().map(Some).chain([None]) {
        let (asked, memory, runtime) = (asked.clone(), Arc::clone(&names.api.bounds.memory), runtime.clone());
        let key = question.map_or_else(|| format!("{ROOT}/*/{RPC}/*/*"), |question| format!("{ROOT}/*/{question}"));
        let taken = move |query: Query| {
            let session = query.key_expr().as_str().split('/').nth(1).unwrap_or_default().to_owned();
            let size = query.payload().map_or(0, zenoh::bytes::ZBytes::len);
            let memory = charged(&memory, &Peer::Lane(session), size, &runtime);
            drop(hand_over(&asked, Asked { query, question, memory }));
        };
        queryables.push(zenoh.declare_queryable(key).callback(taken).await?);
    }
    Ok(answer_all(names, questions, queryables))
}

async fn answer_all<Q>(names: Names, mut questions: mpsc::Receiver<Asked>, _alive: Vec<Q>) {
    let slots = Arc::new(Semaphore::new(CONCURRENT));
    while let Some(asked) = questions.recv().await {
        let Ok(slot) = Arc::clone(&slots).acquire_owned().await else { return };
        let names = names.clone();
        tokio::spawn(async move {
            reply_to(&names, &asked).await;
            drop((asked.memory, slot));
        });
    }
}

/// Replies for every session that the query's key fits.
async fn reply_to(names: &Names, asked: &Asked) {
    let query = &asked.query;
    let wanted = query.key_expr().as_str();
    let (sessions, question) = match addressed(names, asked).await {
        Ok(addressed) => addressed,
        Err(error) => return sent(names, wanted, query.reply_err(Problem::from(error).to_error_info()).await),
    };
    for session in sessions {
        let key = format!("{ROOT}/{session}/{question}");
        let mut request = begin(query, &question);
        request.bytes_in = query.payload().map_or(0, |payload| payload.len() as u64);
        match request.scope(answer_any(names, query, &session, &question)).await {
            Ok(bytes) => {
                (request.code, request.bytes_out) = ("OK", bytes.len() as u64);
                sent(names, &key, query.reply(&key, bytes).await);
            }
            Err(problem) => {
                request.code = problem.code_name();
                sent(names, &key, query.reply_err(problem.to_error_info()).await);
            }
        }
    }
}

fn sent(names: &Names, key: &str, reply: zenoh::Result<()>) {
    if let Err(error) = reply
        && let Some(untold) = names.api.service.faults().admit(&format!("reply not sent {key}"))
    {
        tracing::warn!(key, %error, untold, "reply not sent");
    }
}

/// The sessions that a query is about, and what it asks of them. A wildcard stands for those that are awake: it wakes none.
///
/// # Errors
/// `TOO_MANY_ANSWERS`; `KEY_UNKNOWN` for an rpc that changes a session and names none.
async fn addressed(names: &Names, asked: &Asked) -> Result<(Vec<String>, String), Error> {
    let wanted = asked.query.key_expr();
    let mut chunks = wanted.as_str().splitn(3, '/');
    let (root, session, rest) =
        (chunks.next().unwrap_or_default(), chunks.next().unwrap_or_default(), chunks.next().unwrap_or_default());
    let question = match asked.question {
        Some(question) => question.to_owned(),
        // Which rpc is meant has to be said: nobody means all.
        None if rest.contains('*') || !rest.starts_with(RPC) => return Ok((Vec::new(), String::new())),
        None => rest.to_owned(),
    };
    if root == ROOT && !session.contains('*') {
        return Ok((vec![session.to_owned()], question));
    }
    if rpc(&question).is_some_and(|rpc| rpc.access > Access::Read) {
        let words = format!("{question} changes a session; name the session, a wildcard is for questions");
        return Err(Error::invalid(reason::KEY_UNKNOWN, "", words));
    }
    let fits = |id: &String| {
        let key = format!("{ROOT}/{id}/{question}");
        keyexpr::new(&key).is_ok_and(|key| wanted.intersects(key))
    };
    let fitting: Vec<String> = names.awake().await?.into_iter().filter(fits).collect();
    if fitting.len() > MOST_SESSIONS {
        let words = format!(
            "{} sessions that are awake fit {wanted}, at most {MOST_SESSIONS} are answered for; name fewer",
            fitting.len()
        );
        return Err(Error::exhausted(reason::TOO_MANY_ANSWERS, "", words));
    }
    Ok((fitting, question))
}

fn rpc(question: &str) -> Option<&'static by_name::ByName> {
    by_name::find(question.strip_prefix(RPC)?.strip_prefix('/')?)
}

/// A caller's `traceparent`, if it sends one, is the query's attachment.
fn begin(query: &Query, question: &str) -> Request {
    let known = QUESTIONS.into_iter().find(|q| *q == question);
    let operation = match rpc(question) {
        Some(rpc) => operations::of_rpc(rpc.name),
        None => Operation::brief(known.unwrap_or(UNKNOWN)),
    };
    let attached = query.attachment().and_then(|a| a.try_to_string().ok());
    Request::begin(Door::Zenoh, operation, attached.as_deref())
}

async fn answer_any(names: &Names, query: &Query, session: &str, question: &str) -> Result<Vec<u8>, Problem> {
    if QUESTIONS.contains(&question) {
        return Ok(answer(names, session, question).await?);
    }
    let Some(rpc) = rpc(question) else { return Err(unknown(question).into()) };
    let (size, limit) =
        (query.payload().map_or(0, zenoh::bytes::ZBytes::len), names.api.service.limits().max_message_bytes);
    if size > limit {
        let words = format!("the request has {size} bytes, the limit is {limit}; ask for less at a time");
        return Err(Error::exhausted(reason::MESSAGE_TOO_LARGE, "", words).into());
    }
    // Copied: in shared memory its sender could still write to it.
    let request = query.payload().map_or_else(Bytes::new, |payload| Bytes::from(payload.to_bytes().into_owned()));
    rpc.answer(&names.api, names.policy.context(session)?, session, request).await
}

/// Answers a question that has no words.
async fn answer(names: &Names, id: &str, question: &str) -> Result<Vec<u8>, Error> {
    let caller = names.caller(id)?;
    Ok(match question {
        "map/occupancy" => {
            let grid = caller.occupancy_grid(id, None, None, false).await?;
            caller.query(id, move || convert::maps::grid_to(&grid).encode_to_vec()).await?
        }
        "map/cloud" => {
            let answer = caller.cloud(id, None, CloudDetail::default()).await?;
            let chunk = move || v1::CloudChunk {
                stamp: Some(convert::maps::stamp_to(answer.map_version, answer.stamp)),
                total_points: Some(answer.cloud.len() as u64),
                cloud: Some(convert::geometry::cloud_to(&answer.cloud)),
                voxel_size_m: Some(answer.voxel_size_m),
            };
            caller.query(id, move || chunk().encode_to_vec()).await?
        }
        "scene/graph" => {
            let graph = caller.scene_graph(id, None, RelationFilter::default(), (None, None)).await?;
            convert::scene::graph_to(&graph).encode_to_vec()
        }
        "scene/rooms" => convert::rooms::rooms_to(&caller.rooms(id).await?, true).encode_to_vec(),
        "scene/objects" => {
            let (page, map_version) = caller.list_objects(id, ObjectQuery::default(), 1000, "").await?;
            let objects = page.items.iter().map(convert::scene::object_to).collect();
            v1::ListObjectsResponse { objects, next_page_token: page.next_page_token, map_version }.encode_to_vec()
        }
        "sensors" => {
            let sensors = caller.list_sensors(id).await?.iter().map(convert::streams::status_to).collect();
            v1::ListSensorsResponse { sensors }.encode_to_vec()
        }
        "pose" => match &caller.snapshot("SessionsService/GetPose", id).await?.pose {
            Some(pose) => convert::sessions::pose_to(pose).encode_to_vec(),
            None => {
                let words = "the session has no pose yet; send frames first";
                return Err(Error::new(percept_service::ErrorCode::FailedPrecondition, reason::NO_POSE_YET, words));
            }
        },
        _ => return Err(unknown(question)),
    })
}

fn unknown(question: &str) -> Error {
    let shown: String = question.chars().take(200).collect();
    let words = format!(
        "{shown:?} is no question; ask {}, or {RPC}/<service>/<method> of the contract, of those that are about a session and end",
        QUESTIONS.join(", ")
    );
    Error::not_found(reason::KEY_UNKNOWN, "", words)
}
