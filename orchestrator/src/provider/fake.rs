//! The `fake` provider.

mod settings;

pub use settings::{FakeScenario, FakeSettings, Fault, FaultPoint};
