//! Master and nodes together, over the loopback.

use std::{
    io::{Read, Write},
    net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream},
    sync::mpsc::{Receiver, Sender, channel},
    time::{Duration, Instant},
};

use simulation::ros::float64_multi_array::{Encoder, MESSAGE_TYPE, decode};

use super::{
    Master, Node, NodeConfig, Notice, Notices, Publisher, RosError, Subscription,
    connection_header::ConnectionHeader,
    stop::Stop,
    xml_rpc::{Client, Value},
};

const HOST: Ipv4Addr = Ipv4Addr::LOCALHOST;
const TIMEOUT: Duration = Duration::from_secs(20);

fn master() -> Master {
    let listener = TcpListener::bind((HOST, 0)).unwrap();
    Master::start(listener, Notices::ignored()).unwrap()
}

fn node(name: &str, master: &Master) -> (Node, Receiver<Notice>) {
    let (notices, received) = Notices::queue(1000);
    let config = NodeConfig {
        notices,
        ..NodeConfig::new(name, HOST, &master.uri())
    };
    (Node::start(config).unwrap(), received)
}

fn forward(node: &Node, topic: &str) -> (Subscription, Receiver<[f64; 2]>) {
    let (sender, receiver): (Sender<[f64; 2]>, _) = channel();
    let on_message = move |message: &[u8]| sender.send(decode(message).unwrap()).unwrap_or_default();
    (node.subscribe(topic, MESSAGE_TYPE, on_message).unwrap(), receiver)
}

fn publish(publisher: &mut Publisher, values: [f64; 2]) -> u32 {
    publisher.publish(Encoder::new(["a", "b"]).encode(&values)).sent
}

/// Where a node takes subscribers of a topic, as its slave API says.
fn topic_address(slave_uri: &str, topic: &str) -> SocketAddr {
    let client = Client::new(slave_uri, Stop::new().unwrap()).unwrap();
    let protocols = Value::Array(vec![Value::from(vec!["TCPROS"])]);
    let params = ["/stranger".into(), topic.into(), protocols];
    let answer = client
        .call_ros("requestTopic", &params, Instant::now() + TIMEOUT)
        .unwrap();
    match answer.as_array().unwrap() {
        [_, Value::Text(host), Value::Int(port)] => format!("{host}:{port}").parse().unwrap(),
        other => panic!("{other:?}"),
    }
}

fn greet(address: SocketAddr, header: &ConnectionHeader) -> TcpStream {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    stream.write_all(&header.to_bytes()).unwrap();
    stream
}

fn read_header(stream: &mut TcpStream) -> ConnectionHeader {
    let mut length = [0; 4];
    stream.read_exact(&mut length).unwrap();
    let mut header = vec![0; u32::from_le_bytes(length) as usize];
    stream.read_exact(&mut header).unwrap();
    ConnectionHeader::parse(&header).unwrap()
}

#[test]
fn two_nodes_exchange_messages_both_ways() {
    let master = master();
    let (plant, _) = node("/plant", &master);
    let (controller, _) = node("/controller", &master);
    let mut state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let (commands, command_values) = forward(&plant, "/command");
    let (states, state_values) = forward(&controller, "/state");
    let mut command = controller.advertise("command", MESSAGE_TYPE).unwrap();

    state.subscribers().wait_for(1, TIMEOUT).unwrap();
    states.wait_for_publishers(1, TIMEOUT).unwrap();
    command.subscribers().wait_for(1, TIMEOUT).unwrap();
    commands.wait_for_publishers(1, TIMEOUT).unwrap();
    for number in 0..100 {
        assert_eq!(publish(&mut state, [f64::from(number), 0.5]), 1);
        assert_eq!(
            state_values.recv_timeout(TIMEOUT).unwrap(),
            [f64::from(number), 0.5]
        );
        assert_eq!(publish(&mut command, [1.0, f64::from(number)]), 1);
        assert_eq!(
            command_values.recv_timeout(TIMEOUT).unwrap(),
            [1.0, f64::from(number)]
        );
    }
    assert_eq!((state.subscribers().count(), states.publishers()), (1, 1));
    controller.shutdown();
    plant.shutdown();
    master.stop();
}

