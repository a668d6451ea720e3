//! Matrix file -> plan -> run -> run directory.
