//! Operations: each is started if the plain call that it stands for may be made, and looked after by its owner alone.
//!
//! When its turn comes the session is asked for once more, since it may be another tenant's by then; the credentials are
//! not, since tokens are renewed while work waits.

use super::audit::Act;
use super::{Caller, rules};
use crate::ops::map_import::{GivenMap, ImportOptions, ImportedMap, READING, STEPS};
use crate::ops::operations::{Work, budget};
use crate::ops::toolbox::{SessionCloud, Toolbox};
use crate::{
    MapFile, MapFormat, Moved, NewOperation, Operation, OperationKind, OperationList, Page, Progress, Result, check_id,
};
use bytes::Bytes;
use futures::FutureExt;
use percept_identity::Access;
use std::sync::Arc;
use std::time::{Duration, Instant};

const RULE: &str = "OperationsService/*";
/// An answer needs so long to arrive before a caller's deadline: a quarter of the time that is left, within these bounds.
const ON_THE_WAY: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(5)];

/// How an operation is started, whatever it does.
#[derive(Debug, Clone)]
pub struct OperationStart {
    request_id: String,
    request_bytes: usize,
}

impl OperationStart {
    /// `request_id` makes the start idempotent, unless it is empty; the request holds so much memory until it is done.
    ///
    /// # Errors
    /// `ID_INVALID`.
    pub fn new(request_id: String, request_bytes: usize) -> Result<Self> {
        if !request_id.is_empty() {
            check_id("request_id", &request_id)?;
        }
        Ok(Self { request_id, request_bytes })
    }

    fn of(self, kind: OperationKind, session: &str, needs: Vec<(Access, String)>) -> NewOperation {
        let Self { request_id, request_bytes } = self;
        NewOperation { kind, session: session.to_owned(), request_id, request_bytes, needs }
    }
}

/// Starting. `answer` makes the encoded parts of what the plain call would have answered.
impl Caller {
    /// [`optimise_map`](Self::optimise_map) as an operation.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `PERMISSION_DENIED`; limits of operations.
    pub async fn start_optimise_map(
        &self,
        start: OperationStart,
        session: &str,
        answer: impl FnOnce(Moved) -> Vec<Bytes> + Send + 'static,
    ) -> Result<Operation> {
        let kind = OperationKind::OptimiseMap;
        let needs = self.may_start_with(kind, session).await?;
        let (caller, id) = (self.clone(), session.to_owned());
        let work = move |progress: Progress| {
            async move {
                caller.granted(kind.plain_call(), &id).await?;
                caller.service.optimise_map_telling(&id, &progress).await.map(answer)
            }
            .boxed()
        };
        self.start(start.of(kind, session, needs), Box::new(work))
    }

    /// [`export_map`](Self::export_map) as an operation.
    ///
    /// # Errors
    /// `SESSION_NOT_FOUND`, `PERMISSION_DENIED`; limits of operations.
    pub async fn start_export_map(
        &self,
        start: OperationStart,
        session: &str,
        format: MapFormat,
        answer: impl FnOnce(MapFile) -> Vec<Bytes> + Send + 'static,
    ) -> Result<Operation> {
        let kind = OperationKind::ExportMap;
        let needs = self.may_start_with(kind, session).await?;
        let (caller, id) = (self.clone(), session.to_owned());
        let work = move |progress: Progress| {
            async move {
                caller.granted(kind.plain_call(), &id).await?;
                caller.service.export_map_telling(&id, format, progress, |file| Ok(answer(file))).await
            }
            .boxed()
        };
        self.start(start.of(kind, session, needs), Box::new(work))
    }

    /// [`import_map`](Self::import_map) as an operation. A session that has a map already, and options that are none, are refused at
    /// once; what is wrong with the map is the operation's error.
    ///
    /// # Errors
    /// `MAP_NOT_EMPTY`, `OUT_OF_RANGE`, `SESSION_NOT_FOUND`, `PERMISSION_DENIED`; limits of operations.
    pub async fn start_import_map(
        &self,
        start: OperationStart,
        session: &str,
        wanted: Vec<SessionCloud>,
        read: impl FnOnce(&Toolbox) -> Result<GivenMap> + Send + 'static,
        options: ImportOptions,
        answer: impl FnOnce(ImportedMap) -> Vec<Bytes> + Send + 'static,
    ) -> Result<Operation> {
        let kind = OperationKind::ImportMap;
        let needs = self.may_start_with(kind, session).await?;
        self.may_use(&wanted).await?;
        // One that was started with this id is told again, though its map is in by now.
        if let Some(known) = self.service.started_operation(&self.owner(), &start.request_id) {
            return Ok(known);
        }
        self.service.check_import(session, &options).await?;
        let (caller, id, budget) = (self.clone(), session.to_owned(), budget(self.limits()));
        let work = move |progress: Progress| {
            async move {
                caller.granted(kind.plain_call(), &id).await?;
                for wanted in &wanted {
                    caller
                        .granted("MapsService/GetCloud", &wanted.session)
                        .await
                        .map_err(|e| e.within(&wanted.field))?;
                }
                let stood = caller.service.stood_in(&wanted).await?;
                let maps = caller.service.session_clouds(wanted).await?;
                progress.step(READING, STEPS, "reading it");
                let given = caller.service.toolbox_within(caller.owner(), maps, budget, progress.clone(), read).await?;
                let given = given.with_stood(stood);
                let act = Act::begin(&caller.context, kind.plain_call(), &id);
                let done = caller.service.import_map_telling(&id, given, options, &progress).await;
                act.end(&done);
                done.map(answer)
            }
            .boxed()
        };
        self.start(start.of(kind, session, needs), Box::new(work))
    }

