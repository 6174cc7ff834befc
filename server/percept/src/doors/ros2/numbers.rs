//! Numbers of a topic's messages, by which it is told what is missing, whoever publishes them.

use percept_ros::rmw_zenoh::Attachment;
use std::collections::BTreeMap;

/// Publishers of one topic that are told apart; a publisher that begins again is another.
const MOST: usize = 16;

/// The numbers of one topic: each publisher counts its own messages.
#[derive(Debug, Default)]
pub(super) struct Numbers {
    last: BTreeMap<[u8; 16], i64>,
    number: u64,
}

impl Numbers {
    /// A message's number on the topic: as many on as its publisher's has grown.
    pub(super) fn of(&mut self, attachment: &Attachment) -> u64 {
        let before = self.last.insert(attachment.gid, attachment.sequence);
        if self.last.len() > MOST {
            self.last = [(attachment.gid, attachment.sequence)].into();
        }
        let grown = before.and_then(|b| attachment.sequence.checked_sub(b)).and_then(|d| u64::try_from(d).ok());
        self.number = self.number.saturating_add(grown.unwrap_or(1).max(1));
        self.number
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_publishers_of_a_topic_leave_gaps_only_where_messages_are_missing() {
        let mut numbers = Numbers::default();
        let mut of =
            |publisher: u8, sequence| numbers.of(&Attachment { sequence, source_time_ns: 0, gid: [publisher; 16] });
        assert_eq!([of(1, 50), of(1, 51), of(2, 7), of(1, 52), of(2, 8)], [1, 2, 3, 4, 5]);
        // Two are missing; then the publisher begins anew.
        assert_eq!([of(1, 55), of(1, 1), of(1, 2)], [8, 9, 10]);
        assert_eq!([of(3, i64::MIN), of(3, i64::MAX), of(3, i64::MIN)], [11, 12, 13]);
        assert_eq!((10..100).map(|publisher| of(publisher, 1)).max(), Some(103));
    }
}
