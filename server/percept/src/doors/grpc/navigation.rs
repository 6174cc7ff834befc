//! `NavigationService`.

use super::sessions::RESUME_TOKEN;
use super::{Answer, Api, Streamed, check_size, ingest, peer_of, status, streamed};
use futures::StreamExt;
use percept_service::{Caller, ErrorCode, EventLog, PathUpdate, PathWatch, admission};
use percept_wire::convert::{drawing, exploration, navigation};
use percept_wire::parts::InParts;
use percept_wire::{convert, v1};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tonic::{Request, Response};

const WATCH_PATH: &str = "NavigationService/WatchPath";
/// Events that are stepped over at a time: a path is looked at once for all of them.
const EVENTS_PER_LOOK: usize = 64;
/// After so long a path is looked at again that could not be.
const BUSY: Duration = Duration::from_secs(1);

/// A watched path between two looks.
struct Watched {
    caller: Caller,
    session: String,
    log: Arc<EventLog>,
    token: u64,
    /// Of what callers set: zones among it.
    settings: watch::Receiver<()>,
    watch: PathWatch,
}

impl Watched {
    /// What is told next, when something is; none when the session is gone, or may not be read any more.
    async fn next(mut self) -> Option<(PathUpdate, Self)> {
        loop {
            tokio::select! {
                events = self.log.after(self.token, EVENTS_PER_LOOK) => {
                    self.token = events?.last().map_or(self.token, |event| event.token);
                }
                Ok(()) = self.settings.changed() => {}
            }
            match self.caller.look_at_path(&self.session, self.watch.clone()).await {
                Ok((watch, update)) => {
                    self.watch = watch;
                    if let Some(update) = update {
                        return Some((update, self));
                    }
                }
                Err(e) if e.code == ErrorCode::NotFound => return None,
                // A server that is busy looks again soon: where no frame comes, no other event may.
                Err(_) => {
                    tokio::time::sleep(BUSY).await;
                    self.settings.mark_changed();
                }
            }
        }
    }
}

#[tonic::async_trait]
impl v1::navigation_service_server::NavigationService for Api {
    type WatchPathStream = Streamed<v1::WatchPathResponse>;
    type DrawPathStream = Streamed<v1::DrawPathResponse>;

    async fn watch_path(&self, r: Request<v1::WatchPathRequest>) -> Answer<Self::WatchPathStream> {
        let caller = self.caller(&r)?;
        let place = self.bounds.watcher(&peer_of(r.extensions())).map_err(status::grpc)?;
        let place = (place, caller.hold(admission::Held::Watch).map_err(status::grpc)?);
        let r = r.into_inner();
        let session = convert::maps::session_id(r.source.as_ref()).map_err(status::grpc)?.to_owned();
        let params = caller.snapshot(WATCH_PATH, &session).await.map_err(status::grpc)?.params.clone();
        let request = navigation::request(None, r.goal.as_ref(), r.params.as_ref(), r.options.as_ref(), &params);
        let watch = PathWatch::new(request.map_err(status::grpc)?);
        let log = caller.session_events(WATCH_PATH, &session).await.map_err(status::grpc)?;
        // Questions that cannot be answered are refused at once, and not when the first frame comes.
        let (token, settings) = (log.newest_token(), log.settings());
        let (watch, first) = caller.look_at_path(&session, watch).await.map_err(status::grpc)?;
        let watched = Watched { caller: caller.clone(), session: session.clone(), log, token, settings, watch };
        let later = futures::stream::unfold(watched, Watched::next);
        let updates = futures::stream::iter(first).chain(later);
        let asker = caller.clone();
        let moved = async move { asker.moved(&session).await };
        let told = |update| navigation::update_to(&update);
        let mut answer = Response::new(self.told_while_watched(caller, place, updates.map(told), moved));
        // A watch that is taken up again begins with what holds then.
        answer.metadata_mut().insert(RESUME_TOKEN, 0.into());
        Ok(answer)
    }

