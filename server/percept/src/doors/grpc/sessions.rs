//! `SessionsService`.

use super::{Answer, Api, Streamed, check_size, peer_of, status, streamed};
use futures::{Stream, StreamExt};
use percept_geometry::{Pose, Timestamp};
use percept_pipeline::TrajectoryEntry;
use percept_service::reason;
use percept_service::{Caller, Error, ErrorCode, Event, admission, observe};
use percept_wire::convert::{fleet, geometry, recordings, required, sessions, updates};
use percept_wire::{params, v1};
use std::sync::Arc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response};

/// Poses in one message of a trajectory.
const POSES_PER_MESSAGE: usize = 1000;
/// Tells a watcher, before any event, what it resumes from if the link breaks.
pub(super) const RESUME_TOKEN: &str = "percept-resume-token";
/// Events read at a time by a watcher.
const EVENTS_PER_READ: usize = 64;

fn stopping_error() -> Error {
    let words = "the server is stopping; watch again, from the last resume token, when it is back";
    Error::new(ErrorCode::Unavailable, reason::STOPPING, words)
}

impl Api {
    /// Events for as long as somebody watches and may, and the server runs. One read ahead at most: what a slow client
    /// misses is told by a resync, not kept for it.
    pub(super) fn told_while_watched<T: Send + 'static>(
        &self,
        caller: Caller,
        place: impl Send + 'static,
        events: impl Stream<Item = T> + Send + 'static,
        moved: impl Future<Output = Error> + Send + 'static,
    ) -> Streamed<T> {
        let (out, answer) = tokio::sync::mpsc::channel(EVENTS_PER_READ);
        let mut stopping = self.stopping.clone();
        let open = observe::stream(observe::Stream::Watch);
        tokio::spawn(async move {
            let _held = (open, place);
            let (mut ended, mut events) = (std::pin::pin!(caller.ended()), std::pin::pin!(events));
            let mut moved = std::pin::pin!(moved);
            loop {
                let event = tokio::select! {
                    event = events.next() => Ok(event),
                    _ = stopping.wait_for(|s| *s) => Err(stopping_error()),
                    error = &mut ended => Err(error),
                    error = &mut moved => Err(error),
                    () = out.closed() => return,
                };
                let sent = match event {
                    Ok(Some(event)) => out.send(Ok(event)).await,
                    // What was watched is gone: a true end.
                    Ok(None) => return,
                    // Said as an error, so that clients come back instead of taking it for the end.
                    Err(error) => {
                        let _ = out.send(Err(status::grpc(error))).await;
                        return;
                    }
                };
                if sent.is_err() {
                    return;
                }
            }
        });
        Box::pin(ReceiverStream::new(answer))
    }
}

#[tonic::async_trait]
impl v1::sessions_service_server::SessionsService for Api {
    type GetTrajectoryStream = Streamed<v1::GetTrajectoryResponse>;
    type WatchSessionStream = Streamed<v1::WatchSessionResponse>;
    type WatchSessionsStream = Streamed<v1::WatchSessionsResponse>;

    async fn create_session(&self, r: Request<v1::CreateSessionRequest>) -> Answer<v1::CreateSessionResponse> {
        let caller = self.caller(&r)?;
        let new = sessions::new_session(r.get_ref(), caller.params_to_fill()).map_err(status::grpc)?;
        let id = caller.create_session(new).await.map_err(status::grpc)?;
        let described = caller.describe_session("SessionsService/CreateSession", &id).await.map_err(status::grpc)?;
        let session = Some(sessions::description_to(&described).map_err(status::grpc)?);
        Ok(Response::new(v1::CreateSessionResponse { session }))
    }

    async fn get_session(&self, r: Request<v1::GetSessionRequest>) -> Answer<v1::GetSessionResponse> {
        let caller = self.caller(&r)?;
        let id = &r.get_ref().session_id;
        let described = caller.describe_session("SessionsService/GetSession", id).await.map_err(status::grpc)?;
        let session = Some(sessions::description_to(&described).map_err(status::grpc)?);
        Ok(Response::new(v1::GetSessionResponse { session }))
    }

    async fn list_sessions(&self, r: Request<v1::ListSessionsRequest>) -> Answer<v1::ListSessionsResponse> {
        let caller = self.caller(&r)?;
        let list = fleet::list(r.get_ref()).map_err(status::grpc)?;
        let page = caller.list_sessions(&list).await.map_err(status::grpc)?;
        let sessions = page.items.iter().map(sessions::view_to).collect();
        Ok(Response::new(v1::ListSessionsResponse { sessions, next_page_token: page.next_page_token }))
    }

