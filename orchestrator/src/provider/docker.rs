//! The `docker` provider.

mod settings;

pub use settings::DockerSettings;
