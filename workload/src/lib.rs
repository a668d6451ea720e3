//! The experiment inside one environment.
//!
//! ```text
//! settings -> network of virtual hosts -> ROS nodes: controller and plant -> windows on disk
//! ```
//!
//! The parts without effects, which also run in virtual time, are the crate `simulation`'s: plant, controller, messages. Here are
//! those with effects: [`network`], [`capture`], [`ros`], [`realtime`], [`virtual_hosts`], [`ball_on_plate`], which puts these together, and [`command`],
//! which measures a command of the user's. [`shell`] lets a person into a virtual host. Settings, and what the workload leaves behind, are the crate `record`'s. [`detached`] keeps a workload on a host that its user comes and goes to.

pub mod ball_on_plate;
pub mod capabilities;
pub mod capture;
mod cgroup;
pub mod check;
mod child_process;
pub mod command;
mod command_error;
mod descendants;
pub mod detached;
pub mod enter;
pub mod experiment;
pub mod experiments;
pub mod network;
pub mod realtime;
mod removal;
pub mod ros;
pub mod shell;
pub mod survey;
pub mod virtual_hosts;