    async fn update_session(&self, r: Request<v1::UpdateSessionRequest>) -> Answer<v1::UpdateSessionResponse> {
        let caller = self.caller(&r)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let r = r.into_inner();
        let sent = required("session", r.session.as_ref()).map_err(status::grpc)?;
        let (session, has_masks) = (sent.session_id.clone(), !sent.zone_masks.is_empty());
        // Who may not change the session learns nothing of what is wrong with the change.
        caller.may_with("SessionsService/UpdateSession", &session).await.map_err(status::grpc)?;
        let limits = Arc::clone(caller.limits());
        let read = move || updates::session(&r, &limits);
        let update = if has_masks { caller.query(&session, read).await.and_then(|update| update) } else { read() };
        let update = update.map_err(status::grpc)?;
        let changed = caller.update_session(&update.id, &update.etag, &update.changes).await.map_err(status::grpc)?;
        let session = Some(sessions::description_to(&changed).map_err(status::grpc)?);
        Ok(Response::new(v1::UpdateSessionResponse { session }))
    }

    async fn delete_session(&self, r: Request<v1::DeleteSessionRequest>) -> Answer<v1::DeleteSessionResponse> {
        let caller = self.caller(&r)?;
        caller.delete_session(&r.get_ref().session_id).await.map_err(status::grpc)?;
        Ok(Response::new(v1::DeleteSessionResponse {}))
    }

