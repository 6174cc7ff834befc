//! What zenoh-plugin-ros2dds, the bridge of DDS robots, writes on a zenoh network.
//!
//! Source: eclipse-zenoh/zenoh-plugin-ros2dds, README and what versions 1.x write. Its data keys are the topics alone, behind
//! the bridge's namespace; types are told by its liveliness tokens, `@/<zid>/@ros2_lv/<kind>/<key>/<type>/<qos>`, in which a
//! slash is written `§`. Payloads are CDR with encapsulation; attachments are not needed.

use crate::TypeName;
use crate::rmw_zenoh::{Durability, History, KeyError, Reliability, bare_topic};

/// What to ask for, and to subscribe to, for all tokens of all bridges.
pub const LIVELINESS_KEY: &str = "@/*/@ros2_lv/**";

/// The data key of a topic behind a bridge of this namespace; `/` or empty for none.
///
/// # Errors
/// `KeyError` if it cannot stand in a key.
pub fn data_key(namespace: &str, topic: &str) -> Result<String, KeyError> {
    let topic = bare_topic(topic)?;
    match namespace.trim_matches('/') {
        "" => Ok(topic.to_owned()),
        namespace => Ok(format!("{}/{topic}", bare_topic(namespace)?)),
    }
}

/// What a token is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum RouteKind {
    /// A publisher on the robot.
    Publisher,
    /// A subscription on the robot.
    Subscription,
    /// A service's server.
    Service,
    /// A service's client.
    Client,
    /// An action's server.
    ActionServer,
    /// An action's client.
    ActionClient,
}

impl RouteKind {
    const ALL: [(Self, &'static str); 6] = [
        (Self::Publisher, "MP"),
        (Self::Subscription, "MS"),
        (Self::Service, "SS"),
        (Self::Client, "SC"),
        (Self::ActionServer, "AS"),
        (Self::ActionClient, "AC"),
    ];
}

/// A bridge's token.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct RouteToken {
    /// Id of the bridge's zenoh session.
    pub zid: String,
    /// What it is of.
    pub kind: RouteKind,
    /// The data key: samples are put there.
    pub key: String,
    /// Type.
    pub type_name: TypeName,
    /// Quality of service; of publishers and subscriptions alone.
    pub qos: Option<RouteQos>,
}

/// Quality of service in a token, `[K]:rel:dur:hist,depth`: what is none was not said.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct RouteQos {
    /// Whether the DDS topic has no key; ROS topics have none.
    pub is_keyless: bool,
    /// Whether samples may be lost.
    pub reliability: Option<Reliability>,
    /// Whether late joiners get what was sent before.
    pub durability: Option<Durability>,
    /// What is kept.
    pub history: Option<History>,
}

const WHAT: &str = "ros2dds token";
const SLASH: char = '§';

impl RouteToken {
    /// From a token's key as zenoh gives it; with the prefix of versions before 1.0 (`@ros2_lv/<zid>/`), too.
    ///
    /// # Errors
    /// `KeyError` naming the part that is wrong.
    pub fn parse(key: &str) -> Result<Self, KeyError> {
        let error = |part, found: &str, expected| KeyError::new(WHAT, key, part, found, expected);
        let parts: Vec<&str> = key.split('/').collect();
        let (zid, rest) = match &parts[..] {
            ["@", zid, "@ros2_lv", rest @ ..] | ["@ros2_lv", zid, rest @ ..] => (*zid, rest),
            _ => return Err(error("prefix", key, "@/<zid>/@ros2_lv/")),
        };
        let (letters, route, name, qos) = match *rest {
            [letters, route, name] => (letters, route, name, None),
            [letters, route, name, qos] => (letters, route, name, Some(qos)),
            _ => return Err(error("key", key, "<kind>/<key>/<type>, and /<qos> of topics")),
        };
        let kind = RouteKind::ALL.iter().find(|(_, l)| *l == letters).map(|(kind, _)| *kind);
        let kind = kind.ok_or_else(|| error("kind", letters, "MP, MS, SS, SC, AS or AC"))?;
        let slashes = |part: &str| part.replace(SLASH, "/");
        let type_name = TypeName::parse(&slashes(name)).map_err(|_| error("type", name, "package§msg§Name"))?;
        let route = slashes(route);
        let key = bare_topic(&route)?.to_owned();
        let expected = "[K]:reliability:durability:history,depth in numbers, or empty";
        let qos =
            qos.map(|text| qos_of(text).ok_or_else(|| error("quality of service", text, expected))).transpose()?;
        Ok(Self { zid: zid.to_owned(), kind, key, type_name, qos })
    }
}

/// The token's key, as 1.x writes it.
impl std::fmt::Display for RouteToken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let letters = RouteKind::ALL.iter().find(|(kind, _)| *kind == self.kind).map_or("", |(_, letters)| letters);
        let sections = |text: &str| text.replace('/', "§");
        let (key, name) = (sections(&self.key), sections(&self.type_name.to_string()));
        write!(f, "@/{}/@ros2_lv/{letters}/{key}/{name}", self.zid)?;
        self.qos.map_or(Ok(()), |qos| write!(f, "/{qos}"))
    }
}

impl std::str::FromStr for RouteToken {
    type Err = KeyError;

    fn from_str(text: &str) -> Result<Self, KeyError> {
        Self::parse(text)
    }
}

/// By DDS's own numbers, which are not those of ROS: reliability 0 best effort, 1 reliable; durability 0 volatile, 1 transient
/// local, 2 and 3 more durable still; history 0 keep last, 1 keep all.
fn qos_of(text: &str) -> Option<RouteQos> {
    let [keyed, reliability, durability, history] = text.split(':').collect::<Vec<_>>().try_into().ok()?;
    let reliability = match reliability {
        "" => None,
        "0" => Some(Reliability::BestEffort),
        "1" => Some(Reliability::Reliable),
        _ => return None,
    };
    let durability = match durability {
        "" => None,
        "0" => Some(Durability::Volatile),
        "1" | "2" | "3" => Some(Durability::TransientLocal),
        _ => return None,
    };
    let history = match history.split_once(',') {
        None if history.is_empty() => None,
        Some(("0", depth)) => Some(History::KeepLast(depth.parse().ok()?)),
        // Its depth says nothing; -1 or 0 stands there.
        Some(("1", _)) => Some(History::KeepAll),
        _ => return None,
    };
    let is_keyless = match keyed {
        "" => true,
        "K" => false,
        _ => return None,
    };
    Some(RouteQos { is_keyless, reliability, durability, history })
}

impl std::fmt::Display for RouteQos {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let keyed = if self.is_keyless { "" } else { "K" };
        let reliability = self.reliability.map_or("", |r| if r == Reliability::Reliable { "1" } else { "0" });
        let durability = self.durability.map_or("", |d| if d == Durability::TransientLocal { "1" } else { "0" });
        write!(f, "{keyed}:{reliability}:{durability}:")?;
        match self.history {
            Some(History::KeepLast(depth)) => write!(f, "0,{depth}"),
            Some(History::KeepAll) => f.write_str("1,0"),
            None => Ok(()),
        }
    }
}
