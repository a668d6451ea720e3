//! End-to-end tests on the real engines; see `tests/`.
