//! The parameter server: a tree of values. Pure. The main type is [`Parameters`].
//!
//! Source: <http://wiki.ros.org/ROS/Parameter%20Server%20API>, and `paramserver.py` of rosmaster 1.15.15.

use std::collections::BTreeMap;

use crate::ros::{name, xml_rpc::Value};

/// Values in the whole tree, and parts in one name.
const MOST_VALUES: usize = 100_000;
const MOST_PARTS: usize = 32;

/// Why a parameter cannot be set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum ParameterError {
    #[error("the root of the parameters can only be a struct")]
    RootNotStruct,
    #[error("the parameter server is full")]
    Full,
    #[error("the name has more than {MOST_PARTS} parts")]
    TooDeep,
}

/// All parameters of one master. Keys are canonical names.
#[derive(Debug, Default)]
pub(super) struct Parameters {
    root: BTreeMap<String, Value>,
}

impl Parameters {
    /// A struct replaces all that was below its name.
    pub fn set(&mut self, key: &str, value: Value) -> Result<(), ParameterError> {
        if name::parts(key).count() > MOST_PARTS {
            return Err(ParameterError::TooDeep);
        }
        if count(&self.root) + size(&value) > MOST_VALUES {
            return Err(ParameterError::Full);
        }
        let mut parts = name::parts(key);
        let Some(last) = parts.next_back() else {
            let Value::Struct(root) = value else {
                return Err(ParameterError::RootNotStruct);
            };
            self.root = root;
            return Ok(());
        };
        let mut space = &mut self.root;
        for part in parts {
            let below = space.entry(part.to_owned()).or_insert_with(Value::nothing);
            if !matches!(below, Value::Struct(_)) {
                *below = Value::nothing();
            }
            match below {
                Value::Struct(members) => space = members,
                _ => return Ok(()),
            }
        }
        space.insert(last.to_owned(), value);
        Ok(())
    }

    pub fn get(&self, key: &str) -> Option<Value> {
        let mut parts = name::parts(key);
        let Some(first) = parts.next() else {
            return Some(Value::Struct(self.root.clone()));
        };
        let mut value = self.root.get(first)?;
        for part in parts {
            let Value::Struct(members) = value else {
                return None;
            };
            value = members.get(part)?;
        }
        Some(value.clone())
    }

    /// Whether there was one.
    pub fn delete(&mut self, key: &str) -> bool {
        let mut parts = name::parts(key);
        let Some(last) = parts.next_back() else {
            return false;
        };
        let mut space = &mut self.root;
        for part in parts {
            match space.get_mut(part) {
                Some(Value::Struct(members)) => space = members,
                _ => return false,
            }
        }
        space.remove(last).is_some()
    }

    /// The nearest namespace from the caller's own upwards in which the key's first part exists, with the whole key.
    pub fn search(&self, caller: &str, key: &str) -> Option<String> {
        if key.starts_with('/') {
            return self.get(key).map(|_| name::canonical(key));
        }
        let first = name::parts(key).next()?;
        let mut space: Vec<&str> = name::parts(caller).collect();
        loop {
            let here = space.join("/");
            if self.get(&format!("/{here}/{first}")).is_some() {
                return Some(name::canonical(&format!("/{here}/{key}")));
            }
            space.pop()?;
        }
    }

    /// The full names of all values that are not structs.
    pub fn names(&self) -> Vec<String> {
        let mut names = Vec::new();
        collect_names("", &self.root, &mut names);
        names
    }

    /// What a subscriber of `subscribed` is told now that `changed` has: name and value, nothing if it does not care.
    pub fn update(&self, subscribed: &str, changed: &str) -> Option<(String, Value)> {
        let told = if name::is_within(changed, subscribed) {
            changed
        } else if name::is_within(subscribed, changed) {
            subscribed
        } else {
            return None;
        };
        // rosmaster ends the name with a slash here, and roscpp and rospy expect it.
        let name = if told == "/" {
            told.to_owned()
        } else {
            format!("{told}/")
        };
        Some((name, self.get(told).unwrap_or_else(Value::nothing)))
    }
}