#[test]
fn what_a_node_has_shut_down_the_master_has_forgotten() {
    let master = master();
    let (plant, _) = node("/plant", &master);
    let (controller, _) = node("/controller", &master);
    let _state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let (states, _) = forward(&controller, "/state");
    states.wait_for_publishers(1, TIMEOUT).unwrap();
    let client = Client::new(&master.uri(), Stop::new().unwrap()).unwrap();
    let state = || {
        client
            .call_ros("getSystemState", &["/x".into()], Instant::now() + TIMEOUT)
            .unwrap()
    };
    let row = |node: &str| Value::Array(vec![Value::Array(vec!["/state".into(), Value::from(vec![node])])]);
    let none = || Value::Array(Vec::new());
    assert_eq!(
        state(),
        Value::Array(vec![row("/plant"), row("/controller"), none()])
    );
    plant.shutdown();
    assert_eq!(state(), Value::Array(vec![none(), row("/controller"), none()]));
    controller.shutdown();
    assert_eq!(state(), Value::Array(vec![none(), none(), none()]));
}

#[test]
fn a_publisher_that_ends_and_comes_back_is_found_again() {
    let master = master();
    let (controller, notices) = node("/controller", &master);
    let (states, values) = forward(&controller, "/state");
    for life in 0..3 {
        let (plant, _) = node("/plant", &master);
        let mut state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
        state.subscribers().wait_for(1, TIMEOUT).unwrap();
        assert_eq!(publish(&mut state, [f64::from(life), 0.0]), 1);
        assert_eq!(values.recv_timeout(TIMEOUT).unwrap(), [f64::from(life), 0.0]);
        if life == 1 {
            // It dies without a word: the next one takes its name over.
            drop(plant);
        } else {
            plant.shutdown();
        }
    }
    let connected = notices
        .try_iter()
        .filter(|notice| matches!(notice, Notice::PublisherConnected { .. }));
    assert_eq!(connected.count(), 3);
    drop(states);
}

#[test]
fn a_broken_connection_is_made_again_while_the_publisher_is_registered() {
    let master = master();
    let (controller, _) = node("/controller", &master);
    // A publisher of our own making, whose connections we can break.
    let slave = TcpListener::bind((HOST, 0)).unwrap();
    let topic = TcpListener::bind((HOST, 0)).unwrap();
    let topic_port = topic.local_addr().unwrap().port();
    let slave_uri = format!("http://{}/", slave.local_addr().unwrap());
    let crew = super::thread_group::ThreadGroup::new().unwrap();
    super::xml_rpc::serve(
        slave,
        &crew,
        &Notices::ignored(),
        std::sync::Arc::new(OneTopic(topic_port)),
    )
    .unwrap();
    let client = Client::new(&master.uri(), Stop::new().unwrap()).unwrap();
    let params = ["/plant", "/state", MESSAGE_TYPE.name, &slave_uri].map(Value::from);
    client
        .call_ros("registerPublisher", &params, Instant::now() + TIMEOUT)
        .unwrap();

    let (_states, values) = forward(&controller, "/state");
    for life in 0..3 {
        let (mut stream, _) = topic.accept().unwrap();
        assert_eq!(read_header(&mut stream).get("topic"), Some("/state"));
        let answer = ConnectionHeader::new([("type", MESSAGE_TYPE.name), ("md5sum", MESSAGE_TYPE.md5sum)]);
        let mut bytes = answer.to_bytes();
        let mut encoder = Encoder::new(["a", "b"]);
        let message = encoder.encode(&[f64::from(life), 1.0]);
        bytes.extend_from_slice(&(message.len() as u32).to_le_bytes());
        bytes.extend_from_slice(message);
        stream.write_all(&bytes).unwrap();
        assert_eq!(values.recv_timeout(TIMEOUT).unwrap(), [f64::from(life), 1.0]);
    }
    controller.shutdown();
    crew.dismiss(TIMEOUT);
}

struct OneTopic(u16);

impl super::xml_rpc::Api for OneTopic {
    fn call(
        &self,
        _method: &str,
        _params: super::xml_rpc::Params<'_>,
    ) -> Result<Value, super::xml_rpc::Fault> {
        let address = vec!["TCPROS".into(), HOST.to_string().into(), i32::from(self.0).into()];
        Ok(Value::Array(vec![1.into(), "".into(), Value::Array(address)]))
    }
}

