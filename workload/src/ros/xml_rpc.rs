//! XML-RPC over HTTP, as much as ROS uses, with bounds on everything that a peer decides.
//!
//! XML is read by `quick-xml` and HTTP heads by `httparse`. What is around them is our own: the crates that offer
//! whole servers bound neither the size of a head nor the time that it takes, write head and body as two segments
//! (which costs a delayed acknowledgement at each call), and recurse as deep as a peer wishes.
//!
//! Source: <http://xmlrpc.com/spec.md>. The main types are [`Value`], [`Client`] and [`Api`].

mod client;
pub(super) mod document;
pub(super) mod http;
mod server;
mod value;

pub(super) use client::{CallError, Client};
pub(super) use server::{Api, Fault, serve};
pub(super) use value::{Params, Value, ValueError};
