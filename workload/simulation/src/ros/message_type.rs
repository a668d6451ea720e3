//! What a topic carries, as the two ends of a TCPROS connection compare it. The main type is [`MessageType`].
//!
//! Source: <http://wiki.ros.org/ROS/Connection%20Header>.

/// A ROS message type. Two nodes understand each other if name and MD5 sum agree, or if one of them says `*`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MessageType {
    /// Package and type, such as `std_msgs/Float64MultiArray`.
    pub name: &'static str,
    /// The MD5 sum of the definition with comments removed, as ROS computes it.
    pub md5sum: &'static str,
    /// The full text of the definition with those of its parts, as `gendeps --cat` prints it. `rostopic echo` and bags
    /// build the type from it, so that they need no message package.
    pub definition: &'static str,
}

/// What a node says that takes any type: `rostopic hz`, `rosbag record`.
pub const ANY: &str = "*";

impl MessageType {
    /// Whether a peer that names this type and sum can be spoken with. Both may be `*`. A name may be left out, since
    /// the sum says more.
    #[must_use]
    pub fn agrees_with(&self, name: Option<&str>, md5sum: &str) -> bool {
        let sum_agrees = md5sum == ANY || md5sum == self.md5sum;
        let name_agrees = name.is_none_or(|name| name == ANY || name == self.name);
        sum_agrees && name_agrees
    }
}
