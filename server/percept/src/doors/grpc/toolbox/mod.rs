//! The toolbox's services: every rpc decodes, calls and encodes on the pool, in the file of its group.

/// A service of the toolbox: rpcs that answer in one message, and in parts, by the functions of their names.
macro_rules! operations {
    (
        $server:ident::$service:ident, $rule:literal,
        one { $($one:ident($asked:ident) -> $answer:ident,)* }
        parts { $($many:ident($request:ident) -> $part:ident as $stream:ident,)* }
    ) => {
        #[tonic::async_trait]
        impl v1::$server::$service for crate::doors::grpc::Api {
            $(type $stream = crate::doors::grpc::Streamed<v1::$part>;)*

            $(async fn $one(&self, r: tonic::Request<v1::$asked>) -> crate::doors::grpc::Answer<v1::$answer> {
                self.toolbox($rule, r, $one).await
            })*

            $(async fn $many(&self, r: tonic::Request<v1::$request>) -> crate::doors::grpc::Answer<Self::$stream> {
                self.toolbox_in_parts($rule, r, $many).await
            })*
        }
    };
}

mod clouds;
mod depth;
mod images;
mod kept_clouds;
mod pictures;
mod pipelines;
mod planning;
mod registration;
mod segmentation;
mod shapes;

pub(super) use pipelines::run_pipeline;
pub(super) use registration::register_clouds_globally;

use super::{Answer, Api, Streamed, check_size, status, streamed};
use percept_service::Result;
use percept_service::toolbox::Toolbox;
use percept_wire::convert::toolbox::sources::{Sources, session_clouds};
use percept_wire::parts::InParts;
use tonic::{Request, Response};

impl Api {
    /// A request of the operation in the table of rules.
    async fn toolbox<Q, A>(&self, rule: &'static str, r: Request<Q>, run: fn(&Toolbox, Q) -> Result<A>) -> Answer<A>
    where
        Q: prost::Message + Sources + 'static,
        A: Send + 'static,
    {
        self.tooled(rule, r, run).await.map(Response::new)
    }

    /// The same, its answer in parts.
    async fn toolbox_in_parts<Q, A>(
        &self,
        rule: &'static str,
        r: Request<Q>,
        run: fn(&Toolbox, Q) -> Result<A>,
    ) -> Answer<Streamed<A>>
    where
        Q: prost::Message + Sources + 'static,
        A: InParts + Send + 'static,
    {
        streamed(self.tooled(rule, r, move |t, q| run(t, q).map(InParts::parts)).await?, |part| part)
    }

    async fn tooled<Q, A>(
        &self,
        rule: &'static str,
        r: Request<Q>,
        run: impl FnOnce(&Toolbox, Q) -> Result<A> + Send + 'static,
    ) -> std::result::Result<A, tonic::Status>
    where
        Q: prost::Message + Sources + 'static,
        A: Send + 'static,
    {
        let caller = self.caller(&r)?;
        caller.may(rule).map_err(status::grpc)?;
        check_size(r.get_ref(), self).map_err(status::grpc)?;
        let r = r.into_inner();
        let maps = session_clouds(&r).map_err(status::grpc)?;
        caller.toolbox(rule, maps, move |t| run(t, r)).await.map_err(status::grpc)
    }
}
