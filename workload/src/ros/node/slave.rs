//! What a node answers to the master, to other nodes and to rosnode. The main type is [`Slave`].
//!
//! Source: <http://wiki.ros.org/ROS/Slave_API>.

use std::sync::Arc;

use super::membership::Membership;
use crate::ros::{
    Notice,
    xml_rpc::{Api, Fault, Params, Value, ValueError},
};

/// A node's slave API.
pub(super) struct Slave(pub Arc<Membership>);

/// Status (1 is good, 0 a failure of ours, -1 an error of the caller's), words, value.
type Answer = (i32, String, Value);

impl Api for Slave {
    fn call(&self, method: &str, params: Params<'_>) -> Result<Value, Fault> {
        let good = |value: Value| Ok((1, String::new(), value));
        let answer = match method {
            "requestTopic" => self.request_topic(params),
            "publisherUpdate" => self.publisher_update(params),
            // No parameter is subscribed to.
            "paramUpdate" => Ok((-1, "this node subscribes to no parameters".into(), 0.into())),
            "getBusInfo" => good(self.bus_info()),
            // Connections are not counted message by message: the loops do that.
            "getBusStats" => good(Value::Array(vec![Value::Array(Vec::new()); 3])),
            "getMasterUri" => good(self.0.master_uri.as_str().into()),
            "getPid" => good(i32::try_from(std::process::id()).unwrap_or(0).into()),
            "getSubscriptions" => good(self.subscriptions()),
            "getPublications" => good(self.publications()),
            "shutdown" => self.shutdown(params),
            _ => return Err(Fault::unknown_method(method)),
        };
        let (status, words, value) =
            answer.unwrap_or_else(|error: ValueError| (-1, format!("ERROR: {error}"), 0.into()));
        Ok(Value::Array(vec![status.into(), words.into(), value]))
    }
}

impl Slave {
    fn request_topic(&self, params: Params<'_>) -> Result<Answer, ValueError> {
        let topic = params.text(1, "topic")?;
        let protocols = params.array(2, "protocols")?;
        let is_tcpros = |protocol: &Value| {
            let name = protocol
                .as_array()
                .and_then(<[Value]>::first)
                .and_then(Value::as_text);
            name == Some("TCPROS")
        };
        if self.0.publication(topic).is_none() {
            return Ok((
                0,
                format!("[{}] does not publish [{topic}]", self.0.name),
                0.into(),
            ));
        }
        if !protocols.iter().any(is_tcpros) {
            return Ok((0, "no protocol but TCPROS is spoken here".into(), 0.into()));
        }
        let (host, port) = (self.0.address.to_string(), self.0.topic_port);
        let words = format!("ready on {host}:{port}");
        Ok((
            1,
            words,
            Value::Array(vec!["TCPROS".into(), host.into(), i32::from(port).into()]),
        ))
    }

    fn publisher_update(&self, params: Params<'_>) -> Result<Answer, ValueError> {
        let topic = params.text(1, "topic")?;
        let publishers = params.texts(2, "publishers")?;
        if let Some(intake) = self.0.intake(topic) {
            intake.update(&publishers);
        }
        Ok((1, String::new(), 0.into()))
    }

    fn shutdown(&self, params: Params<'_>) -> Result<Answer, ValueError> {
        let reason = params
            .0
            .get(1)
            .and_then(Value::as_text)
            .unwrap_or_default()
            .to_owned();
        self.0.notices.send(Notice::ShutdownAsked {
            node: self.0.name.clone(),
            reason,
        });
        Ok((0, "this node ends with its experiment".into(), 0.into()))
    }

    /// Rows of number, peer, direction, transport, topic, connected.
    fn bus_info(&self) -> Value {
        let mut rows = Vec::new();
        let mut add = |peer: String, direction: &str, topic: &str| {
            let number = i32::try_from(rows.len()).unwrap_or(i32::MAX);
            let row = vec![
                number.into(),
                peer.into(),
                direction.into(),
                "TCPROS".into(),
                topic.into(),
                true.into(),
            ];
            rows.push(Value::Array(row));
        };
        for publication in self.0.publications() {
            for peer in publication.connections.peers() {
                add(peer, "o", &publication.topic);
            }
        }
        for intake in self.0.intakes() {
            for peer in intake.connections.peers() {
                add(peer, "i", &intake.topic);
            }
        }
        Value::Array(rows)
    }

    fn publications(&self) -> Value {
        let publications = self.0.publications().into_iter();
        let row = publications.map(|one| Value::from(vec![one.topic.as_str(), one.message_type.name]));
        Value::Array(row.collect())
    }

    fn subscriptions(&self) -> Value {
        let intakes = self.0.intakes().into_iter();
        let row = intakes.map(|one| Value::from(vec![one.topic.as_str(), one.message_type.name]));
        Value::Array(row.collect())
    }
}
