//! Who publishes, subscribes and serves what. Pure: calls change it, and say whom to tell. The main type is
//! [`Registry`].
//!
//! Source: <http://wiki.ros.org/ROS/Master_API>, and `registrations.py` of rosmaster 1.15.15 for what it leaves open.

use std::collections::BTreeMap;

use super::callbacks::Callback;

/// A type that leaves the type open.
const ANY_TYPE: &str = "*";
/// Names in one table, and nodes for one name: what a caller gone wild can fill.
const MOST_NAMES: usize = 4096;
const MOST_NODES: usize = 256;

/// A node and its slave API.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Provider {
    caller: String,
    api: String,
}

/// Name of a topic, service or parameter to its nodes, in the order they registered.
#[derive(Debug, Default)]
struct Table(BTreeMap<String, Vec<Provider>>);

/// The table is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the master's tables are full")]
pub(super) struct Full;

impl Table {
    fn add(&mut self, name: &str, provider: Provider) -> Result<(), Full> {
        if !self.0.contains_key(name) && self.0.len() >= MOST_NAMES {
            return Err(Full);
        }
        let providers = self.0.entry(name.to_owned()).or_default();
        if !providers.contains(&provider) {
            if providers.len() >= MOST_NODES {
                return Err(Full);
            }
            providers.push(provider);
        }
        Ok(())
    }

    /// Whether there was one.
    fn remove(&mut self, name: &str, provider: &Provider) -> bool {
        let Some(providers) = self.0.get_mut(name) else {
            return false;
        };
        let before = providers.len();
        providers.retain(|other| other != provider);
        let removed = providers.len() < before;
        if providers.is_empty() {
            self.0.remove(name);
        }
        removed
    }

    /// Removes a node from all names, and returns those.
    fn remove_caller(&mut self, caller: &str) -> Vec<String> {
        let mut names = Vec::new();
        self.0.retain(|name, providers| {
            let before = providers.len();
            providers.retain(|provider| provider.caller != caller);
            if providers.len() < before {
                names.push(name.clone());
            }
            !providers.is_empty()
        });
        names
    }

    fn has(&self, caller: &str) -> bool {
        self.0
            .values()
            .flatten()
            .any(|provider| provider.caller == caller)
    }

    fn apis(&self, name: &str) -> Vec<String> {
        self.0
            .get(name)
            .into_iter()
            .flatten()
            .map(|provider| provider.api.clone())
            .collect()
    }

    fn state(&self) -> Vec<(String, Vec<String>)> {
        let callers =
            |providers: &Vec<Provider>| providers.iter().map(|provider| provider.caller.clone()).collect();
        self.0
            .iter()
            .map(|(name, providers)| (name.clone(), callers(providers)))
            .collect()
    }
}

/// Names with the nodes that publish, subscribe or serve them.
pub(super) type State = Vec<(String, Vec<String>)>;

/// All registrations of one master.
#[derive(Debug, Default)]
pub(super) struct Registry {
    nodes: BTreeMap<String, String>,
    publishers: Table,
    subscribers: Table,
    services: BTreeMap<String, Service>,
    parameter_subscribers: Table,
    topic_types: BTreeMap<String, String>,
}

#[derive(Debug)]
struct Service {
    caller: String,
    uri: String,
}

impl Registry {
    /// Returns the topic's subscribers, who are told of it.
    pub fn register_publisher(
        &mut self,
        caller: &str,
        topic: &str,
        topic_type: &str,
        api: &str,
    ) -> Result<(Vec<String>, Vec<Callback>), Full> {
        let mut tell = self.register_node(caller, api)?;
        self.publishers.add(topic, provider(caller, api))?;
        // A type of `*` does not hide one that is known.
        if topic_type != ANY_TYPE || !self.topic_types.contains_key(topic) {
            self.topic_types.insert(topic.to_owned(), topic_type.to_owned());
        }
        tell.extend(self.publisher_update(topic));
        Ok((self.subscribers.apis(topic), tell))
    }

    /// Returns how many registrations were removed.
    pub fn unregister_publisher(&mut self, caller: &str, topic: &str, api: &str) -> (bool, Vec<Callback>) {
        let removed = self.publishers.remove(topic, &provider(caller, api));
        let tell = if removed {
            self.publisher_update(topic)
        } else {
            Vec::new()
        };
        self.forget_idle(caller);
        (removed, tell)
    }

    /// Returns the topic's publishers.
    pub fn register_subscriber(
        &mut self,
        caller: &str,
        topic: &str,
        topic_type: &str,
        api: &str,
    ) -> Result<(Vec<String>, Vec<Callback>), Full> {
        let tell = self.register_node(caller, api)?;
        self.subscribers.add(topic, provider(caller, api))?;
        if topic_type != ANY_TYPE && !self.topic_types.contains_key(topic) {
            self.topic_types.insert(topic.to_owned(), topic_type.to_owned());
        }
        Ok((self.publishers.apis(topic), tell))
    }

