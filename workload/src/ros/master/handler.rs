//! The master's methods, from XML-RPC's values to the registry and the parameters and back. The main type is
//! [`Handler`].

use std::sync::{Mutex, MutexGuard, PoisonError};

use super::{
    callbacks::{Callback, Callbacks},
    parameters::Parameters,
    registry::Registry,
};
use crate::ros::{
    name,
    xml_rpc::{Api, Fault, Params, Value, ValueError},
};

/// Answers the master's calls.
pub(super) struct Handler {
    pub uri: String,
    pub callbacks: Callbacks,
    pub tables: Mutex<Tables>,
}

/// What the master knows. One lock, since a subscription must see either all or nothing of a registration.
#[derive(Debug, Default)]
pub(super) struct Tables {
    registry: Registry,
    parameters: Parameters,
}

/// The words and the value of an answer; an error becomes ROS's own form of one.
type Answer = Result<(String, Value), Refusal>;

/// A call that is understood and not granted.
struct Refusal {
    words: String,
    /// What the value of the answer should look like all the same: rospy looks at it.
    value: Value,
}

impl From<ValueError> for Refusal {
    fn from(error: ValueError) -> Self {
        Self {
            words: format!("ERROR: {error}"),
            value: 0.into(),
        }
    }
}

fn refused(reason: impl ToString) -> Refusal {
    Refusal {
        words: reason.to_string(),
        value: 0.into(),
    }
}

impl Api for Handler {
    fn call(&self, method: &str, params: Params<'_>) -> Result<Value, Fault> {
        let answer = match method {
            "registerPublisher" => self.register_publisher(params),
            "unregisterPublisher" => self.unregister_publisher(params),
            "registerSubscriber" => self.register_subscriber(params),
            "unregisterSubscriber" => self.unregister_subscriber(params),
            "registerService" => self.register_service(params),
            "unregisterService" => self.unregister_service(params),
            "lookupService" => self.lookup_service(params),
            "lookupNode" => self.lookup_node(params),
            "getPublishedTopics" => self.published_topics(params),
            "getTopicTypes" => Ok(("topic types".into(), pairs(self.lock().registry.topic_types()))),
            "getSystemState" => self.system_state(),
            "getUri" => Ok((String::new(), self.uri.as_str().into())),
            "getPid" => Ok((
                String::new(),
                i32::try_from(std::process::id()).unwrap_or(0).into(),
            )),
            "setParam" => self.set_parameter(params),
            "getParam" => self.get_parameter(params),
            "hasParam" => self.has_parameter(params),
            "deleteParam" => self.delete_parameter(params),
            "searchParam" => self.search_parameter(params),
            "subscribeParam" => self.subscribe_parameter(params),
            "unsubscribeParam" => self.unsubscribe_parameter(params),
            "getParamNames" => Ok(("parameter names".into(), self.lock().parameters.names().into())),
            "shutdown" => Err(refused("this master ends with its experiment")),
            _ => return Err(Fault::unknown_method(method)),
        };
        Ok(match answer {
            Ok((words, value)) => Value::Array(vec![1.into(), words.into(), value]),
            Err(Refusal { words, value }) => Value::Array(vec![(-1).into(), words.into(), value]),
        })
    }
}

/// A caller, a name and an address, as most registrations have them.
struct Registration<'a> {
    caller: &'a str,
    name: &'a str,
    api: &'a str,
}

impl<'a> Registration<'a> {
    fn of(params: Params<'a>, api_at: usize) -> Result<Self, Refusal> {
        let registration = Self {
            caller: params.text(0, "caller_id")?,
            name: params.text(1, "name")?,
            api: params.text(api_at, "caller_api")?,
        };
        for name in [registration.caller, registration.name] {
            if !name::is_global(name) {
                return Err(refused(format!("ERROR: `{name}` is not a global name")));
            }
        }
        if !registration.api.contains("://") || registration.api.len() > 1024 {
            return Err(refused("ERROR: caller_api should be a URI"));
        }
        Ok(registration)
    }
}

