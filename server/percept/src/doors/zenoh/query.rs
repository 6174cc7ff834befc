//! Questions about sessions, answered by the newest snapshot.

use super::{Api, Failure, ROOT, hand_over};
use crate::doors::status::Problem;
use percept_service::Error;
use percept_wire::{convert, v1};
use prost::Message;
use std::future::Future;
use zenoh::query::Query;

/// Questions answered at a time; more wait in zenoh's own queue.
const CONCURRENT: usize = 8;

/// Declares the queryables; the future that comes back answers until it is dropped.
pub(super) async fn serve(zenoh: &zenoh::Session, api: Api) -> Result<impl Future<Output = ()>, Failure> {
    // One for each question: a wildcard over all keys would catch other people's queries, too.
    let (asked, questions) = tokio::sync::mpsc::channel::<Query>(CONCURRENT);
    let mut queryables = Vec::new();
    for suffix in ["map/occupancy", "map/cloud", "scene/graph", "scene/objects", "sensors", "pose"] {
        let asked = asked.clone();
        let queryable = zenoh
            .declare_queryable(format!("{ROOT}/*/{suffix}"))
            .callback(move |query| drop(hand_over(&asked, query)))
            .await?;
        queryables.push(queryable);
    }
    Ok(answer_all(api, questions, queryables))
}

async fn answer_all<Q>(api: Api, mut questions: tokio::sync::mpsc::Receiver<Query>, _alive: Vec<Q>) {
    let slots = std::sync::Arc::new(tokio::sync::Semaphore::new(CONCURRENT));
    while let Some(query) = questions.recv().await {
        let Ok(slot) = std::sync::Arc::clone(&slots).acquire_owned().await else { return };
        let api = api.clone();
        tokio::spawn(async move {
            let key = query.key_expr().as_str().to_owned();
            let sent = match answer(&api, &key).await {
                Ok(bytes) => query.reply(query.key_expr().clone(), bytes).await,
                Err(error) => query.reply_err(Problem::from(error).to_error_info()).await,
            };
            if let Err(error) = sent {
                tracing::warn!(key, %error, "reply not sent");
            }
            drop(slot);
        });
    }
}

async fn answer(api: &Api, key: &str) -> Result<Vec<u8>, Error> {
    let mut chunks = key.splitn(3, '/').skip(1);
    let (id, question) = (chunks.next().unwrap_or_default(), chunks.next().unwrap_or_default());
    let service = &api.service;
    Ok(match question {
        "map/occupancy" => convert::maps::grid_to(&service.occupancy_grid(id, None, None).await?).encode_to_vec(),
        "map/cloud" => {
            let answer = service.cloud(id, None).await?;
            let chunk = v1::CloudChunk {
                stamp: Some(convert::maps::stamp_to(answer.map_version, answer.stamp)),
                total_points: Some(answer.cloud.len() as u64),
                cloud: Some(convert::geometry::cloud_to(&answer.cloud)),
            };
            chunk.encode_to_vec()
        }
        "scene/graph" => convert::scene::graph_to(&service.scene_graph(id).await?).encode_to_vec(),
        "scene/objects" => {
            let (page, map_version) = service.list_objects(id, None, false, 1000, "").await?;
            let objects = page.items.iter().map(convert::scene::object_to).collect();
            v1::ListObjectsResponse { objects, next_page_token: page.next_page_token, map_version }.encode_to_vec()
        }
        "sensors" => {
            let sensors = service.session(id).await?.sensors().iter().map(convert::sensors::status_to).collect();
            v1::ListSensorsResponse { sensors }.encode_to_vec()
        }
        "pose" => match &service.snapshot(id).await?.pose {
            Some(pose) => convert::sessions::pose_to(pose).encode_to_vec(),
            None => {
                let words = "the session has no pose yet; send frames first";
                return Err(Error::new(percept_service::ErrorCode::FailedPrecondition, "NO_POSE_YET", words));
            }
        },
        _ => {
            let words = format!(
                "{question:?} is no question; ask map/occupancy, map/cloud, scene/graph, scene/objects, sensors or pose"
            );
            return Err(Error::not_found("KEY_UNKNOWN", "", words));
        }
    })
}