    async fn plan_path(&self, r: Request<v1::PlanPathRequest>) -> Answer<v1::PlanPathResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = convert::maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let params = caller.snapshot("NavigationService/PlanPath", session).await.map_err(status::grpc)?.params.clone();
        let request =
            navigation::request(r.start.as_ref(), r.goal.as_ref(), r.params.as_ref(), r.options.as_ref(), &params);
        let plan = caller.plan_path(session, request.map_err(status::grpc)?).await.map_err(status::grpc)?;
        Ok(Response::new(navigation::plan_to(&plan)))
    }

    async fn draw_path(&self, r: Request<v1::DrawPathRequest>) -> Answer<Self::DrawPathStream> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = convert::maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let snapshot = caller.snapshot("NavigationService/DrawPath", session).await.map_err(status::grpc)?;
        let asked = drawing::drawing(r, &snapshot.params).map_err(status::grpc)?;
        let is_given = !r.poses.is_empty();
        let drawn = caller.draw_path(session, asked).await.map_err(status::grpc)?;
        streamed(drawing::drawn_to(drawn, is_given).parts(), |part| part)
    }

    async fn validate_path(&self, r: Request<v1::ValidatePathRequest>) -> Answer<v1::ValidatePathResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = convert::maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let snapshot = caller.snapshot("NavigationService/ValidatePath", session).await.map_err(status::grpc)?;
        let params = percept_wire::params::planning(r.params.as_ref(), &snapshot.params.planning);
        let poses = navigation::poses(&r.poses).map_err(status::grpc)?;
        let options = navigation::options(r.options.as_ref()).map_err(status::grpc)?;
        let params = Some(params.map_err(status::grpc)?);
        let check = caller.validate_path(session, poses, params, options).await.map_err(status::grpc)?;
        Ok(Response::new(navigation::check_to(&check)))
    }

    async fn navigate(&self, r: Request<v1::NavigateRequest>) -> Answer<v1::NavigateResponse> {
        let caller = self.caller(&r)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let mut r = r.into_inner();
        let message = convert::required("message", r.message.take()).map_err(status::grpc)?;
        let incoming = ingest::decode(&caller, "NavigationService/Navigate", message)
            .await
            .map_err(|e| status::grpc(e.within("message")))?;
        let params = caller
            .snapshot("NavigationService/Navigate", &incoming.session)
            .await
            .map_err(status::grpc)?
            .params
            .clone();
        let request = navigation::request(None, r.goal.as_ref(), r.params.as_ref(), r.options.as_ref(), &params);
        let request = request.map_err(status::grpc)?;
        let answer = caller.navigate(incoming, request).await.map_err(status::grpc)?;
        Ok(Response::new(navigation::navigation_to(&answer)))
    }

    async fn plan_coverage(&self, r: Request<v1::PlanCoverageRequest>) -> Answer<v1::PlanCoverageResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = convert::maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let snapshot = caller.snapshot("NavigationService/PlanCoverage", session).await.map_err(status::grpc)?;
        // Where it ends is the planner's.
        let goal = Some(v1::Vector2::default());
        let request = navigation::request(
            r.start.as_ref(),
            goal.as_ref(),
            r.params.as_ref(),
            r.options.as_ref(),
            &snapshot.params,
        );
        let coverage = exploration::coverage(r.coverage.as_ref()).map_err(status::grpc)?;
        let answer = caller.plan_coverage(session, request.map_err(status::grpc)?, coverage).await;
        Ok(Response::new(exploration::covered_to(&answer.map_err(status::grpc)?)))
    }

    async fn find_frontiers(&self, r: Request<v1::FindFrontiersRequest>) -> Answer<v1::FindFrontiersResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = convert::maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        let snapshot = caller.snapshot("NavigationService/FindFrontiers", session).await.map_err(status::grpc)?;
        let request = exploration::frontier_request(r, &snapshot.params).map_err(status::grpc)?;
        let found = caller.find_frontiers(session, request).await.map_err(status::grpc)?;
        Ok(Response::new(exploration::frontiers_to(&found)))
    }

    async fn plan_flight(&self, r: Request<v1::PlanFlightRequest>) -> Answer<v1::PlanFlightResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let session = convert::maps::session_id(r.source.as_ref()).map_err(status::grpc)?;
        // Who may not see the session learns nothing of what is wrong with the question.
        caller.may_with("NavigationService/PlanFlight", session).await.map_err(status::grpc)?;
        let question = exploration::flight(r).map_err(status::grpc)?;
        let answer = caller.plan_flight(session, question).await.map_err(status::grpc)?;
        Ok(Response::new(exploration::flown_to(&answer)))
    }
}
