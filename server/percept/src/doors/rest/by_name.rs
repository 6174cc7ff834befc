//! Rpcs about a session by their names, for the door that has no routes.

use super::super::grpc::Api;
use super::super::status::{self, Problem};
use super::calls::Call;
use super::fields;
use super::routes::{Bound, Kind};
use super::transcode::{self, Format};
use bytes::Bytes;
use percept_identity::Access;
use percept_service::caller::rules::{About, rule};
use percept_service::{CallContext, Error};
use prost_reflect::MethodDescriptor;
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// An rpc about a session that is answered and over.
pub(in crate::doors) struct ByName {
    /// `Service/Method` in `percept.v1`.
    pub(in crate::doors) name: &'static str,
    /// The least access that it takes.
    pub(in crate::doors) access: Access,
    rpc: MethodDescriptor,
    call: Call,
    /// The dotted field of the request that names the session.
    session: &'static str,
}

static ALL: LazyLock<BTreeMap<&'static str, ByName>> = LazyLock::new(|| {
    let bound = Bound::all().unwrap_or_default();
    bound.into_iter().filter_map(ByName::of).map(|known| (known.name, known)).collect()
});

/// All of them, by name.
pub(in crate::doors) fn all() -> impl Iterator<Item = &'static ByName> {
    ALL.values()
}

/// The one of a name.
pub(in crate::doors) fn find(name: &str) -> Option<&'static ByName> {
    ALL.get(name)
}

impl ByName {
    fn of(bound: Bound) -> Option<Self> {
        let Bound { route, rpc } = bound;
        let (Kind::Message(call) | Kind::Tagged(call, _) | Kind::SceneGraph(call) | Kind::Picture(call)) = route.kind
        else {
            return None;
        };
        let rule = rule(route.rpc).filter(|rule| rule.about == About::Session)?;
        // What creates a session has no session in its path.
        let session =
            route.fill.iter().find(|(name, _)| *name == "session_id").map_or("session_id", |(_, field)| field);
        Some(Self { name: route.rpc, access: rule.access, rpc, call, session })
    }

    /// The encoded answer to an encoded request, which may leave the session out.
    ///
    /// # Errors
    /// `PROTOBUF_INVALID`; `PATH_MISMATCH` if the request names another session; those of the rpc.
    pub(in crate::doors) async fn answer(
        &self,
        api: &Api,
        context: CallContext,
        session: &str,
        request: Bytes,
    ) -> Result<Vec<u8>, Problem> {
        let request = self.request(session, request).await?;
        (self.call)(api.clone(), context, request).await.map_err(|refused| status::from_grpc(&refused))
    }

    async fn request(&self, session: &str, request: Bytes) -> Result<Bytes, Error> {
        let is_large = transcode::is_large(&request);
        let mut message = transcode::decode(self.rpc.input(), Format::Protobuf, request).await?;
        fields::fill_from_path(&mut message, "session", self.session, session)?;
        transcode::encoded(message, is_large).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use percept_service::caller::rules::RULES;

    #[test]
    fn every_rpc_about_a_session_is_there_but_those_that_go_on_or_are_files() {
        let about = RULES.iter().filter(|rule| rule.about == About::Session).map(|rule| rule.operation);
        let left: Vec<&str> = about.filter(|name| find(name).is_none()).collect();
        let lasting = [
            "SessionsService/WatchSession",
            "SensorsService/StreamFrames",
            "MapsService/ExportMap",
            "NavigationService/WatchPath",
        ];
        assert_eq!(left, lasting);
        assert!(find("SessionsService/ListSessions").is_none() && find("ToolboxCloudsService/CropCloud").is_none());
    }

    #[test]
    fn every_one_has_a_field_for_the_session() {
        for known in all() {
            let names: Vec<String> = fields::leaves(&known.rpc.input()).into_iter().map(|(path, _)| path).collect();
            assert!(names.iter().any(|name| name == known.session), "{}: {}", known.name, known.session);
        }
    }
}
