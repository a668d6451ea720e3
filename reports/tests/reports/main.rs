//! Run directories as a user may have them, through to what the report says of them.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "clippy knows test functions, not their helpers"
)]

mod bad_input;
mod combined;
mod fixture;
mod hostile;
mod page;
mod recorded;
mod redacted;
mod summary;
mod synthetic;
mod tables;
mod true_position;
mod written;
