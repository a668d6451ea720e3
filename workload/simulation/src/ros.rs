//! The message types of ROS 1 that the two topics have, as bytes. Connections and the master are the workload's.

pub mod float64_multi_array;
pub mod message_type;
pub mod string;
