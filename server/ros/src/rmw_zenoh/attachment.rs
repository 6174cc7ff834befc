//! What goes along with each sample, without which ROS subscribers refuse it.

/// Number, time and origin of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Attachment {
    /// Counts the publisher's samples, from 1; of a service, its requests.
    pub sequence: i64,
    /// When it was published, ns since the Unix epoch.
    pub source_time_ns: i64,
    /// The publisher's identity, opaque: equal for all of its samples.
    pub gid: [u8; 16],
}

/// Why bytes are no attachment.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "attachment of {length} bytes, byte {byte}: {field} is not there as rmw_zenoh writes it: sequence and time as i64, 16 and \
     the 16 bytes of the gid (33 bytes in all), or the same with labels before jazzy 0.2.4"
)]
pub struct AttachmentError {
    /// What was looked for.
    pub field: &'static str,
    /// Where it should have begun.
    pub byte: usize,
    /// Bytes that there are.
    pub length: usize,
}

const GID_BYTES: u8 = 16;

impl Attachment {
    /// From either layout: values alone, or each behind its label (before jazzy 0.2.4). What follows is not looked at.
    ///
    /// # Errors
    /// `AttachmentError` naming the field that is not there.
    pub fn parse(bytes: &[u8]) -> Result<Self, AttachmentError> {
        // The number of a sample is never so large that its bytes spell the label.
        let has_labels = bytes.starts_with(b"\x0fsequence_number");
        let mut at = 0;
        let mut take = |field: &'static str| {
            let error = AttachmentError { field, byte: at, length: bytes.len() };
            let mut rest = bytes.get(at..).ok_or(error.clone())?;
            if has_labels {
                let (&length, label) = rest.split_first().ok_or(error.clone())?;
                rest = label
                    .strip_prefix(field.as_bytes())
                    .filter(|_| usize::from(length) == field.len())
                    .ok_or(error.clone())?;
            }
            if field == "source_gid" {
                rest = rest.strip_prefix(&[GID_BYTES]).ok_or(error.clone())?;
            }
            let size = if field == "source_gid" { usize::from(GID_BYTES) } else { size_of::<i64>() };
            let value = rest.get(..size).ok_or(error)?;
            at = bytes.len() - rest.len() + size;
            Ok::<&[u8], AttachmentError>(value)
        };
        let number = |bytes: &[u8]| bytes.first_chunk().map_or(0, |b| i64::from_le_bytes(*b));
        Ok(Self {
            sequence: number(take("sequence_number")?),
            source_time_ns: number(take("source_timestamp")?),
            gid: take("source_gid")?.first_chunk().copied().unwrap_or_default(),
        })
    }

    /// As releases of today write it: zenoh-ext's serialisation of two numbers and a byte string.
    pub fn to_bytes(&self) -> [u8; 33] {
        let mut bytes = [0; 33];
        bytes[..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.source_time_ns.to_le_bytes());
        bytes[16] = GID_BYTES;
        bytes[17..].copy_from_slice(&self.gid);
        bytes
    }
}
