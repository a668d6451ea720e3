//! Nodes of a cluster, of which a matrix file makes one host. The type is [`SlurmNodes`].

use record::connection::Slurm;

/// The nodes that a matrix file means.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SlurmNodes {
    /// How they are asked for.
    pub slurm: Slurm,
    /// Their hardware, as it is said.
    pub hardware: String,
    /// Their operating system, as it is said.
    pub os: String,
}