impl Handler {
    fn lock(&self) -> MutexGuard<'_, Tables> {
        self.tables.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn register_publisher(&self, params: Params<'_>) -> Answer {
        let Registration { caller, name, api } = Registration::of(params, 3)?;
        let topic_type = params.text(2, "topic_type")?;
        let mut tables = self.lock();
        let (subscribers, tell) = tables
            .registry
            .register_publisher(caller, name, topic_type, api)
            .map_err(refused)?;
        // While the lock is held, so that updates are told in the order of what caused them.
        self.callbacks.tell(tell);
        Ok((
            format!("Registered [{caller}] as publisher of [{name}]"),
            subscribers.into(),
        ))
    }

    fn unregister_publisher(&self, params: Params<'_>) -> Answer {
        let Registration { caller, name, api } = Registration::of(params, 2)?;
        let mut tables = self.lock();
        let (removed, tell) = tables.registry.unregister_publisher(caller, name, api);
        self.callbacks.tell(tell);
        Ok(unregistered(caller, name, removed))
    }

    fn register_subscriber(&self, params: Params<'_>) -> Answer {
        let Registration { caller, name, api } = Registration::of(params, 3)?;
        let topic_type = params.text(2, "topic_type")?;
        let mut tables = self.lock();
        let (publishers, tell) = tables
            .registry
            .register_subscriber(caller, name, topic_type, api)
            .map_err(refused)?;
        self.callbacks.tell(tell);
        self.callbacks.prepare(api);
        Ok((format!("Subscribed to [{name}]"), publishers.into()))
    }

    fn unregister_subscriber(&self, params: Params<'_>) -> Answer {
        let Registration { caller, name, api } = Registration::of(params, 2)?;
        let removed = self.lock().registry.unregister_subscriber(caller, name, api);
        Ok(unregistered(caller, name, removed))
    }

    fn register_service(&self, params: Params<'_>) -> Answer {
        let Registration { caller, name, api } = Registration::of(params, 3)?;
        let uri = params.text(2, "service_api")?;
        let mut tables = self.lock();
        let tell = tables
            .registry
            .register_service(caller, name, uri, api)
            .map_err(refused)?;
        self.callbacks.tell(tell);
        Ok((format!("Registered [{caller}] as provider of [{name}]"), 1.into()))
    }

    fn unregister_service(&self, params: Params<'_>) -> Answer {
        let Registration { caller, name, api } = Registration::of(params, 2)?;
        let removed = self.lock().registry.unregister_service(caller, name, api);
        Ok(unregistered(caller, name, removed))
    }

    fn lookup_service(&self, params: Params<'_>) -> Answer {
        let service = params.text(1, "service")?;
        match self.lock().registry.service(service) {
            Some(uri) => Ok((format!("rosrpc URI: [{uri}]"), uri.into())),
            None => Err(Refusal {
                words: "no provider".into(),
                value: "".into(),
            }),
        }
    }

    fn lookup_node(&self, params: Params<'_>) -> Answer {
        let node = params.text(1, "node_name")?;
        match self.lock().registry.node(node) {
            Some(api) => Ok(("node api".into(), api.into())),
            None => Err(Refusal {
                words: format!("unknown node [{node}]"),
                value: "".into(),
            }),
        }
    }

    fn published_topics(&self, params: Params<'_>) -> Answer {
        let within = params.text(1, "subgraph")?;
        let within = if within.is_empty() || within.ends_with('/') {
            within.to_owned()
        } else {
            format!("{within}/")
        };
        Ok((
            "current topics".into(),
            pairs(self.lock().registry.published_topics(&within)),
        ))
    }

    fn system_state(&self) -> Answer {
        let state = self.lock().registry.state().map(|table| {
            let rows = table
                .into_iter()
                .map(|(name, nodes)| Value::Array(vec![name.into(), nodes.into()]));
            Value::Array(rows.collect())
        });
        Ok(("current system state".into(), Value::Array(state.into())))
    }

