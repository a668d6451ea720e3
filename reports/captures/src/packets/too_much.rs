//! What a capture may have too much of to be followed. The main type is [`TooMuch`].

/// Connections that are followed at a time, each direction by itself. A host of Linux opens them from 28 232 ports: both
/// directions of all of them to one port are fewer.
pub const MOST_CONNECTIONS: usize = 1 << 16;
/// A connection of which nothing is heard for this long is over: TCP itself gives up after some 15 minutes.
pub const SILENCE_NS: i64 = 1_000_000_000_000;

/// A capture has more of something than any experiment, and to follow it would take memory without bound.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TooMuch {
    /// More than [`MOST_CONNECTIONS`].
    #[error("it has more than {MOST_CONNECTIONS} connections at a time, and so many are not followed")]
    Connections,
    /// Segments that are not acknowledged, or messages that are not done with.
    #[error("it has more data that is not acknowledged than is kept at a time")]
    UnderWay,
}
