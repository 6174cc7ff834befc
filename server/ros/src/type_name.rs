//! Names of types: as people write them, and as DDS has them.

/// A type's name: package, kind of interface, name.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TypeName {
    package: String,
    kind: String,
    name: String,
}

/// Why a text is no type's name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "'{text}' is no type's name: write package/msg/Name, package/Name (ROS 1) or package::msg::dds_::Name_ (DDS), in letters, \
     digits and _"
)]
pub struct TypeNameError {
    /// Its beginning.
    text: String,
}

impl TypeName {
    /// From `sensor_msgs/msg/PointCloud2`, `sensor_msgs/PointCloud2` (ROS 1, ROS 2's short form) or
    /// `sensor_msgs::msg::dds_::PointCloud2_` (DDS).
    ///
    /// # Errors
    /// If it is none of these.
    pub fn parse(text: &str) -> Result<Self, TypeNameError> {
        let error = || TypeNameError { text: text.chars().take(120).collect() };
        let parts: Vec<&str> = if text.contains("::") { text.split("::").collect() } else { text.split('/').collect() };
        let [package, kind, name] = match parts[..] {
            [package, kind, "dds_", name] => [package, kind, name.strip_suffix('_').ok_or_else(error)?],
            [package, kind, name] => [package, kind, name],
            [package, name] => [package, "msg", name],
            _ => return Err(error()),
        };
        let is_word = |w: &str| !w.is_empty() && w.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
        if ![package, kind, name].into_iter().all(is_word) {
            return Err(error());
        }
        Ok(Self { package: package.to_owned(), kind: kind.to_owned(), name: name.to_owned() })
    }

    /// `sensor_msgs` of `sensor_msgs/msg/PointCloud2`.
    pub fn package(&self) -> &str {
        &self.package
    }

    /// `msg`, `srv` or `action`.
    pub fn kind(&self) -> &str {
        &self.kind
    }

    /// `PointCloud2` of `sensor_msgs/msg/PointCloud2`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// As DDS has it, `sensor_msgs::msg::dds_::PointCloud2_`.
    pub fn to_dds(&self) -> String {
        format!("{}::{}::dds_::{}_", self.package, self.kind, self.name)
    }

    /// As ROS 1 has it, `sensor_msgs/PointCloud2`.
    pub fn to_ros1(&self) -> String {
        format!("{}/{}", self.package, self.name)
    }
}

/// As ROS 2 has it, `sensor_msgs/msg/PointCloud2`.
impl std::fmt::Display for TypeName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}/{}", self.package, self.kind, self.name)
    }
}

impl std::str::FromStr for TypeName {
    type Err = TypeNameError;

    fn from_str(text: &str) -> Result<Self, TypeNameError> {
        Self::parse(text)
    }
}
