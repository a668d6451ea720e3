//! The experiment inside one environment.
//!
//! ```text
//! settings -> network of three virtual hosts -> ROS nodes: controller and plant -> windows on disk
//! ```
//!
//! Pure parts, which also run in virtual time: [`reference`], [`plant`], [`controller`], [`simulation`]. Parts with effects:
//! [`network`], [`capture`], [`ros`], [`realtime`], [`experiment`]. Settings, and what the workload leaves behind, are the crate
//! `record`'s. [`detached`] keeps a workload on a host that its user comes and goes to.

pub mod capabilities;
pub mod capture;
mod cgroup;
pub mod check;
mod child_process;
pub mod controller;
pub mod detached;
pub mod enter;
pub mod experiment;
pub mod limits;
pub mod network;
pub mod plant;
pub mod realtime;
pub mod reference;
pub mod ros;
pub mod simulation;
pub mod survey;
pub mod virtual_time;
