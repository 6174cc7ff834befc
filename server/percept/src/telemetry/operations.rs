//! The names of operations, as metrics, traces and the access log have them: `SessionsService/GetPose`.

use percept_wire::json;
use std::collections::HashMap;
use std::sync::LazyLock;

/// What no operation is known for: whoever asks for what does not exist makes no series of its own.
pub(crate) const UNKNOWN: &str = "unknown";

/// An operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Operation {
    pub(crate) name: &'static str,
    /// Whether it goes on until somebody ends it, so that its time says nothing.
    pub(crate) lasts: bool,
}

impl Operation {
    /// One that ends by itself.
    pub(crate) const fn brief(name: &'static str) -> Self {
        Self { name, lasts: false }
    }
}

/// A session that is open in Foxglove.
pub(crate) const FOXGLOVE: Operation = Operation { name: "Foxglove", lasts: true };

/// Services of the gRPC door that are not in the contract.
const OTHERS: [(&str, bool); 4] = [
    ("grpc.health.v1.Health/Check", false),
    ("grpc.health.v1.Health/Watch", true),
    ("grpc.reflection.v1.ServerReflection/ServerReflectionInfo", true),
    ("grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo", true),
];

/// By the path of the gRPC request.
static BY_PATH: LazyLock<HashMap<String, Operation>> = LazyLock::new(|| {
    let ours = json::pool().services().flat_map(|service| service.methods().collect::<Vec<_>>()).map(|method| {
        let (service, name) = (method.parent_service(), method.name());
        let is_stream = method.is_server_streaming() && (method.is_client_streaming() || name.starts_with("Watch"));
        // Who waits is answered when somebody else is done.
        let lasts = is_stream || name == "WaitOperation";
        // As many as the contract has, once.
        let named: &'static str = format!("{}/{name}", service.name()).leak();
        (format!("/{}/{name}", service.full_name()), Operation { name: named, lasts })
    });
    let others = OTHERS.map(|(name, lasts)| (format!("/{name}"), Operation { name, lasts }));
    ours.chain(others).collect()
});

/// The operation behind a path of the gRPC door.
pub(crate) fn of_path(path: &str) -> Operation {
    BY_PATH.get(path).copied().unwrap_or(Operation::brief(UNKNOWN))
}

/// The operation of the contract named `Service/Method`.
pub(crate) fn of_rpc(rpc: &str) -> Operation {
    of_path(&format!("/percept.v1.{rpc}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_are_those_of_the_contract() {
        assert_eq!(of_path("/percept.v1.SessionsService/GetPose"), Operation::brief("SessionsService/GetPose"));
        assert!(of_rpc("SessionsService/WatchSession").lasts);
        assert!(of_rpc("SensorsService/StreamFrames").lasts);
        assert!(of_rpc("OperationsService/WaitOperation").lasts);
        assert!(!of_rpc("MapsService/GetCloud").lasts);
        assert_eq!(of_path("/percept.v1.SessionsService/../etc").name, UNKNOWN);
    }
}
