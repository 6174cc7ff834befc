//! What operations there are, and how they stand.

/// What an operation does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum OperationKind {
    /// Makes the corrections of a map that wait for more.
    OptimiseMap,
    /// Writes a map as a file.
    ExportMap,
    /// Runs steps of the toolbox on a cloud.
    RunPipeline,
    /// Lays a cloud over another with no first guess.
    RegisterCloudsGlobally,
    /// Begins a session with a map.
    ImportMap,
}

impl OperationKind {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::OptimiseMap, Self::ExportMap, Self::RunPipeline, Self::RegisterCloudsGlobally, Self::ImportMap];

    /// The plain call, as the table of rules names it.
    pub const fn plain_call(self) -> &'static str {
        match self {
            Self::OptimiseMap => "MapsService/OptimiseMap",
            Self::ExportMap => "MapsService/ExportMap",
            Self::RunPipeline => "ToolboxPipelinesService/*",
            Self::RegisterCloudsGlobally => "ToolboxRegistrationService/*",
            Self::ImportMap => "MapsService/ImportMap",
        }
    }

    /// As metrics and logs spell it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::OptimiseMap => "optimise_map",
            Self::ExportMap => "export_map",
            Self::RunPipeline => "run_pipeline",
            Self::RegisterCloudsGlobally => "register_clouds_globally",
            Self::ImportMap => "import_map",
        }
    }
}

/// How an operation stands; the last three are ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum OperationState {
    /// Waits for its turn.
    Queued,
    /// Runs.
    Running,
    /// Has a result.
    Done,
    /// Has an error.
    Failed,
    /// Was cancelled before it was done.
    Cancelled,
}

impl OperationState {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Queued, Self::Running, Self::Done, Self::Failed, Self::Cancelled];

    /// As metrics spell it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Whether it changes no more.
    pub const fn is_end(self) -> bool {
        matches!(self, Self::Done | Self::Failed | Self::Cancelled)
    }
}
