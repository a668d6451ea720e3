//! What is read: a run directory as a [`run::Run`], its captures as [`traffic::Traffic`].

pub mod packets;
pub mod run;
pub mod traffic;
pub mod verification;
