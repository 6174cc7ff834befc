//! `SceneService`.

use super::{Answer, Api, Streamed, status, streamed};
use percept_geometry::Timestamp;
use percept_scene::rooms::RoomId;
use percept_wire::convert::{required, room_routes, rooms, scene};
use percept_wire::parts::InParts;
use percept_wire::v1;
use tonic::{Request, Response};

const OBJECTS: &str = "SceneService/ListObjects";
const CORRECT: &str = "SceneService/CorrectObject";
const FORGET: &str = "SceneService/ForgetObjectClass";
const GRAPH: &str = "SceneService/GetSceneGraph";
const ROUTE: &str = "SceneService/RouteToRoom";

#[tonic::async_trait]
impl v1::scene_service_server::SceneService for Api {
    type GetSceneGraphStream = Streamed<v1::GetSceneGraphResponse>;
    type GetRoomsStream = Streamed<v1::GetRoomsResponse>;

    async fn list_objects(&self, r: Request<v1::ListObjectsRequest>) -> Answer<v1::ListObjectsResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        caller.snapshot(OBJECTS, &r.session_id).await.map_err(status::grpc)?;
        let query = scene::query(r).map_err(status::grpc)?;
        let listed = caller.list_objects(&r.session_id, query, r.page_size, &r.page_token).await;
        let (page, map_version) = listed.map_err(status::grpc)?;
        let objects = page.items.iter().map(scene::object_to).collect();
        Ok(Response::new(v1::ListObjectsResponse { objects, next_page_token: page.next_page_token, map_version }))
    }

    async fn get_object(&self, r: Request<v1::GetObjectRequest>) -> Answer<v1::GetObjectResponse> {
        let caller = self.caller(&r)?;
        let object = caller.object(&r.get_ref().session_id, r.get_ref().object_id).await.map_err(status::grpc)?;
        Ok(Response::new(v1::GetObjectResponse { object: Some(scene::whole_object_to(&object)) }))
    }

    async fn correct_object(&self, r: Request<v1::CorrectObjectRequest>) -> Answer<v1::CorrectObjectResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        caller.snapshot(CORRECT, &r.session_id).await.map_err(status::grpc)?;
        let correction = scene::correction(r.correction.as_ref()).map_err(status::grpc)?;
        let done = caller.correct_object(&r.session_id, r.object_id, correction, r.learn).await;
        let (objects, map_version) = done.map_err(status::grpc)?;
        let objects = objects.iter().map(scene::object_to).collect();
        Ok(Response::new(v1::CorrectObjectResponse { objects, map_version }))
    }

    async fn list_object_classes(
        &self,
        r: Request<v1::ListObjectClassesRequest>,
    ) -> Answer<v1::ListObjectClassesResponse> {
        let found = self.caller(&r)?.object_classes(&r.get_ref().session_id).await.map_err(status::grpc)?;
        let classes = found.iter().map(scene::class_info_to).collect();
        Ok(Response::new(v1::ListObjectClassesResponse { classes }))
    }

    async fn forget_object_class(
        &self,
        r: Request<v1::ForgetObjectClassRequest>,
    ) -> Answer<v1::ForgetObjectClassResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        caller.snapshot(FORGET, &r.session_id).await.map_err(status::grpc)?;
        let class = scene::class_named("label", &r.label).and_then(|class| required("label", class));
        let class = class.map_err(status::grpc)?;
        let forgotten = caller.forget_object_class(&r.session_id, class).await.map_err(status::grpc)?;
        let num_examples = u32::try_from(forgotten).unwrap_or(u32::MAX);
        Ok(Response::new(v1::ForgetObjectClassResponse { num_examples }))
    }

    async fn get_scene_graph(&self, r: Request<v1::GetSceneGraphRequest>) -> Answer<Self::GetSceneGraphStream> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        caller.snapshot(GRAPH, &r.session_id).await.map_err(status::grpc)?;
        let whose = scene::directions(r.directions, r.viewer_yaw_rad).map_err(status::grpc)?;
        let filter = scene::filter(r.filter.as_ref()).map_err(status::grpc)?;
        let since_at = (r.since_ns.map(Timestamp), r.at_ns.map(Timestamp));
        let graph = caller.scene_graph(&r.session_id, whose, filter, since_at).await.map_err(status::grpc)?;
        streamed(v1::GetSceneGraphResponse { graph: Some(scene::graph_to(&graph)) }.parts(), |part| part)
    }

    async fn get_rooms(&self, r: Request<v1::GetRoomsRequest>) -> Answer<Self::GetRoomsStream> {
        let found = self.caller(&r)?.rooms(&r.get_ref().session_id).await.map_err(status::grpc)?;
        streamed(rooms::rooms_to(&found, r.get_ref().with_places).parts(), |part| part)
    }

    async fn name_room(&self, r: Request<v1::NameRoomRequest>) -> Answer<v1::NameRoomResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let found = caller.name_room(&r.session_id, RoomId(r.room_id), &r.name).await.map_err(status::grpc)?;
        Ok(Response::new(v1::NameRoomResponse { room: rooms::one_to(&found, r.room_id) }))
    }

    async fn route_to_room(&self, r: Request<v1::RouteToRoomRequest>) -> Answer<v1::RouteToRoomResponse> {
        let caller = self.caller(&r)?;
        let r = r.into_inner();
        // Who may not ask learns nothing of what is wrong with the question.
        caller.snapshot(ROUTE, &r.session_id).await.map_err(status::grpc)?;
        let to = room_routes::wanted(r.room).map_err(status::grpc)?;
        let start = room_routes::start(r.start.as_ref()).map_err(status::grpc)?;
        let found = caller.route_to_room(&r.session_id, to, start).await.map_err(status::grpc)?;
        Ok(Response::new(room_routes::route_to(&found)))
    }
}
