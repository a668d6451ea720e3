//! What killed workloads left in Open vSwitch, which outlives processes and boots. The main function is [`find`].
//!
//! It is the bridge alone: the controller ends with the program that holds the network, and the links with the hosts'
//! namespaces. Ours are the bridges that say so in their `external_ids`; those of other Mininets are never touched.

use std::path::Path;

use record::topology::{MOST_HOSTS, MOST_SWITCHES};

use super::{
    super::{error::NetworkError, kernel::tools},
    PREFIX,
    owner::Owner,
};

/// Where a bridge says whose it is.
const OWNER: &str = "matrix-owner";

/// The bridges whose owners have ended. None where there is no Open vSwitch, or none that answers this user: it has
/// none of ours then.
///
/// # Errors
/// If Open vSwitch says what nobody expects.
pub fn find() -> Result<Vec<String>, NetworkError> {
    let words = [
        "--timeout=10",
        "--format=json",
        "--columns=name,external_ids",
        "list",
        "Bridge",
    ];
    let json = match tools::run_here("ovs-vsctl", &words) {
        Ok(json) => json,
        Err(NetworkError::Tool { .. } | NetworkError::Command { .. }) => return Ok(Vec::new()),
        Err(other) => return Err(other),
    };
    let bridges = owned_bridges(&json).ok_or_else(|| NetworkError::Command {
        command: format!("ovs-vsctl {}", words.join(" ")),
        said: json.trim().to_owned(),
    })?;
    let ended = bridges.into_iter().filter(|(_, owner)| owner.has_ended());
    Ok(ended.map(|(name, _)| name).collect())
}

/// Removes a bridge of ours, if it is there, with what is left of its links.
///
/// # Errors
/// If Open vSwitch refuses.
pub fn remove(bridge: &str) -> Result<(), NetworkError> {
    for port in (1..=MOST_HOSTS + MOST_SWITCHES).map(|port| format!("{bridge}-eth{port}")) {
        if Path::new("/sys/class/net").join(&port).exists() {
            // It may go by itself meanwhile, with the namespace that its other end is in.
            let _ = tools::run_here("ip", &["link", "delete", &port]);
        }
    }
    tools::run_here("ovs-vsctl", &["--timeout=10", "--if-exists", "del-br", bridge]).map(drop)
}

/// The bridges that we made, out of a table of OVSDB (RFC 7047, section 5.1, for maps), with their owners.
fn owned_bridges(json: &str) -> Option<Vec<(String, Owner)>> {
    let table: serde_json::Value = serde_json::from_str(json).ok()?;
    let ours = |row: &serde_json::Value| {
        let name = row[0].as_str().filter(|name| name.starts_with(PREFIX))?;
        let pairs = row[1][1].as_array()?;
        let owner = pairs.iter().find(|pair| pair[0] == OWNER)?[1].as_str()?;
        Some((name.to_owned(), owner.parse().ok()?))
    };
    Some(table["data"].as_array()?.iter().filter_map(ours).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As Open vSwitch 3.1 printed it, with others' bridges beside ours.
    const TABLE: &str = r#"{"data":[
        ["mx12345678",["map",[["matrix-owner","bc3281b4-4c5b/pid:[4026531836]/641/24181"]]]],
        ["s1",["map",[]]],
        ["mx",["map",[["owner","somebody"]]]],
        ["s2",["map",[["matrix-owner","bc3281b4-4c5b/pid:[4026531836]/641/24181"]]]]
        ],"headings":["name","external_ids"]}"#;

    #[test]
    fn bridges_are_ours_by_name_and_by_what_they_say() {
        let owner = "bc3281b4-4c5b/pid:[4026531836]/641/24181".parse().unwrap();
        assert_eq!(owned_bridges(TABLE), Some(vec![("mx12345678".to_owned(), owner)]));
    }

    #[rstest::rstest]
    #[case(r#"{"data":[],"headings":["name","external_ids"]}"#, Some(vec![]))]
    #[case("", None)]
    #[case("[]", None)]
    fn an_empty_table_is_not_an_answer_that_cannot_be_read(
        #[case] json: &str,
        #[case] bridges: Option<Vec<(String, Owner)>>,
    ) {
        assert_eq!(owned_bridges(json), bridges);
    }
}