#[rstest::rstest]
#[case::sum("std_msgs/Float64MultiArray", "0123456789abcdef0123456789abcdef")]
#[case::kind("std_msgs/String", "4b7d974086d4060e7db4613a7e6c3ba4")]
fn a_wrong_type_is_refused_with_its_reason_and_others_are_served(#[case] kind: &str, #[case] md5sum: &str) {
    let master = master();
    let (plant, notices) = node("/plant", &master);
    let (controller, _) = node("/controller", &master);
    let mut state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let (states, values) = forward(&controller, "/state");
    states.wait_for_publishers(1, TIMEOUT).unwrap();
    state.subscribers().wait_for(1, TIMEOUT).unwrap();

    let header = ConnectionHeader::new([
        ("callerid", "/stranger"),
        ("topic", "/state"),
        ("type", kind),
        ("md5sum", md5sum),
    ]);
    let mut stream = greet(topic_address(plant.slave_uri(), "/state"), &header);
    let answer = read_header(&mut stream);
    assert!(
        answer
            .get("error")
            .unwrap()
            .contains("is std_msgs/Float64MultiArray with sum"),
        "{answer:?}"
    );
    let refused = notices
        .iter()
        .find(|notice| matches!(notice, Notice::SubscriberRefused { .. }))
        .unwrap();
    assert!(refused.to_string().contains(md5sum), "{refused}");
    assert_eq!(publish(&mut state, [1.0, 2.0]), 1);
    assert_eq!(values.recv_timeout(TIMEOUT).unwrap(), [1.0, 2.0]);
}

#[test]
fn any_type_is_served_to_who_asks_for_any() {
    let master = master();
    let (plant, _) = node("/plant", &master);
    let mut state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let header = ConnectionHeader::new([
        ("callerid", "/rostopic"),
        ("topic", "/state"),
        ("type", "*"),
        ("md5sum", "*"),
        ("tcp_nodelay", "1"),
    ]);
    let mut stream = greet(topic_address(plant.slave_uri(), "/state"), &header);
    let answer = read_header(&mut stream);
    assert_eq!(answer.get("type"), Some(MESSAGE_TYPE.name));
    assert_eq!(answer.get("message_definition"), Some(MESSAGE_TYPE.definition));
    state.subscribers().wait_for(1, TIMEOUT).unwrap();
    assert_eq!(publish(&mut state, [1.0, 2.0]), 1);
    let mut length = [0; 4];
    stream.read_exact(&mut length).unwrap();
    drop(stream);
    while state.subscribers().count() > 0 {
        std::thread::yield_now();
    }
}

#[rstest::rstest]
#[case(true)]
#[case(false)]
fn the_subscriber_decides_about_tcp_nodelay(#[case] asks: bool) {
    let master = master();
    let (plant, _) = node("/plant", &master);
    let config = NodeConfig {
        tcp_nodelay: asks,
        ..NodeConfig::new("/controller", HOST, &master.uri())
    };
    let controller = Node::start(config).unwrap();
    let mut state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let _states = forward(&controller, "/state");
    state.subscribers().wait_for(1, TIMEOUT).unwrap();
    publish(&mut state, [1.0, 2.0]);
    assert_eq!(state.nodelay(), [asks]);
}

#[test]
fn a_subscriber_that_says_nothing_is_refused() {
    let master = master();
    let (notices, received) = Notices::queue(10);
    let config = NodeConfig {
        notices,
        header_patience: Duration::from_millis(20),
        ..NodeConfig::new("/plant", HOST, &master.uri())
    };
    let plant = Node::start(config).unwrap();
    let _state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let mut silent = TcpStream::connect(topic_address(plant.slave_uri(), "/state")).unwrap();
    let refused = received
        .iter()
        .find(|notice| matches!(notice, Notice::SubscriberRefused { .. }))
        .unwrap();
    assert!(refused.to_string().contains("it took too long"), "{refused}");
    assert!(read_header(&mut silent).get("error").is_some());
}

#[test]
fn a_registration_under_way_when_the_node_ends_is_taken_back() {
    let master = master();
    let client = Client::new(&master.uri(), Stop::new().unwrap()).unwrap();
    for _ in 0..20 {
        let (plant, _) = node("/plant", &master);
        let _state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
        let _commands = forward(&plant, "/command");
        plant.shutdown();
        let state = client
            .call_ros("getSystemState", &["/x".into()], Instant::now() + TIMEOUT)
            .unwrap();
        assert_eq!(state, Value::Array(vec![Value::Array(Vec::new()); 3]));
    }
}

#[rstest::rstest]
#[case::length(&[0xff, 0xff, 0xff, 0x7f], "above the limit")]
#[case::field(b"\x08\0\0\0\xff\0\0\0abcd", "ends within a field")]
#[case::no_topic(b"\x07\0\0\0\x03\0\0\0a=b", "has no `topic`")]
#[case::cut(b"\x08\0\0\0\x04", "closed the connection")]
fn a_malformed_header_is_refused_with_its_reason(#[case] bytes: &[u8], #[case] reason: &str) {
    let master = master();
    let (plant, notices) = node("/plant", &master);
    let _state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let mut stream = TcpStream::connect(topic_address(plant.slave_uri(), "/state")).unwrap();
    stream.write_all(bytes).unwrap();
    stream.shutdown(std::net::Shutdown::Write).unwrap();
    let refused = notices
        .iter()
        .find(|notice| matches!(notice, Notice::SubscriberRefused { .. }))
        .unwrap();
    assert!(refused.to_string().contains(reason), "{refused}");
}

