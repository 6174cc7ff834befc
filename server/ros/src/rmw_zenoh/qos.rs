//! Quality of service in a token: `rel:dur:hist,depth:dl_s,dl_ns:ls_s,ls_ns:lv,lv_s,lv_ns`, defaults left empty.

use super::KeyError;
use std::fmt::Write as _;

/// Quality of service of a publisher, subscription, service or client.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Qos {
    /// Whether samples may be lost.
    pub reliability: Reliability,
    /// Whether late joiners get what was sent before.
    pub durability: Durability,
    /// What is kept.
    pub history: History,
    /// Longest time between samples.
    pub deadline: QosDuration,
    /// How long a sample is worth something.
    pub lifespan: QosDuration,
    /// Who says that a publisher is alive.
    pub liveliness: Liveliness,
    /// How long it is taken to be alive without a word.
    pub liveliness_lease: QosDuration,
}

/// Whether samples may be lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Reliability {
    /// None is lost, if they are kept (`KeepAll`); else congestion still drops.
    #[default]
    Reliable,
    /// The newest are worth more than all.
    BestEffort,
}

/// Whether late joiners get what was sent before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Durability {
    /// They do not.
    #[default]
    Volatile,
    /// They do: `/tf_static`, `/map`, `/robot_description`.
    TransientLocal,
}

/// What is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum History {
    /// That many samples.
    KeepLast(u32),
    /// All of them.
    KeepAll,
}

impl Default for History {
    /// 42, which an empty depth stands for (`rmw_zenoh_cpp`, `qos.cpp`). ROS nodes ask for 10 as a rule, and write it.
    fn default() -> Self {
        Self::KeepLast(42)
    }
}

/// Who says that a publisher is alive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Liveliness {
    /// The middleware.
    #[default]
    Automatic,
    /// The publisher itself.
    ManualByTopic,
}

/// Seconds and nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct QosDuration {
    /// Seconds.
    pub sec: u64,
    /// Nanoseconds after them.
    pub nsec: u64,
}

impl QosDuration {
    /// For ever: `RMW_DURATION_INFINITE`.
    pub const INFINITE: Self = Self { sec: 9_223_372_036, nsec: 854_775_807 };
}

impl Default for QosDuration {
    fn default() -> Self {
        Self::INFINITE
    }
}

const EXPECTED: &str = "rel:dur:hist,depth:sec,nsec:sec,nsec:liveliness,sec,nsec in numbers, or empty for defaults";

/// A number, or what an empty place stands for.
fn number<T: std::str::FromStr>(text: Option<&str>, default: T) -> Option<T> {
    match text {
        None | Some("") => Some(default),
        Some(text) => text.parse().ok(),
    }
}

fn duration<'a>(mut parts: impl Iterator<Item = &'a str>) -> Option<QosDuration> {
    let QosDuration { sec, nsec } = QosDuration::INFINITE;
    Some(QosDuration { sec: number(parts.next(), sec)?, nsec: number(parts.next(), nsec)? })
}

impl Qos {
    /// From the text of a token; what an older release leaves out at the end has its default.
    ///
    /// # Errors
    /// `KeyError` if it is not of that form.
    pub fn parse(text: &str) -> Result<Self, KeyError> {
        Self::read(text).ok_or_else(|| KeyError::new("quality of service", text, "text", text, EXPECTED))
    }

    fn read(text: &str) -> Option<Self> {
        let mut parts = text.split(':');
        // 0 is 'the system's default', 3 and 4 are 'unknown' and 'best available': none of them says more than the default.
        let reliability = match number(parts.next(), 1u8)? {
            2 => Reliability::BestEffort,
            0 | 1 | 3 | 4 => Reliability::Reliable,
            _ => return None,
        };
        let durability = match number(parts.next(), 2u8)? {
            1 => Durability::TransientLocal,
            0 | 2 | 3 | 4 => Durability::Volatile,
            _ => return None,
        };
        let mut history = parts.next()?.split(',');
        let kind = number(history.next(), 1u8)?;
        let depth = match number(history.next(), 42)? {
            0 => 42,
            depth => depth,
        };
        let history = match kind {
            2 => History::KeepAll,
            0 | 1 | 3 => History::KeepLast(depth),
            _ => return None,
        };
        let deadline = duration(parts.next().unwrap_or("").split(','))?;
        let lifespan = duration(parts.next().unwrap_or("").split(','))?;
        let mut last = parts.next().unwrap_or("").split(',');
        let liveliness = match number(last.next(), 1u8)? {
            3 => Liveliness::ManualByTopic,
            0 | 1 | 4 | 5 => Liveliness::Automatic,
            _ => return None,
        };
        let liveliness_lease = duration(last)?;
        let qos = Self { reliability, durability, history, deadline, lifespan, liveliness, liveliness_lease };
        parts.next().is_none().then_some(qos)
    }
}

/// The text of a token; what is as by default is left empty, as `rmw_zenoh_cpp` does.
impl std::fmt::Display for Qos {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let duration = |d: QosDuration| {
            let mut out = String::new();
            let part = |value: u64, default: u64| if value == default { String::new() } else { value.to_string() };
            let QosDuration { sec, nsec } = QosDuration::INFINITE;
            // Writing to a string does not fail.
            let _ = write!(out, "{},{}", part(d.sec, sec), part(d.nsec, nsec));
            out
        };
        let reliability = if self.reliability == Reliability::BestEffort { "2" } else { "" };
        let durability = if self.durability == Durability::TransientLocal { "1" } else { "" };
        let history = match self.history {
            History::KeepLast(42) => ",".to_owned(),
            History::KeepLast(depth) => format!(",{depth}"),
            History::KeepAll => "2,".to_owned(),
        };
        let liveliness = if self.liveliness == Liveliness::ManualByTopic { "3" } else { "" };
        let (deadline, lifespan) = (duration(self.deadline), duration(self.lifespan));
        let lease = duration(self.liveliness_lease);
        write!(f, "{reliability}:{durability}:{history}:{deadline}:{lifespan}:{liveliness},{lease}")
    }
}
