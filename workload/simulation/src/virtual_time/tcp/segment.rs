//! What goes over the wire: [`Data`] one way, [`Ack`] the other.

/// Ethernet, IPv4 and TCP headers, with the time stamp option that every segment has.
const HEADER_BYTES: usize = 14 + 20 + 20 + 12;
/// The SACK option: two bytes of padding, its kind and length, and two sequence numbers a block.
const SACK_BYTES: usize = 4;
const SACK_BLOCK_BYTES: usize = 8;
/// How many blocks fit beside a time stamp (RFC 2018, 3).
pub const BLOCKS: usize = 3;

/// Bytes of the stream from the first up to the last, which is not in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
    /// The first byte.
    pub begin: u64,
    /// Behind the last byte.
    pub end: u64,
}

impl Span {
    /// How many bytes.
    #[must_use]
    pub fn len(&self) -> u64 {
        self.end.saturating_sub(self.begin)
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.end <= self.begin
    }

    /// Whether the other is wholly in it.
    #[must_use]
    pub fn contains(&self, other: &Self) -> bool {
        self.begin <= other.begin && other.end <= self.end
    }
}

/// A segment with data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Data {
    /// Which bytes.
    pub span: Span,
    /// The sender's clock in milliseconds (RFC 7323, TSval).
    pub stamp_ms: i64,
}

impl Data {
    /// The length of its Ethernet frame.
    #[must_use]
    pub fn frame_bytes(&self) -> usize {
        HEADER_BYTES + usize::try_from(self.span.len()).unwrap_or(usize::MAX - HEADER_BYTES)
    }
}

/// A pure acknowledgement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ack {
    /// All bytes below have come.
    pub next: u64,
    /// What has come above, the newest first; a duplicate may be before them (RFC 2883).
    pub blocks: [Option<Span>; BLOCKS],
    /// The stamp of the segment that moved `next` (RFC 7323, TSecr).
    pub echo_ms: Option<i64>,
}

impl Ack {
    /// The blocks that are there.
    pub fn spans(&self) -> impl Iterator<Item = Span> + '_ {
        self.blocks.iter().flatten().copied()
    }

    /// The length of its Ethernet frame.
    #[must_use]
    pub fn frame_bytes(&self) -> usize {
        match self.spans().count() {
            0 => HEADER_BYTES,
            blocks => HEADER_BYTES + SACK_BYTES + SACK_BLOCK_BYTES * blocks,
        }
    }
}