#[test]
fn a_topic_has_one_publisher_and_one_subscription_at_a_node() {
    let master = master();
    let (plant, _) = node("/plant", &master);
    let first = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    assert!(matches!(
        plant.advertise("/state", MESSAGE_TYPE),
        Err(RosError::Taken { .. })
    ));
    drop(first);
    plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let (first, _) = forward(&plant, "/command");
    assert!(matches!(
        plant.subscribe("/command", MESSAGE_TYPE, |_| ()),
        Err(RosError::Taken { .. })
    ));
    drop(first);
    forward(&plant, "/command");
    assert!(matches!(
        plant.advertise("/no good", MESSAGE_TYPE),
        Err(RosError::BadName { .. })
    ));
}

#[test]
fn without_a_master_who_waits_learns_it_when_the_patience_is_over() {
    let nobody = TcpListener::bind((HOST, 0)).unwrap();
    let uri = format!("http://{}/", nobody.local_addr().unwrap());
    drop(nobody);
    let config = NodeConfig {
        master_patience: Duration::from_millis(50),
        ..NodeConfig::new("/plant", HOST, &uri)
    };
    let plant = Node::start(config).unwrap();
    let state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let error = state.subscribers().wait_for(1, TIMEOUT).unwrap_err();
    assert!(matches!(error, RosError::MasterUnreachable { .. }), "{error}");
    assert!(error.hint().is_some());
    plant.shutdown();
}

#[test]
fn a_master_that_comes_late_is_found() {
    let place = TcpListener::bind((HOST, 0)).unwrap();
    let address = place.local_addr().unwrap();
    drop(place);
    let (notices, received) = Notices::queue(100);
    let config = NodeConfig {
        notices,
        ..NodeConfig::new("/plant", HOST, &format!("http://{address}/"))
    };
    let plant = Node::start(config).unwrap();
    let state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let (states, _) = forward(&plant, "/state");
    received
        .iter()
        .find(|notice| matches!(notice, Notice::MasterCallFailed { .. }))
        .unwrap();
    let master = Master::start(TcpListener::bind(address).unwrap(), Notices::ignored()).unwrap();
    state.subscribers().wait_for(1, TIMEOUT).unwrap();
    states.wait_for_publishers(1, TIMEOUT).unwrap();
    master.stop();
}

#[test]
fn a_master_that_restarts_is_told_again_and_messages_flow_meanwhile() {
    let listener = TcpListener::bind((HOST, 0)).unwrap();
    let address = listener.local_addr().unwrap();
    let mut master = Master::start(listener, Notices::ignored()).unwrap();
    let (plant, plant_notices) = node("/plant", &master);
    let (controller, controller_notices) = node("/controller", &master);
    let mut state = plant.advertise("/state", MESSAGE_TYPE).unwrap();
    let (states, values) = forward(&controller, "/state");
    states.wait_for_publishers(1, TIMEOUT).unwrap();
    state.subscribers().wait_for(1, TIMEOUT).unwrap();
    for life in 0..3 {
        master.stop();
        // Nobody is there for a moment, and nobody minds.
        assert_eq!(publish(&mut state, [f64::from(life), 0.0]), 1);
        assert_eq!(values.recv_timeout(TIMEOUT).unwrap(), [f64::from(life), 0.0]);
        let listener = std::iter::repeat_with(|| TcpListener::bind(address)).find_map(Result::ok);
        master = Master::start(listener.unwrap(), Notices::ignored()).unwrap();
        for notices in [&plant_notices, &controller_notices] {
            let mut notices = notices.iter();
            notices
                .find(|notice| matches!(notice, Notice::RegisteredAgain { .. }))
                .unwrap();
        }
        // Who comes now finds the topic.
        let (stranger, _) = node("/stranger", &master);
        let (seen, _) = forward(&stranger, "/state");
        seen.wait_for_publishers(1, TIMEOUT).unwrap();
        state.subscribers().wait_for(2, TIMEOUT).unwrap();
        stranger.shutdown();
        while state.subscribers().count() > 1 {
            std::thread::yield_now();
        }
        publish(&mut state, [-1.0, 0.0]);
        assert_eq!(values.recv_timeout(TIMEOUT).unwrap(), [-1.0, 0.0]);
    }
    let broken = controller_notices
        .try_iter()
        .filter(|notice| matches!(notice, Notice::PublisherLost { .. }));
    assert_eq!(broken.count(), 0);
    master.stop();
}
