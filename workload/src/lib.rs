//! The experiment inside one environment.
//!
//! ```text
//! settings -> network of three virtual hosts -> ROS nodes: controller and plant -> windows on disk
//! ```
//!
//! Pure parts, which also run in virtual time: [`settings`], [`quantity`], [`reference`], [`plant`], [`controller`],
//! [`simulation`]. Parts with effects: [`network`], [`capture`], [`ros`], [`realtime`], [`experiment`]. What they leave
//! behind is described in [`record`]. [`detached`] keeps a workload on a host that its user comes and goes to.

pub mod capabilities;
pub mod capture;
pub mod causes;
mod cgroup;
mod companion;
pub mod controller;
pub mod detached;
pub mod enter;
pub mod experiment;
pub mod limits;
pub mod network;
pub mod plant;
pub mod quantity;
pub mod realtime;
pub mod record;
pub mod reference;
pub mod ros;
pub mod settings;
pub mod simulation;
pub mod survey;
pub mod virtual_host;
pub mod virtual_time;
