//! Liveliness tokens: who is there, and what it publishes, subscribes to, serves and calls.
//!
//! `@ros2_lv/<domain>/<zid>/<node id>/<entity id>/<kind>/<enclave>/<namespace>/<node>`, and for all but nodes
//! `/<topic>/<type>/<hash>/<qos>`. A slash inside a part is written `%`. What later releases append is not looked at.

use super::{KeyError, Qos};
use crate::{TypeHash, TypeName};

/// A liveliness token.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct LivelinessToken {
    /// ROS domain.
    pub domain: u32,
    /// Id of the zenoh session, hexadecimal.
    pub zid: String,
    /// Number of the node in its session.
    pub node_id: u64,
    /// Number of the entity in its session; a node's is its own.
    pub entity_id: u64,
    /// What it is.
    pub kind: EntityKind,
    /// Security enclave; `/` for none.
    pub enclave: String,
    /// Namespace of the node; `/` for none.
    pub namespace: String,
    /// Name of the node.
    pub node: String,
    /// What it publishes, subscribes to, serves or calls; none for a node.
    pub endpoint: Option<Endpoint>,
}

/// The end of a topic or of a service.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Endpoint {
    /// Topic or service, `/robot/scan`.
    pub topic: String,
    /// Type.
    pub type_name: TypeName,
    /// Hash of the type.
    pub type_hash: TypeHash,
    /// Quality of service.
    pub qos: Qos,
}

/// What a token is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum EntityKind {
    /// A node.
    Node,
    /// A publisher.
    Publisher,
    /// A subscription.
    Subscription,
    /// A service's server.
    Service,
    /// A service's client.
    Client,
}

impl EntityKind {
    const ALL: [(Self, &'static str); 5] = [
        (Self::Node, "NN"),
        (Self::Publisher, "MP"),
        (Self::Subscription, "MS"),
        (Self::Service, "SS"),
        (Self::Client, "SC"),
    ];

    fn letters(self) -> &'static str {
        Self::ALL.iter().find(|(kind, _)| *kind == self).map_or("", |(_, letters)| letters)
    }
}

const WHAT: &str = "liveliness token";
const PREFIX: &str = "@ros2_lv";

/// What to ask for, and to subscribe to, for the tokens of a domain.
pub fn liveliness_key(domain: u32) -> String {
    format!("{PREFIX}/{domain}/**")
}

/// A name as a part of a token: slashes as `%`, and `%` if there is none.
fn mangled(name: &str) -> String {
    if name.is_empty() { "%".to_owned() } else { name.replace('/', "%") }
}

fn demangled(part: &str) -> String {
    part.replace('%', "/")
}

impl LivelinessToken {
    /// From a token's key as zenoh gives it.
    ///
    /// # Errors
    /// `KeyError` naming the part that is wrong.
    pub fn parse(key: &str) -> Result<Self, KeyError> {
        let error = |part, found: &str, expected| KeyError::new(WHAT, key, part, found, expected);
        let mut parts = key.split('/');
        let mut next =
            |part| parts.next().filter(|p| !p.is_empty()).ok_or_else(|| error(part, "", "a name that is not empty"));
        let prefix = next("prefix")?;
        if prefix != PREFIX {
            return Err(error("prefix", prefix, PREFIX));
        }
        let number = |part, text: &str| text.parse::<u64>().map_err(|_| error(part, text, "a number"));
        let domain = next("domain")?;
        let domain = domain.parse().map_err(|_| error("domain", domain, "a ROS domain, 0 to 232"))?;
        let zid = next("zid")?.to_owned();
        let node_id = number("node id", next("node id")?)?;
        let entity_id = number("entity id", next("entity id")?)?;
        let letters = next("kind")?;
        let kind = EntityKind::ALL.iter().find(|(_, l)| *l == letters).map(|(kind, _)| *kind);
        let kind = kind.ok_or_else(|| error("kind", letters, "NN, MP, MS, SS or SC"))?;
        let [enclave, namespace, node] = [next("enclave")?, next("namespace")?, next("node")?].map(demangled);
        let endpoint = if kind == EntityKind::Node {
            None
        } else {
            let [topic, name, hash, qos] =
                [next("topic")?, next("type")?, next("type hash")?, next("quality of service")?];
            let type_name = TypeName::parse(&demangled(name));
            Some(Endpoint {
                topic: demangled(topic),
                type_name: type_name.map_err(|_| error("type", name, "package::msg::dds_::Name_"))?,
                type_hash: hash.parse().map_err(|_| error("type hash", hash, "RIHS01_ and 64 hexadecimal digits"))?,
                qos: Qos::parse(qos)?,
            })
        };
        Ok(Self { domain, zid, node_id, entity_id, kind, enclave, namespace, node, endpoint })
    }
}

/// The token's key.
impl std::fmt::Display for LivelinessToken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { domain, zid, node_id, entity_id, kind, .. } = self;
        let [enclave, namespace, node] = [&self.enclave, &self.namespace, &self.node].map(|n| mangled(n));
        let kind = kind.letters();
        write!(f, "{PREFIX}/{domain}/{zid}/{node_id}/{entity_id}/{kind}/{enclave}/{namespace}/{node}")?;
        match &self.endpoint {
            Some(Endpoint { topic, type_name, type_hash, qos }) => {
                write!(f, "/{}/{}/{type_hash}/{qos}", mangled(topic), type_name.to_dds())
            }
            None => Ok(()),
        }
    }
}

impl std::str::FromStr for LivelinessToken {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<Self, KeyError> {
        Self::parse(text)
    }
}
