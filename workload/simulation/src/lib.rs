//! The parts of the experiment that have no effects: no clock, no thread, no file. The workload measures with them, and they run
//! in virtual time.
//!
//! - the experiment's equations: [`reference`], [`plant`], [`controller`];
//! - when the steps of a loop are due: [`schedule`]; what the loops send to each other: [`message`], in the encodings of [`ros`];
//! - when the machine stands still: [`stalls`];
//! - the network: one end of a link is [`link`], links and TCP in virtual time are [`virtual_time`];
//! - all of it together, the closed loop in virtual time: [`closed_loop`].

pub mod closed_loop;
pub mod controller;
pub mod link;
pub mod message;
pub mod plant;
pub mod reference;
pub mod replay;
pub mod ros;
pub mod schedule;
pub mod stalls;
pub mod virtual_time;