    /// [`toolbox`](Self::toolbox) as an operation of a kind that the toolbox has.
    ///
    /// # Errors
    /// `PERMISSION_DENIED`, `SESSION_NOT_FOUND` of what it works on; limits of operations.
    pub async fn start_toolbox(
        &self,
        start: OperationStart,
        kind: OperationKind,
        wanted: Vec<SessionCloud>,
        work: impl FnOnce(&Toolbox) -> Result<Vec<Bytes>> + Send + 'static,
    ) -> Result<Operation> {
        self.may(RULE)?;
        self.may(kind.plain_call())?;
        self.may_use(&wanted).await?;
        let mut needs = vec![(rules::own(kind.plain_call())?.access, String::new())];
        needs.extend(wanted.iter().map(|w| (Access::Read, w.session.clone())));
        let (caller, budget) = (self.clone(), budget(self.limits()));
        let work = move |progress: Progress| {
            async move {
                for wanted in &wanted {
                    caller
                        .granted("MapsService/GetCloud", &wanted.session)
                        .await
                        .map_err(|e| e.within(&wanted.field))?;
                }
                let maps = caller.service.session_clouds(wanted).await?;
                caller.service.toolbox_within(caller.owner(), maps, budget, progress, work).await
            }
            .boxed()
        };
        self.start(start.of(kind, "", needs), Box::new(work))
    }

    async fn may_start_with(&self, kind: OperationKind, session: &str) -> Result<Vec<(Access, String)>> {
        self.may(RULE)?;
        self.may_with(kind.plain_call(), session).await?;
        Ok(vec![(rules::own(kind.plain_call())?.access, session.to_owned())])
    }

    fn start(&self, new: NewOperation, work: Work) -> Result<Operation> {
        self.service.start_operation(&self.owner(), new, work)
    }
}

/// Looking after them.
impl Caller {
    /// How one stands.
    ///
    /// # Errors
    /// `OPERATION_NOT_FOUND`.
    pub fn operation(&self, id: &str) -> Result<Operation> {
        self.may(RULE)?;
        self.service.operation(&self.owner(), id)
    }

    /// The caller's own, oldest first.
    ///
    /// # Errors
    /// `PAGE_TOKEN_INVALID`.
    pub fn list_operations(&self, list: &OperationList) -> Result<Page<Operation>> {
        self.may(RULE)?;
        self.service.list_operations(&self.owner(), list)
    }

    /// How one stands once it has ended, or when the time, or the caller's, is over.
    ///
    /// # Errors
    /// `OPERATION_NOT_FOUND`, `OUT_OF_RANGE`; `CREDENTIALS_EXPIRED`.
    pub async fn wait_operation(&self, id: &str, timeout_s: Option<f64>) -> Result<Operation> {
        self.may(RULE)?;
        let left = |deadline: Instant| {
            let left = deadline.saturating_duration_since(Instant::now());
            left.saturating_sub((left / 4).clamp(ON_THE_WAY[0], ON_THE_WAY[1]))
        };
        let timeout_s = match (timeout_s, self.context.deadline.map(|d| left(d).as_secs_f64())) {
            // What is no time at all is for the operation to refuse.
            (Some(asked), Some(left)) if asked > left => Some(left),
            (None, left) => left,
            (asked, _) => asked,
        };
        let owner = self.owner();
        tokio::select! {
            waited = self.service.wait_operation(&owner, id, timeout_s) => waited,
            error = self.ended() => Err(error),
        }
    }

    /// Ends one that waits, and asks one that runs to end.
    ///
    /// # Errors
    /// `OPERATION_NOT_FOUND`.
    pub fn cancel_operation(&self, id: &str) -> Result<Operation> {
        self.may(RULE)?;
        self.service.cancel_operation(&self.owner(), id)
    }

    /// The encoded parts of a result.
    ///
    /// # Errors
    /// `OPERATION_NOT_FOUND`, `OPERATION_NOT_DONE`, `PERMISSION_DENIED`; what the operation failed of.
    pub fn operation_result(&self, id: &str) -> Result<Arc<Vec<Bytes>>> {
        self.may(RULE)?;
        self.service.operation_result(&self.owner(), id, &self.context.principal)
    }

    /// Forgets one that has ended.
    ///
    /// # Errors
    /// `OPERATION_NOT_FOUND`, `OPERATION_UNDER_WAY`.
    pub fn delete_operation(&self, id: &str) -> Result<()> {
        self.may(RULE)?;
        self.service.delete_operation(&self.owner(), id)
    }
}