    async fn get_pose(&self, r: Request<v1::GetPoseRequest>) -> Answer<v1::GetPoseResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        if let Some(at_ns) = r.at_ns {
            let (pose, map_version) = caller.pose_at(&r.session_id, Timestamp(at_ns)).await.map_err(status::grpc)?;
            let pose_at = Some(sessions::pose_at_to(&pose, map_version));
            return Ok(Response::new(v1::GetPoseResponse { pose: None, pose_at }));
        }
        let snapshot = caller.snapshot("SessionsService/GetPose", &r.session_id).await.map_err(status::grpc)?;
        let pose = snapshot.pose.as_ref().map(sessions::pose_to);
        Ok(Response::new(v1::GetPoseResponse { pose, pose_at: None }))
    }

    async fn set_pose(&self, r: Request<v1::SetPoseRequest>) -> Answer<v1::SetPoseResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        // Who may not change the session learns nothing of what is wrong with the pose.
        caller.may_with("SessionsService/SetPose", &r.session_id).await.map_err(status::grpc)?;
        let told = required("t_map_base", r.t_map_base.as_ref()).map_err(status::grpc)?;
        let t_map_base = geometry::pose("t_map_base", Some(told)).map_err(status::grpc)?;
        let (pose, compared) = caller.set_pose(&r.session_id, t_map_base).await.map_err(status::grpc)?;
        Ok(Response::new(v1::SetPoseResponse { pose: Some(sessions::pose_to(&pose)), compared }))
    }

    async fn lookup_transform(&self, r: Request<v1::LookupTransformRequest>) -> Answer<v1::LookupTransformResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let at = r.at_ns.map(Timestamp);
        let found = caller.lookup_transform(&r.session_id, &r.target_frame, &r.source_frame, at).await;
        let transform = Some(sessions::transform_to(r, &found.map_err(status::grpc)?));
        Ok(Response::new(v1::LookupTransformResponse { transform }))
    }

    async fn get_trajectory(&self, r: Request<v1::GetTrajectoryRequest>) -> Answer<Self::GetTrajectoryStream> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let request = sessions::trajectory_request(r);
        let (part, map_version) = caller.trajectory(&r.session_id, request).await.map_err(status::grpc)?;
        let chunks = move || {
            let pose = |(t, e): &(Pose, TrajectoryEntry)| sessions::trajectory_pose_to(t, e);
            let message = |poses: &[_]| v1::GetTrajectoryResponse {
                map_version,
                poses: poses.iter().map(pose).collect(),
                next_page_token: String::new(),
            };
            // An empty trajectory is told by one message without poses.
            let mut messages: Vec<_> = part.items.chunks(POSES_PER_MESSAGE).map(message).collect();
            if messages.is_empty() {
                messages.push(message(&[]));
            }
            if let Some(last) = messages.last_mut() {
                last.next_page_token = part.next_page_token;
            }
            messages
        };
        let messages = caller.query(&r.session_id, chunks).await.map_err(status::grpc)?;
        streamed(messages, |message| message)
    }

    async fn list_keyframes(&self, r: Request<v1::ListKeyframesRequest>) -> Answer<v1::ListKeyframesResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let page = caller.list_keyframes(&r.session_id, r.page_size, &r.page_token).await.map_err(status::grpc)?;
        let keyframes = page.items.iter().map(sessions::keyframe_to).collect();
        Ok(Response::new(v1::ListKeyframesResponse { keyframes, next_page_token: page.next_page_token }))
    }

    async fn watch_session(&self, r: Request<v1::WatchSessionRequest>) -> Answer<Self::WatchSessionStream> {
        let caller = self.caller(&r)?;
        let place = self.bounds.watcher(&peer_of(r.extensions())).map_err(status::grpc)?;
        let place = (place, caller.hold(admission::Held::Watch).map_err(status::grpc)?);
        let r = r.into_inner();
        let mut filter = fleet::of_session(&r).map_err(status::grpc)?;
        let log = caller.session_events("SessionsService/WatchSession", &r.session_id).await.map_err(status::grpc)?;
        let token = r.resume_token.unwrap_or_else(|| log.newest_token());
        let events = futures::stream::unfold((log, token), |(log, token)| async move {
            let events = log.after(token, EVENTS_PER_READ).await?;
            let token = events.last().map_or(token, |event| event.token);
            Some((events, (log, token)))
        });
        let (asker, session) = (caller.clone(), r.session_id);
        let moved = async move { asker.moved(&session).await };
        let told = |event| v1::WatchSessionResponse { event: Some(sessions::event_to(&event)) };
        let wanted = move |event: &Event| std::future::ready(filter.wants(event));
        let events = events.flat_map(futures::stream::iter).filter(wanted).map(told);
        let mut answer = Response::new(self.told_while_watched(caller, place, events, moved));
        answer.metadata_mut().insert(RESUME_TOKEN, token.into());
        Ok(answer)
    }

    async fn watch_sessions(&self, r: Request<v1::WatchSessionsRequest>) -> Answer<Self::WatchSessionsStream> {
        let caller = self.caller(&r)?;
        let place = self.bounds.watcher(&peer_of(r.extensions())).map_err(status::grpc)?;
        let place = (place, caller.hold(admission::Held::Watch).map_err(status::grpc)?);
        let r = r.get_ref();
        let watch = caller.watch_sessions(fleet::filter(r).map_err(status::grpc)?).map_err(status::grpc)?;
        let token = r.resume_token.unwrap_or_else(|| watch.newest_token());
        let events = futures::stream::unfold((watch, token), |(watch, token)| async move {
            let (events, token) = watch.after(token, EVENTS_PER_READ).await?;
            Some((events, (watch, token)))
        });
        let told = |event| v1::WatchSessionsResponse { event: Some(fleet::event_to(&event)) };
        let events = events.flat_map(futures::stream::iter).map(told);
        let mut answer = Response::new(self.told_while_watched(caller, place, events, std::future::pending()));
        answer.metadata_mut().insert(RESUME_TOKEN, token.into());
        Ok(answer)
    }

    async fn start_recording(&self, r: Request<v1::StartRecordingRequest>) -> Answer<v1::StartRecordingResponse> {
        let caller = self.caller(&r)?;
        let status = caller.start_recording(&r.get_ref().session_id).await.map_err(status::grpc)?;
        let recording = status.newest.as_ref().map(recordings::recording_to);
        Ok(Response::new(v1::StartRecordingResponse { recording }))
    }

    async fn stop_recording(&self, r: Request<v1::StopRecordingRequest>) -> Answer<v1::StopRecordingResponse> {
        let caller = self.caller(&r)?;
        let status = caller.stop_recording(&r.get_ref().session_id).await.map_err(status::grpc)?;
        let recording = status.newest.as_ref().map(recordings::recording_to);
        Ok(Response::new(v1::StopRecordingResponse { recording }))
    }

    async fn list_recordings(&self, r: Request<v1::ListRecordingsRequest>) -> Answer<v1::ListRecordingsResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let page = caller.list_recordings(&r.session_id, r.page_size, &r.page_token).await.map_err(status::grpc)?;
        let recordings = page.items.iter().map(recordings::stored_to).collect();
        Ok(Response::new(v1::ListRecordingsResponse { recordings, next_page_token: page.next_page_token }))
    }

    async fn delete_recording(&self, r: Request<v1::DeleteRecordingRequest>) -> Answer<v1::DeleteRecordingResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        caller.delete_recording(&r.session_id, &r.recording_id).await.map_err(status::grpc)?;
        Ok(Response::new(v1::DeleteRecordingResponse {}))
    }

    async fn get_default_params(
        &self,
        r: Request<v1::GetDefaultParamsRequest>,
    ) -> Answer<v1::GetDefaultParamsResponse> {
        let caller = self.caller(&r)?;
        let params = caller.default_params().map_err(status::grpc)?;
        let params = Some(params::pipeline_to(params).map_err(status::grpc)?);
        Ok(Response::new(v1::GetDefaultParamsResponse { params }))
    }
}
