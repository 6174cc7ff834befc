//! `SessionsService`.

use super::{Answer, Api, Streamed, status, streamed};
use percept_service::{Error, ErrorCode};
use percept_wire::{convert::sessions, params, v1};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response};

/// Poses in one message of a trajectory.
const POSES_PER_MESSAGE: usize = 1000;
/// Events read at a time by a watcher.
const EVENTS_PER_READ: usize = 64;

fn stopping_error() -> Error {
    let words = "the server is stopping; watch again, from the last resume token, when it is back";
    Error::new(ErrorCode::Unavailable, "STOPPING", words)
}

#[tonic::async_trait]
impl v1::sessions_service_server::SessionsService for Api {
    type GetTrajectoryStream = Streamed<v1::GetTrajectoryResponse>;
    type WatchSessionStream = Streamed<v1::WatchSessionResponse>;

    async fn create_session(&self, r: Request<v1::CreateSessionRequest>) -> Answer<v1::CreateSessionResponse> {
        let new = sessions::new_session(r.get_ref(), self.service.default_params()).map_err(status::grpc)?;
        let session = self.service.create_session(new).await.map_err(status::grpc)?;
        let session = Some(sessions::session_to(&session).map_err(status::grpc)?);
        Ok(Response::new(v1::CreateSessionResponse { session }))
    }

    async fn get_session(&self, r: Request<v1::GetSessionRequest>) -> Answer<v1::GetSessionResponse> {
        let session = self.service.session(&r.get_ref().session_id).await.map_err(status::grpc)?;
        let session = Some(sessions::session_to(&session).map_err(status::grpc)?);
        Ok(Response::new(v1::GetSessionResponse { session }))
    }

    async fn list_sessions(&self, r: Request<v1::ListSessionsRequest>) -> Answer<v1::ListSessionsResponse> {
        let r = r.get_ref();
        let page = self.service.list_sessions(r.page_size, &r.page_token).await.map_err(status::grpc)?;
        let listed: Result<_, Error> = page.items.iter().map(|s| sessions::session_to(s)).collect();
        let sessions = listed.map_err(status::grpc)?;
        Ok(Response::new(v1::ListSessionsResponse { sessions, next_page_token: page.next_page_token }))
    }

    async fn delete_session(&self, r: Request<v1::DeleteSessionRequest>) -> Answer<v1::DeleteSessionResponse> {
        self.service.delete_session(&r.get_ref().session_id).await.map_err(status::grpc)?;
        Ok(Response::new(v1::DeleteSessionResponse {}))
    }

    async fn get_pose(&self, r: Request<v1::GetPoseRequest>) -> Answer<v1::GetPoseResponse> {
        let snapshot = self.service.snapshot(&r.get_ref().session_id).await.map_err(status::grpc)?;
        Ok(Response::new(v1::GetPoseResponse { pose: snapshot.pose.as_ref().map(sessions::pose_to) }))
    }

    async fn get_trajectory(&self, r: Request<v1::GetTrajectoryRequest>) -> Answer<Self::GetTrajectoryStream> {
        let snapshot = self.service.snapshot(&r.get_ref().session_id).await.map_err(status::grpc)?;
        let poses: Vec<_> = snapshot.trajectory().map(|(t, e)| sessions::trajectory_pose_to(&t, e)).collect();
        // An empty trajectory is told by one message without poses.
        let mut chunks: Vec<Vec<_>> = poses.chunks(POSES_PER_MESSAGE).map(<[_]>::to_vec).collect();
        if chunks.is_empty() {
            chunks.push(vec![]);
        }
        let map_version = snapshot.map_version;
        streamed(chunks, move |poses| v1::GetTrajectoryResponse { map_version, poses })
    }

    async fn list_keyframes(&self, r: Request<v1::ListKeyframesRequest>) -> Answer<v1::ListKeyframesResponse> {
        let r = r.get_ref();
        let page =
            self.service.list_keyframes(&r.session_id, r.page_size, &r.page_token).await.map_err(status::grpc)?;
        let keyframes = page.items.iter().map(sessions::keyframe_to).collect();
        Ok(Response::new(v1::ListKeyframesResponse { keyframes, next_page_token: page.next_page_token }))
    }

    async fn watch_session(&self, r: Request<v1::WatchSessionRequest>) -> Answer<Self::WatchSessionStream> {
        let r = r.into_inner();
        let session = self.service.session(&r.session_id).await.map_err(status::grpc)?;
        let mut token = r.resume_token.unwrap_or_else(|| session.events().newest_token());
        // One read ahead at most: what a slow client misses is told by a resync, not kept for it.
        let (out, answer) = tokio::sync::mpsc::channel(EVENTS_PER_READ);
        let mut stopping = self.stopping.clone();
        tokio::spawn(async move {
            loop {
                let events = tokio::select! {
                    events = session.events().after(token, EVENTS_PER_READ) => Some(events),
                    _ = stopping.wait_for(|s| *s) => None,
                    () = out.closed() => return,
                };
                let Some(events) = events else {
                    // Said as an error, so that clients reconnect instead of taking it for the end.
                    let _ = out.send(Err(status::grpc(stopping_error()))).await;
                    return;
                };
                // The session was deleted: a true end.
                let Some(events) = events else { return };
                let snapshot = session.snapshot();
                for event in events {
                    token = event.token;
                    let event = Some(sessions::event_to(&event, &snapshot));
                    if out.send(Ok(v1::WatchSessionResponse { event })).await.is_err() {
                        return;
                    }
                }
            }
        });
        Ok(Response::new(Box::pin(ReceiverStream::new(answer))))
    }

    async fn get_default_params(
        &self,
        _: Request<v1::GetDefaultParamsRequest>,
    ) -> Answer<v1::GetDefaultParamsResponse> {
        let params = Some(params::pipeline_to(self.service.default_params()).map_err(status::grpc)?);
        Ok(Response::new(v1::GetDefaultParamsResponse { params }))
    }
}
