//! What is read: a run directory as a [`run::Run`], its captures as a
//! [`Traffic`](captures::traffic::Traffic).

pub mod loop_logs;
pub mod overheads;
pub mod run;
pub mod short_lines;
pub mod traffic;
pub mod verification;
pub mod window_data;
