//! `SceneService`.

use super::{Answer, Api, Streamed, status, streamed};
use percept_scene::rooms::RoomId;
use percept_wire::convert::{rooms, scene};
use percept_wire::parts::InParts;
use percept_wire::v1;
use tonic::{Request, Response};

const GRAPH: &str = "SceneService/GetSceneGraph";
const ROUTE: &str = "SceneService/RouteToRoom";

#[tonic::async_trait]
impl v1::scene_service_server::SceneService for Api {
    type GetSceneGraphStream = Streamed<v1::GetSceneGraphResponse>;
    type GetRoomsStream = Streamed<v1::GetRoomsResponse>;

    async fn list_objects(&self, r: Request<v1::ListObjectsRequest>) -> Answer<v1::ListObjectsResponse> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        let class = scene::optional_class(r.object_class).map_err(status::grpc)?;
        let listed = caller.list_objects(&r.session_id, class, r.include_gone, r.page_size, &r.page_token).await;
        let (page, map_version) = listed.map_err(status::grpc)?;
        let objects = page.items.iter().map(scene::object_to).collect();
        Ok(Response::new(v1::ListObjectsResponse { objects, next_page_token: page.next_page_token, map_version }))
    }

    async fn get_object(&self, r: Request<v1::GetObjectRequest>) -> Answer<v1::GetObjectResponse> {
        let caller = self.caller(&r)?;
        let object = caller.object(&r.get_ref().session_id, r.get_ref().object_id).await.map_err(status::grpc)?;
        Ok(Response::new(v1::GetObjectResponse { object: Some(scene::object_to(&object)) }))
    }

    async fn get_scene_graph(&self, r: Request<v1::GetSceneGraphRequest>) -> Answer<Self::GetSceneGraphStream> {
        let caller = self.caller(&r)?;
        let r = r.get_ref();
        caller.snapshot(GRAPH, &r.session_id).await.map_err(status::grpc)?;
        let whose = scene::directions(r.directions, r.viewer_yaw_rad).map_err(status::grpc)?;
        let filter = scene::filter(r.filter.as_ref()).map_err(status::grpc)?;
        let graph = caller.scene_graph(&r.session_id, whose, filter).await.map_err(status::grpc)?;
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
        let to = rooms::wanted(r.room).map_err(status::grpc)?;
        let start = rooms::start(r.start.as_ref()).map_err(status::grpc)?;
        let found = caller.route_to_room(&r.session_id, to, start).await.map_err(status::grpc)?;
        Ok(Response::new(rooms::route_to(&found)))
    }
}
