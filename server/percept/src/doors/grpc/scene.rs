//! `SceneService`.

use super::{Answer, Api, Streamed, status, streamed};
use percept_wire::parts::InParts;
use percept_wire::{convert::scene, v1};
use tonic::{Request, Response};

#[tonic::async_trait]
impl v1::scene_service_server::SceneService for Api {
    type GetSceneGraphStream = Streamed<v1::GetSceneGraphResponse>;

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
        let graph = caller.scene_graph(&r.get_ref().session_id).await.map_err(status::grpc)?;
        streamed(v1::GetSceneGraphResponse { graph: Some(scene::graph_to(&graph)) }.parts(), |part| part)
    }
}