    pub fn unregister_subscriber(&mut self, caller: &str, topic: &str, api: &str) -> bool {
        let removed = self.subscribers.remove(topic, &provider(caller, api));
        self.forget_idle(caller);
        removed
    }

    /// A service has one provider: the last to register.
    pub fn register_service(
        &mut self,
        caller: &str,
        service: &str,
        uri: &str,
        api: &str,
    ) -> Result<Vec<Callback>, Full> {
        let tell = self.register_node(caller, api)?;
        if !self.services.contains_key(service) && self.services.len() >= MOST_NAMES {
            return Err(Full);
        }
        self.services.insert(
            service.to_owned(),
            Service {
                caller: caller.to_owned(),
                uri: uri.to_owned(),
            },
        );
        Ok(tell)
    }

    pub fn unregister_service(&mut self, caller: &str, service: &str, uri: &str) -> bool {
        let current = self
            .services
            .get(service)
            .is_some_and(|known| known.caller == caller && known.uri == uri);
        if current {
            self.services.remove(service);
            self.forget_idle(caller);
        }
        current
    }

    pub fn service(&self, service: &str) -> Option<&str> {
        self.services.get(service).map(|known| known.uri.as_str())
    }

    pub fn subscribe_parameter(&mut self, caller: &str, key: &str, api: &str) -> Result<Vec<Callback>, Full> {
        let tell = self.register_node(caller, api)?;
        self.parameter_subscribers.add(key, provider(caller, api))?;
        Ok(tell)
    }

    pub fn unsubscribe_parameter(&mut self, caller: &str, key: &str, api: &str) -> bool {
        let removed = self.parameter_subscribers.remove(key, &provider(caller, api));
        self.forget_idle(caller);
        removed
    }

    /// Keys that are subscribed to, each with the slave APIs of those who do, other than `caller`.
    pub fn parameter_subscribers(&self, caller: &str) -> Vec<(String, Vec<String>)> {
        let others = |providers: &Vec<Provider>| {
            providers
                .iter()
                .filter(|provider| provider.caller != caller)
                .map(|provider| provider.api.clone())
                .collect()
        };
        let tables = self.parameter_subscribers.0.iter();
        tables
            .map(|(key, providers)| (key.clone(), others(providers)))
            .collect()
    }

    pub fn node(&self, name: &str) -> Option<&str> {
        self.nodes.get(name).map(String::as_str)
    }

    /// Topics with a publisher, and their types, within a namespace that ends with a slash (or is empty for all).
    pub fn published_topics(&self, within: &str) -> Vec<(String, String)> {
        let topics = self.publishers.0.keys().filter(|topic| topic.starts_with(within));
        topics
            .map(|topic| {
                (
                    topic.clone(),
                    self.topic_types
                        .get(topic)
                        .map_or(ANY_TYPE, String::as_str)
                        .to_owned(),
                )
            })
            .collect()
    }

    pub fn topic_types(&self) -> Vec<(String, String)> {
        self.topic_types
            .iter()
            .map(|(topic, kind)| (topic.clone(), kind.clone()))
            .collect()
    }

    /// Publishers, subscribers, services.
    pub fn state(&self) -> [State; 3] {
        let services = self
            .services
            .iter()
            .map(|(name, service)| (name.clone(), vec![service.caller.clone()]));
        [
            self.publishers.state(),
            self.subscribers.state(),
            services.collect(),
        ]
    }

    /// Makes the node known. One that comes back under another address has left the old one: its registrations
    /// there are void, and whoever still listens there is told to end.
    fn register_node(&mut self, caller: &str, api: &str) -> Result<Vec<Callback>, Full> {
        if self.nodes.len() >= MOST_NAMES && !self.nodes.contains_key(caller) {
            return Err(Full);
        }
        let Some(former) = self
            .nodes
            .insert(caller.to_owned(), api.to_owned())
            .filter(|former| former != api)
        else {
            return Ok(Vec::new());
        };
        let mut tell = vec![Callback::Shutdown { api: former }];
        for topic in self.publishers.remove_caller(caller) {
            tell.extend(self.publisher_update(&topic));
        }
        self.subscribers.remove_caller(caller);
        self.parameter_subscribers.remove_caller(caller);
        self.services.retain(|_, service| service.caller != caller);
        Ok(tell)
    }

    /// A node with no registration is no longer known.
    fn forget_idle(&mut self, caller: &str) {
        let tables = [&self.publishers, &self.subscribers, &self.parameter_subscribers];
        let serves = self.services.values().any(|service| service.caller == caller);
        if !serves && !tables.iter().any(|table| table.has(caller)) {
            self.nodes.remove(caller);
        }
    }

