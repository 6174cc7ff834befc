//! Depth images and the colour images that belong to them, as they come.

use percept_geometry::Timestamp;
use percept_ros::topics::PAIR_APART_NS;
use std::collections::VecDeque;
use zenoh::bytes::ZBytes;

/// Images of either kind that wait for the other: 0.3 s at 30 Hz.
const HELD: usize = 10;
/// Depth images after which no colour is waited for if none had one: 2 s at 10 Hz, beside those that wait.
const HOPELESS: u64 = 20;
/// Bytes of images of either kind that wait at most: ten of 1280 x 720 in colour, and more.
const HELD_BYTES: usize = 32 << 20;

/// Images of one camera that wait for their other half.
#[derive(Debug)]
pub(super) struct Pairs<T> {
    depth: VecDeque<(Timestamp, T)>,
    color: VecDeque<(Timestamp, T)>,
    /// Depth images for which no colour came.
    pub(super) num_alone: u64,
    num_color: u64,
    has_paired: bool,
}

impl<T> Default for Pairs<T> {
    fn default() -> Self {
        Self { depth: VecDeque::new(), color: VecDeque::new(), num_alone: 0, num_color: 0, has_paired: false }
    }
}

/// Something that takes memory.
pub(super) trait Weighed {
    /// Bytes that it takes.
    fn num_bytes(&self) -> usize;
}

/// An image that waits for its other half: number, when it was sent, bytes.
pub(super) type Half = (u64, i64, ZBytes);

impl Weighed for Half {
    fn num_bytes(&self) -> usize {
        self.2.len()
    }
}

impl<T: Clone + Weighed> Pairs<T> {
    /// Takes a depth image in; with its colour, if that is there.
    pub(super) fn depth(&mut self, stamp: Timestamp, image: T) -> Option<(T, T)> {
        if let Some(color) = nearest(&self.color, stamp) {
            self.has_paired = true;
            return Some((image, color));
        }
        self.depth.push_back((stamp, image));
        self.num_alone += let_go(&mut self.depth);
        None
    }

    /// Whether so many of both came, and none in a pair, that none will.
    pub(super) fn is_hopeless(&self) -> bool {
        !self.has_paired && self.num_alone.min(self.num_color) >= HOPELESS
    }

    /// Takes a colour image in; with the depth image that waits for it, if there is one. Those before it find none any more.
    pub(super) fn color(&mut self, stamp: Timestamp, image: T) -> Option<(T, T)> {
        self.num_color += 1;
        let waiting = self.depth.iter().position(|(at, _)| at.0.abs_diff(stamp.0) <= PAIR_APART_NS);
        self.color.push_back((stamp, image.clone()));
        let_go(&mut self.color);
        if self.is_hopeless() {
            // Its depth image was taken without it; if it is in time, the next is waited for again.
            self.has_paired = waiting.is_some();
            self.depth.clear();
            return None;
        }
        let at = waiting?;
        self.has_paired = true;
        self.num_alone += at as u64;
        self.depth.drain(..at);
        self.depth.pop_front().map(|(_, depth)| (depth, image))
    }
}

/// Lets the oldest go until the rest may wait; how many went.
fn let_go<T: Weighed>(images: &mut VecDeque<(Timestamp, T)>) -> u64 {
    let mut gone = 0;
    while images.len() > HELD || images.iter().map(|(_, image)| image.num_bytes()).sum::<usize>() > HELD_BYTES {
        images.pop_front();
        gone += 1;
    }
    gone
}

fn nearest<T: Clone>(images: &VecDeque<(Timestamp, T)>, stamp: Timestamp) -> Option<T> {
    let apart = images.iter().map(|(at, image)| (at.0.abs_diff(stamp.0), image));
    apart.filter(|(apart, _)| *apart <= PAIR_APART_NS).min_by_key(|(apart, _)| *apart).map(|(_, image)| image.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Weighed for &str {
        fn num_bytes(&self) -> usize {
            if *self == "huge" { HELD_BYTES } else { self.len() }
        }
    }

    fn ms(ms: i64) -> Timestamp {
        Timestamp(ms * 1_000_000)
    }

    #[test]
    fn halves_meet_whichever_comes_first() {
        let mut pairs = Pairs::default();
        assert_eq!(pairs.depth(ms(0), "d0"), None);
        assert_eq!(pairs.color(ms(5), "c0"), Some(("d0", "c0")));
        assert_eq!(pairs.color(ms(38), "c1"), None);
        assert_eq!(pairs.depth(ms(33), "d1"), Some(("d1", "c1")));
        // One colour image may belong to two depth images.
        assert_eq!(pairs.depth(ms(50), "d2"), Some(("d2", "c1")));
        assert_eq!(pairs.num_alone, 0);
    }

    #[test]
    fn depth_whose_colour_never_comes_is_counted_and_let_go() {
        let mut pairs = Pairs::default();
        assert_eq!(pairs.depth(ms(0), "d0"), None);
        assert_eq!(pairs.depth(ms(33), "d1"), None);
        assert_eq!(pairs.color(ms(34), "c1"), Some(("d1", "c1")));
        assert_eq!(pairs.num_alone, 1);
        (0..20).for_each(|i| assert_eq!(pairs.depth(ms(1000 + 33 * i), "d"), None));
        assert_eq!((pairs.num_alone, pairs.depth.len()), (11, HELD));
    }

    /// A camera whose colour is 40 ms late, say.
    #[test]
    fn depth_that_never_has_colour_is_not_to_wait_for_it() {
        let mut pairs = Pairs::default();
        for i in 0..40 {
            assert_eq!(pairs.depth(ms(100 * i), "d"), None);
            assert_eq!(pairs.color(ms(100 * i + 40), "c"), None);
            assert_eq!(pairs.is_hopeless(), i >= 29, "{i}");
        }
        // Colour that comes in time after all: that of an image that was taken alone, then the next one's.
        assert_eq!((pairs.depth(ms(5000), "d"), pairs.is_hopeless()), (None, true));
        assert_eq!((pairs.color(ms(5001), "c"), pairs.is_hopeless()), (None, false));
        assert_eq!(pairs.depth(ms(5100), "d2"), None);
        assert_eq!(pairs.color(ms(5101), "c2"), Some(("d2", "c2")));
        // A camera whose colour begins long after its depth.
        let mut pairs = Pairs::default();
        (0..100).for_each(|i| assert_eq!((pairs.depth(ms(33 * i), "d"), pairs.is_hopeless()), (None, false)));
        assert_eq!(pairs.color(ms(33 * 99), "c"), Some(("d", "c")));
    }

    #[test]
    fn large_images_do_not_pile_up() {
        let mut pairs = Pairs::default();
        (0..5).for_each(|i| assert_eq!(pairs.depth(ms(100 * i), "huge"), None));
        assert_eq!((pairs.depth.len(), pairs.num_alone), (1, 4));
        assert_eq!(pairs.color(ms(400), "c"), Some(("huge", "c")));
    }
}
