//! Questions about sessions, answered by the newest snapshot.

use super::{Failure, Names, ROOT, hand_over};
use crate::doors::status::Problem;
use crate::telemetry::operations::{Operation, UNKNOWN};
use crate::telemetry::requests::Request;
use percept_scene::RelationFilter;
use percept_service::observe::Door;
use percept_service::reason;
use percept_service::{CloudDetail, Error, ObjectQuery};
use percept_wire::{convert, v1};
use prost::Message;
use std::future::Future;
use zenoh::query::Query;

/// Questions answered at a time; more wait in zenoh's own queue.
const CONCURRENT: usize = 8;

/// What can be asked of a session.
const QUESTIONS: [&str; 7] =
    ["map/occupancy", "map/cloud", "scene/graph", "scene/objects", "scene/rooms", "sensors", "pose"];

/// Declares the queryables; the future that comes back answers until it is dropped.
pub(super) async fn serve(zenoh: &zenoh::Session, names: Names) -> Result<impl Future<Output = ()>, Failure> {
    // One for each question: a wildcard over all keys would catch other people's queries, too.
    let (asked, questions) = tokio::sync::mpsc::channel::<Query>(CONCURRENT);
    let mut queryables = Vec::new();
    for suffix in QUESTIONS {
        let asked = asked.clone();
        let queryable = zenoh
            .declare_queryable(format!("{ROOT}/*/{suffix}"))
            .callback(move |query| drop(hand_over(&asked, query)))
            .await?;
        queryables.push(queryable);
    }
    Ok(answer_all(names, questions, queryables))
}

async fn answer_all<Q>(names: Names, mut questions: tokio::sync::mpsc::Receiver<Query>, _alive: Vec<Q>) {
    let slots = std::sync::Arc::new(tokio::sync::Semaphore::new(CONCURRENT));
    while let Some(query) = questions.recv().await {
        let Ok(slot) = std::sync::Arc::clone(&slots).acquire_owned().await else { return };
        let names = names.clone();
        tokio::spawn(async move {
            let key = query.key_expr().as_str().to_owned();
            let mut request = begin(&query, &key);
            let asked = async { answer(&names, &key).await.map_err(Problem::from) };
            let sent = match request.scope(asked).await {
                Ok(bytes) => {
                    (request.code, request.bytes_out) = ("OK", bytes.len() as u64);
                    query.reply(query.key_expr().clone(), bytes).await
                }
                Err(problem) => {
                    request.code = problem.code_name();
                    query.reply_err(problem.to_error_info()).await
                }
            };
            if let Err(error) = sent
                && let Some(untold) = names.api.service.faults().admit(&format!("reply not sent {key}"))
            {
                tracing::warn!(key, %error, untold, "reply not sent");
            }
            drop(slot);
        });
    }
}

/// A caller's `traceparent`, if it sends one, is the query's attachment.
fn begin(query: &Query, key: &str) -> Request {
    let question = key.splitn(3, '/').nth(2).unwrap_or_default();
    let name = QUESTIONS.into_iter().find(|q| *q == question).unwrap_or(UNKNOWN);
    let attached = query.attachment().and_then(|a| a.try_to_string().ok());
    Request::begin(Door::Zenoh, Operation::brief(name), attached.as_deref())
}

async fn answer(names: &Names, key: &str) -> Result<Vec<u8>, Error> {
    let mut chunks = key.splitn(3, '/').skip(1);
    let (id, question) = (chunks.next().unwrap_or_default(), chunks.next().unwrap_or_default());
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
        _ => {
            let words = format!(
                "{question:?} is no question; ask map/occupancy, map/cloud, scene/graph, scene/objects, scene/rooms, \
                 sensors or pose"
            );
            return Err(Error::not_found(reason::KEY_UNKNOWN, "", words));
        }
    })
}