fn collect_names(space: &str, members: &BTreeMap<String, Value>, names: &mut Vec<String>) {
    for (part, value) in members {
        let name = format!("{space}/{part}");
        match value {
            Value::Struct(members) => collect_names(&name, members, names),
            _ => names.push(name),
        }
    }
}

fn count(members: &BTreeMap<String, Value>) -> usize {
    members.values().map(size).sum()
}

/// Values in a value, itself included.
fn size(value: &Value) -> usize {
    1 + match value {
        Value::Struct(members) => count(members),
        Value::Array(values) => values.iter().map(size).sum(),
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(pairs: &[(&str, i32)]) -> Parameters {
        let mut parameters = Parameters::default();
        for (key, value) in pairs {
            parameters.set(key, (*value).into()).unwrap();
        }
        parameters
    }

    #[test]
    fn a_namespace_is_a_struct_of_its_parameters() {
        let parameters = with(&[("/gains/kp", 1), ("/gains/kd", 2), ("/rate", 50)]);
        let gains = BTreeMap::from([("kd".to_owned(), Value::Int(2)), ("kp".to_owned(), Value::Int(1))]);
        assert_eq!(parameters.get("/gains"), Some(Value::Struct(gains)));
        assert_eq!(parameters.names(), ["/gains/kd", "/gains/kp", "/rate"]);
        assert_eq!(parameters.get("/gains/kp/x"), None);
    }

    #[test]
    fn a_value_gives_way_to_a_namespace_and_a_struct_replaces_one() {
        let mut parameters = with(&[("/a", 1), ("/a/b", 2), ("/a/c", 3)]);
        assert_eq!(parameters.names(), ["/a/b", "/a/c"]);
        parameters
            .set(
                "/a",
                Value::Struct(BTreeMap::from([("d".to_owned(), Value::Int(4))])),
            )
            .unwrap();
        assert_eq!(parameters.names(), ["/a/d"]);
    }

    #[test]
    fn what_is_deleted_is_gone_once() {
        let mut parameters = with(&[("/a/b", 2)]);
        assert!(parameters.delete("/a/b"));
        assert!(!parameters.delete("/a/b"));
        assert!(!parameters.delete("/"));
    }

    #[rstest::rstest]
    #[case("/pr2/foo", "robot/arm", Some("/pr2/robot/arm"))]
    #[case("/other/foo", "robot/arm", Some("/robot/arm"))]
    #[case("/other/foo", "nothing", None)]
    #[case("/other/foo", "/pr2/robot", Some("/pr2/robot"))]
    fn a_search_goes_upwards_and_looks_for_the_first_part(
        #[case] caller: &str,
        #[case] key: &str,
        #[case] found: Option<&str>,
    ) {
        let parameters = with(&[("/robot/base", 1), ("/pr2/robot/base", 2)]);
        assert_eq!(parameters.search(caller, key).as_deref(), found);
    }

    #[rstest::rstest]
    #[case("/gains", "/gains/kp", Some(("/gains/kp/", Value::Int(1))))]
    #[case("/gains/kp", "/gains", Some(("/gains/kp/", Value::Int(1))))]
    #[case("/gains/ki", "/gains", Some(("/gains/ki/", Value::nothing())))]
    #[case("/rate", "/gains", None)]
    #[case("/gain", "/gains", None)]
    fn a_subscriber_is_told_of_what_is_within_and_above(
        #[case] subscribed: &str,
        #[case] changed: &str,
        #[case] told: Option<(&str, Value)>,
    ) {
        let parameters = with(&[("/gains/kp", 1)]);
        let told = told.map(|(key, value)| (key.to_owned(), value));
        assert_eq!(parameters.update(subscribed, changed), told);
    }

    #[test]
    fn a_caller_gone_wild_fills_the_tree_and_no_more() {
        let mut parameters = Parameters::default();
        let many = Value::Array(vec![Value::Nil; MOST_VALUES]);
        assert_eq!(parameters.set("/a", many), Err(ParameterError::Full));
        assert_eq!(
            parameters.set(&"/a".repeat(100), Value::Nil),
            Err(ParameterError::TooDeep)
        );
    }
}