    fn set_parameter(&self, params: Params<'_>) -> Answer {
        let (caller, key) = parameter(params, 1)?;
        let value = params.value(2, "value")?.clone();
        let mut tables = self.lock();
        tables.parameters.set(&key, value).map_err(refused)?;
        self.tell_parameter(&tables, caller, &key);
        Ok((format!("parameter {key} set"), 0.into()))
    }

    fn get_parameter(&self, params: Params<'_>) -> Answer {
        let (_, key) = parameter(params, 1)?;
        match self.lock().parameters.get(&key) {
            Some(value) => Ok((format!("Parameter [{key}]"), value)),
            None => Err(refused(format!("Parameter [{key}] is not set"))),
        }
    }

    fn has_parameter(&self, params: Params<'_>) -> Answer {
        let (_, key) = parameter(params, 1)?;
        let has = self.lock().parameters.get(&key).is_some();
        Ok((key, has.into()))
    }

    fn delete_parameter(&self, params: Params<'_>) -> Answer {
        let (_, key) = parameter(params, 1)?;
        let mut tables = self.lock();
        if !tables.parameters.delete(&key) {
            return Err(refused(format!("parameter [{key}] is not set")));
        }
        // Whoever deletes is told too, as rosmaster does.
        self.tell_parameter(&tables, "", &key);
        Ok((format!("parameter {key} deleted"), 0.into()))
    }

    fn search_parameter(&self, params: Params<'_>) -> Answer {
        let (caller, key) = (params.text(0, "caller_id")?, params.text(1, "key")?);
        match self.lock().parameters.search(caller, key) {
            Some(found) => Ok((format!("Found [{found}]"), found.into())),
            None => Err(Refusal {
                words: format!("Cannot find parameter [{key}] in an upwards search"),
                value: "".into(),
            }),
        }
    }

    fn subscribe_parameter(&self, params: Params<'_>) -> Answer {
        let (caller, key) = parameter(params, 2)?;
        let api = params.text(1, "caller_api")?;
        let mut tables = self.lock();
        let tell = tables
            .registry
            .subscribe_parameter(caller, &key, api)
            .map_err(refused)?;
        self.callbacks.tell(tell);
        let value = tables.parameters.get(&key).unwrap_or_else(Value::nothing);
        Ok((format!("Subscribed to parameter [{key}]"), value))
    }

    fn unsubscribe_parameter(&self, params: Params<'_>) -> Answer {
        let (caller, key) = parameter(params, 2)?;
        let api = params.text(1, "caller_api")?;
        let removed = self.lock().registry.unsubscribe_parameter(caller, &key, api);
        Ok((
            format!("Unsubscribed from parameter [{key}]"),
            i32::from(removed).into(),
        ))
    }

    fn tell_parameter(&self, tables: &Tables, caller: &str, changed: &str) {
        let told = tables
            .registry
            .parameter_subscribers(caller)
            .into_iter()
            .flat_map(|(subscribed, apis)| {
                let update = tables.parameters.update(&subscribed, changed);
                apis.into_iter().filter_map(move |api| {
                    let (key, value) = update.clone()?;
                    Some(Callback::ParamUpdate { api, key, value })
                })
            });
        self.callbacks.tell(told.collect());
    }
}

/// The caller and the full name of the parameter that it means.
fn parameter(params: Params<'_>, key_at: usize) -> Result<(&str, String), Refusal> {
    let (caller, key) = (params.text(0, "caller_id")?, params.text(key_at, "key")?);
    if key.is_empty() {
        return Err(refused("ERROR: key should not be empty"));
    }
    Ok((caller, name::resolve(key, caller)))
}

fn unregistered(caller: &str, name: &str, removed: bool) -> (String, Value) {
    let words = if removed {
        format!("Unregistered [{caller}] as provider of [{name}]")
    } else {
        format!("[{caller}] is not a known provider of [{name}]")
    };
    (words, i32::from(removed).into())
}

