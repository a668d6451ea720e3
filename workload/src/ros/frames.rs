//! Messages in a stream of bytes: a length of 32 bits, then as many bytes. Pure. The main type is [`Frames`].
//!
//! Source: <http://wiki.ros.org/ROS/TCPROS>. Memory follows what has arrived, never what a length promises.

/// The largest connection header: the definitions of the largest standard messages have some 10 KB.
pub(super) const LARGEST_HEADER: usize = 64 * 1024;
/// The largest message that a subscription takes; the experiment's have some 200 bytes.
pub(super) const LARGEST_MESSAGE: usize = 1024 * 1024;

const PREFIX: usize = 4;
const FIRST_CAPACITY: usize = 4096;

/// A length that is not accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("its length of {length} bytes is above the limit of {limit}")]
pub(super) struct TooLarge {
    pub length: usize,
    pub limit: usize,
}

/// Finds frames in bytes as they arrive.
#[derive(Debug)]
pub(super) struct Frames {
    buffer: Vec<u8>,
    /// Where the first byte that has not been given out is.
    begin: usize,
    /// Where the first byte that has not been filled is.
    end: usize,
    limit: usize,
}

impl Frames {
    /// For frames of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self {
            buffer: vec![0; FIRST_CAPACITY],
            begin: 0,
            end: 0,
            limit,
        }
    }

    /// From now on, frames may have `limit` bytes.
    pub fn set_limit(&mut self, limit: usize) {
        self.limit = limit;
    }

    /// Whether part of a frame is there.
    pub fn has_begun(&self) -> bool {
        self.end > self.begin
    }

    /// The next frame, if it is all there.
    pub fn next(&mut self) -> Result<Option<&[u8]>, TooLarge> {
        let arrived = self.buffer.get(self.begin..self.end).unwrap_or_default();
        let Some((length, rest)) = arrived.split_first_chunk::<PREFIX>() else {
            return Ok(None);
        };
        let length = u32::from_le_bytes(*length) as usize;
        if length > self.limit {
            return Err(TooLarge {
                length,
                limit: self.limit,
            });
        }
        let frame = rest.get(..length);
        if frame.is_some() {
            self.begin += PREFIX + length;
        }
        Ok(frame)
    }

    /// Where to read the next bytes to. Never empty as long as [`Self::next`] has been asked until it had none.
    pub fn space(&mut self) -> &mut [u8] {
        if self.begin == self.end {
            self.begin = 0;
            self.end = 0;
        } else if self.end == self.buffer.len() {
            self.buffer.copy_within(self.begin..self.end, 0);
            self.end -= self.begin;
            self.begin = 0;
            if self.end == self.buffer.len() {
                let doubled = self.buffer.len().saturating_mul(2);
                self.buffer
                    .resize(doubled.min(PREFIX + self.limit).max(self.end + 1), 0);
            }
        }
        self.buffer.get_mut(self.end..).unwrap_or_default()
    }

    /// Says how many bytes have been read to [`Self::space`].
    pub fn filled(&mut self, count: usize) {
        self.end = self.buffer.len().min(self.end + count);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Gives the bytes in pieces and returns the frames that were found.
    fn feed(frames: &mut Frames, bytes: &[u8], piece: usize) -> Result<Vec<Vec<u8>>, TooLarge> {
        let mut found = Vec::new();
        for mut piece in bytes.chunks(piece) {
            while !piece.is_empty() {
                let space = frames.space();
                assert!(!space.is_empty());
                let count = space.len().min(piece.len());
                space[..count].copy_from_slice(&piece[..count]);
                frames.filled(count);
                piece = &piece[count..];
                while let Some(frame) = frames.next()? {
                    found.push(frame.to_vec());
                }
            }
        }
        Ok(found)
    }

    fn framed(messages: &[Vec<u8>]) -> Vec<u8> {
        let frame = |message: &Vec<u8>| [&(message.len() as u32).to_le_bytes(), message.as_slice()].concat();
        messages.iter().flat_map(frame).collect()
    }

    #[test]
    fn a_length_above_the_limit_is_refused_before_anything_is_set_aside_for_it() {
        let mut frames = Frames::new(1000);
        let refused = feed(&mut frames, &u32::MAX.to_le_bytes(), 4);
        assert_eq!(
            refused,
            Err(TooLarge {
                length: u32::MAX as usize,
                limit: 1000
            })
        );
        assert_eq!(frames.buffer.len(), FIRST_CAPACITY);
    }

    #[test]
    fn memory_follows_what_arrives_and_not_what_a_length_promises() {
        let mut frames = Frames::new(LARGEST_MESSAGE);
        feed(&mut frames, &(LARGEST_MESSAGE as u32).to_le_bytes(), 4).unwrap();
        frames.space();
        assert_eq!(frames.buffer.len(), FIRST_CAPACITY);
    }

    #[test]
    fn the_largest_message_is_taken() {
        let message = vec![7; LARGEST_MESSAGE];
        let mut frames = Frames::new(LARGEST_MESSAGE);
        let bytes = framed(&[message.clone(), vec![]]);
        assert_eq!(feed(&mut frames, &bytes, 9000).unwrap(), [message, vec![]]);
        assert!(!frames.has_begun());
    }

    proptest! {
        #[test]
        fn frames_are_found_however_the_bytes_are_cut(
            messages in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..6000), 0..6),
            piece in 1_usize..5000,
        ) {
            let mut frames = Frames::new(6000);
            prop_assert_eq!(feed(&mut frames, &framed(&messages), piece).unwrap(), messages);
        }

        #[test]
        fn no_bytes_make_it_panic_or_grow_beyond_its_limit(bytes: Vec<u8>, piece in 1_usize..50) {
            let mut frames = Frames::new(40);
            let _ = feed(&mut frames, &bytes, piece);
            prop_assert!(frames.buffer.len() <= FIRST_CAPACITY);
        }
    }
}