    fn publisher_update(&self, topic: &str) -> Vec<Callback> {
        let publishers = self.publishers.apis(topic);
        let update = |api| Callback::PublisherUpdate {
            api,
            topic: topic.to_owned(),
            publishers: publishers.clone(),
        };
        self.subscribers.apis(topic).into_iter().map(update).collect()
    }
}

fn provider(caller: &str, api: &str) -> Provider {
    Provider {
        caller: caller.to_owned(),
        api: api.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATE: &str = "/state";
    const PLANT: &str = "http://10.0.0.3:1/";
    const CONTROLLER: &str = "http://10.0.0.2:1/";

    fn update(api: &str, publishers: &[&str]) -> Callback {
        Callback::PublisherUpdate {
            api: api.into(),
            topic: STATE.into(),
            publishers: publishers.iter().map(|api| (*api).to_owned()).collect(),
        }
    }

    #[test]
    fn a_subscriber_is_told_of_a_publisher_that_comes_and_goes() {
        let mut registry = Registry::default();
        let (publishers, tell) = registry
            .register_subscriber("/c", STATE, "a/B", CONTROLLER)
            .unwrap();
        assert_eq!((publishers, tell), (vec![], vec![]));
        let (subscribers, tell) = registry.register_publisher("/p", STATE, "a/B", PLANT).unwrap();
        assert_eq!(subscribers, [CONTROLLER]);
        assert_eq!(tell, [update(CONTROLLER, &[PLANT])]);
        assert_eq!(
            registry.unregister_publisher("/p", STATE, PLANT),
            (true, vec![update(CONTROLLER, &[])])
        );
        assert_eq!(registry.unregister_publisher("/p", STATE, PLANT), (false, vec![]));
        assert_eq!(registry.node("/p"), None);
    }

    #[test]
    fn a_node_that_comes_back_elsewhere_replaces_itself() {
        let mut registry = Registry::default();
        registry
            .register_subscriber("/c", STATE, "a/B", CONTROLLER)
            .unwrap();
        registry.register_publisher("/p", STATE, "a/B", PLANT).unwrap();
        let (_, tell) = registry
            .register_publisher("/p", STATE, "a/B", "http://10.0.0.3:2/")
            .unwrap();
        assert_eq!(
            tell,
            [
                Callback::Shutdown { api: PLANT.into() },
                update(CONTROLLER, &[]),
                update(CONTROLLER, &["http://10.0.0.3:2/"])
            ]
        );
    }

    #[test]
    fn registering_twice_counts_once() {
        let mut registry = Registry::default();
        for _ in 0..2 {
            registry.register_publisher("/p", STATE, "a/B", PLANT).unwrap();
        }
        let [publishers, subscribers, services] = registry.state();
        assert_eq!(publishers, [(STATE.to_owned(), vec!["/p".to_owned()])]);
        assert_eq!((subscribers, services), (vec![], vec![]));
    }

    #[rstest::rstest]
    #[case("*", "a/B", "a/B")]
    #[case("a/B", "*", "a/B")]
    #[case("a/B", "a/C", "a/B")]
    fn an_open_type_hides_no_known_one(
        #[case] publisher: &str,
        #[case] subscriber: &str,
        #[case] known: &str,
    ) {
        let mut registry = Registry::default();
        registry
            .register_subscriber("/c", STATE, "*", CONTROLLER)
            .unwrap();
        registry
            .register_subscriber(
                "/c",
                STATE,
                if publisher == "*" { subscriber } else { "*" },
                CONTROLLER,
            )
            .unwrap();
        registry
            .register_publisher("/p", STATE, publisher, PLANT)
            .unwrap();
        registry
            .register_subscriber("/d", STATE, subscriber, CONTROLLER)
            .unwrap();
        assert_eq!(registry.topic_types(), [(STATE.to_owned(), known.to_owned())]);
    }

    #[test]
    fn the_last_to_register_serves_and_only_it_can_unregister() {
        let mut registry = Registry::default();
        registry
            .register_service("/p", "/reset", "rosrpc://10.0.0.3:5", PLANT)
            .unwrap();
        registry
            .register_service("/c", "/reset", "rosrpc://10.0.0.2:5", CONTROLLER)
            .unwrap();
        assert_eq!(registry.service("/reset"), Some("rosrpc://10.0.0.2:5"));
        assert!(!registry.unregister_service("/p", "/reset", "rosrpc://10.0.0.3:5"));
        assert!(registry.unregister_service("/c", "/reset", "rosrpc://10.0.0.2:5"));
        assert_eq!(registry.service("/reset"), None);
    }

    #[test]
    fn a_caller_gone_wild_fills_the_table_and_no_more() {
        let mut registry = Registry::default();
        for number in 0..MOST_NAMES {
            registry
                .register_publisher("/p", &format!("/t{number}"), "a/B", PLANT)
                .unwrap();
        }
        assert_eq!(
            registry.register_publisher("/p", "/one_more", "a/B", PLANT),
            Err(Full)
        );
    }
}