fn pairs(pairs: Vec<(String, String)>) -> Value {
    let pair = |(name, kind): (String, String)| Value::from(vec![name, kind]);
    Value::Array(pairs.into_iter().map(pair).collect())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ros::{Notices, thread_group::ThreadGroup};

    const METHODS: [&str; 22] = [
        "registerPublisher",
        "unregisterPublisher",
        "registerSubscriber",
        "unregisterSubscriber",
        "registerService",
        "unregisterService",
        "lookupService",
        "lookupNode",
        "getPublishedTopics",
        "getTopicTypes",
        "getSystemState",
        "getUri",
        "getPid",
        "setParam",
        "getParam",
        "hasParam",
        "deleteParam",
        "searchParam",
        "subscribeParam",
        "unsubscribeParam",
        "getParamNames",
        "shutdown",
    ];

    fn handler() -> Handler {
        let callbacks = Callbacks::new(ThreadGroup::new().unwrap(), Notices::ignored());
        // Nobody is there to be told.
        callbacks.close();
        Handler {
            uri: "http://10.0.0.1:11311/".into(),
            callbacks,
            tables: Mutex::default(),
        }
    }

    fn call(handler: &Handler, method: &str, params: &[&str]) -> Vec<Value> {
        let params: Vec<Value> = params.iter().map(|param| Value::from(*param)).collect();
        handler
            .call(method, Params(&params))
            .unwrap()
            .as_array()
            .unwrap()
            .to_vec()
    }

    #[test]
    fn a_name_that_is_not_global_is_refused_with_its_reason() {
        let answer = call(
            &handler(),
            "registerPublisher",
            &["/p", "state", "a/B", "http://10.0.0.3:1/"],
        );
        assert_eq!(
            answer,
            [
                (-1).into(),
                "ERROR: `state` is not a global name".into(),
                0.into()
            ]
        );
    }

    #[test]
    fn a_missing_parameter_is_named() {
        let answer = call(&handler(), "registerPublisher", &["/p", "/state"]);
        assert_eq!(
            answer,
            [(-1).into(), "ERROR: caller_api should be given".into(), 0.into()]
        );
    }

    #[test]
    fn topics_are_listed_within_a_namespace() {
        let handler = handler();
        for topic in ["/plant/state", "/plantation"] {
            call(
                &handler,
                "registerPublisher",
                &["/p", topic, "a/B", "http://10.0.0.3:1/"],
            );
        }
        let row = |topic: &str| Value::from(vec![topic, "a/B"]);
        let within = call(&handler, "getPublishedTopics", &["/p", "/plant"]);
        assert_eq!(within[2], Value::Array(vec![row("/plant/state")]));
        let all = call(&handler, "getPublishedTopics", &["/p", ""]);
        assert_eq!(
            all[2],
            Value::Array(vec![row("/plant/state"), row("/plantation")])
        );
    }

    #[test]
    fn a_private_parameter_belongs_to_its_caller() {
        let handler = handler();
        call(&handler, "setParam", &["/controller", "~gain", "2"]);
        assert_eq!(
            call(&handler, "getParam", &["/x", "/controller/gain"])[2],
            "2".into()
        );
        assert_eq!(call(&handler, "getParam", &["/x", "~gain"])[0], (-1).into());
    }

    proptest! {
        #[test]
        fn no_parameters_make_it_panic_or_answer_without_form(
            calls in proptest::collection::vec(
                (0_usize..22, proptest::collection::vec(
                    prop_oneof![
                        "(/|~)?[a-z/]{0,6}".prop_map(Value::Text),
                        Just(Value::from("http://10.0.0.3:1/")),
                        any::<i32>().prop_map(Value::Int),
                        Just(Value::nothing()),
                        Just(Value::Array(vec![Value::Nil])),
                    ],
                    0..5,
                )),
                0..20,
            ),
        ) {
            let handler = handler();
            for (method, params) in calls {
                let answer = handler.call(METHODS[method], Params(&params)).unwrap();
                let is_formed = matches!(answer.as_array(), Some([Value::Int(_), Value::Text(_), _]));
                prop_assert!(is_formed, "{answer:?}");
            }
        }
    }
}
