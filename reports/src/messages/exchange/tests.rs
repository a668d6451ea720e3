//! A model of TCP's sending, whose course is drawn at random and known byte by byte, against what is made of its packets.

use std::{collections::BTreeMap, ops::Range};

use etherparse::{PacketBuilder, TcpOptionElement};
use proptest::prelude::*;
use simulation::{
    message::{CommandMessage, StateMessage},
    ros::float64_multi_array::Encoder,
};

use record::topology::address_in_the_ball;

use super::*;

const STATE_PORTS: (u16, u16) = (41000, 42000);
const MILLISECOND: i64 = 1_000_000;

fn state(seq: u64) -> Vec<u8> {
    let message = StateMessage {
        seq,
        stamp_ns: seq as i64 * 20 * MILLISECOND,
        ..StateMessage::default()
    };
    framed(Encoder::new(StateMessage::FIELDS).encode(&message.to_values()))
}

fn command(seq: u64) -> Vec<u8> {
    let message = CommandMessage {
        seq,
        stamp_ns: seq as i64 * 20 * MILLISECOND,
        voltage_v: [1.0, 2.0],
    };
    framed(Encoder::new(CommandMessage::FIELDS).encode(&message.to_values()))
}

fn framed(message: &[u8]) -> Vec<u8> {
    [&(message.len() as u32).to_le_bytes(), message].concat()
}

/// A packet at a capture.
#[derive(Debug, Clone)]
struct Seen {
    at_ns: i64,
    host: VirtualHost,
    frame: Vec<u8>,
}

/// Makes packets of one connection: states one way, acknowledgements the other, clocks of TCP in milliseconds.
#[derive(Debug, Clone, Copy)]
struct Connection {
    first_sequence: u32,
    with_clock: bool,
}

impl Connection {
    fn data(self, offset: usize, bytes: &[u8], sent_ns: i64) -> Vec<u8> {
        let sequence = self.first_sequence.wrapping_add(offset as u32);
        self.frame(Topic::State, STATE_PORTS, sequence, 1, sent_ns, bytes)
    }

    fn acknowledgement(self, offset: usize, sent_ns: i64) -> Vec<u8> {
        let number = self.first_sequence.wrapping_add(offset as u32);
        self.frame(
            Topic::Command,
            (STATE_PORTS.1, STATE_PORTS.0),
            1,
            number,
            sent_ns,
            &[],
        )
    }

    fn frame(
        self,
        from: Topic,
        (source, destination): (u16, u16),
        sequence: u32,
        acknowledged: u32,
        sent_ns: i64,
        payload: &[u8],
    ) -> Vec<u8> {
        let [sender, receiver] = [from.sender(), from.receiver()];
        let builder = PacketBuilder::ethernet2([0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, 2])
            .ipv4(
                address_in_the_ball(sender).octets(),
                address_in_the_ball(receiver).octets(),
                64,
            )
            .tcp(source, destination, sequence, 1024)
            .ack(acknowledged);
        let mut frame = Vec::new();
        if self.with_clock {
            let clock = (sent_ns / MILLISECOND) as u32;
            let options = [TcpOptionElement::Timestamp(clock, 0)];
            builder
                .options(&options)
                .unwrap()
                .write(&mut frame, payload)
                .unwrap();
        } else {
            builder.write(&mut frame, payload).unwrap();
        }
        frame
    }
}

fn deliveries(mut packets: Vec<Seen>) -> Vec<(Ports, Delivery)> {
    packets.sort_by_key(|packet| packet.at_ns);
    let mut exchange = Exchange::of(Messages::Rates);
    let mut given = Vec::new();
    for Seen { at_ns, host, frame } in &packets {
        let packet = Packet {
            stamp_unix_ns: *at_ns,
            original_bytes: frame.len(),
            bytes: frame,
        };
        exchange
            .take(*host, &packet, &mut |ports, delivery| {
                given.push((ports, delivery))
            })
            .unwrap();
    }
    exchange.finish(&mut |ports, delivery| given.push((ports, delivery)));
    given
}

/// One transmission of `begin..end` of the stream.
#[derive(Debug, Clone)]
struct Transmission {
    begin: usize,
    end: usize,
    sent_ns: i64,
    /// When it arrives, if it does.
    arrived_ns: Option<i64>,
}

/// How the stream is cut into segments and what becomes of each. Segments follow each other by 3 to 8 ms, so that TCP's
/// clock tells them apart; a lost one is retransmitted 200 ms later, as many times as it takes; one in a while is
/// retransmitted for nothing.
fn transmissions(length: usize) -> impl Strategy<Value = Vec<Transmission>> {
    let fate = (
        1_usize..700,
        3_i64..9,
        0_i64..12,
        prop::collection::vec(prop::bool::weighted(0.2), 3),
        prop::bool::weighted(0.1),
    );
    prop::collection::vec(fate, 1..60).prop_map(move |fates| {
        let mut all = Vec::new();
        let (mut begin, mut now_ns) = (0, MILLISECOND);
        let mut fates = fates.into_iter().cycle();
        while begin < length {
            let Some((size, gap_ms, jitter_ms, losses, for_nothing)) = fates.next() else {
                break;
            };
            let end = (begin + size).min(length);
            now_ns += gap_ms * MILLISECOND;
            let lost = losses.iter().take_while(|lost| **lost).count();
            for attempt in 0..=lost + usize::from(for_nothing) {
                let sent_ns = now_ns + attempt as i64 * 201 * MILLISECOND;
                let arrived_ns = (attempt >= lost).then(|| sent_ns + (20 + jitter_ms) * MILLISECOND);
                all.push(Transmission {
                    begin,
                    end,
                    sent_ns,
                    arrived_ns,
                });
            }
            begin = end;
        }
        all
    })
}

/// What is expected of a message at `begin..end`, byte by byte.
fn oracle(transmissions: &[Transmission], begin: usize, end: usize) -> (i64, i64, u32, u32) {
    let mut first_sent = BTreeMap::new();
    let mut first_arrived = BTreeMap::new();
    let (mut again, mut duplicates) = (0, 0);
    let bytes = |transmission: &Transmission| transmission.begin.max(begin)..transmission.end.min(end);
    let mut sent: Vec<_> = transmissions.iter().filter(|it| !bytes(it).is_empty()).collect();
    sent.sort_by_key(|it| it.sent_ns);
    for transmission in &sent {
        let mut fresh = false;
        for byte in bytes(transmission) {
            first_sent.entry(byte).or_insert_with(|| {
                fresh = true;
                transmission.sent_ns
            });
        }
        again += u32::from(!fresh);
    }
    let mut arrived: Vec<_> = sent
        .into_iter()
        .filter_map(|it| Some((it.arrived_ns?, it)))
        .collect();
    arrived.sort_by_key(|(at_ns, _)| *at_ns);
    for (at_ns, transmission) in arrived {
        let mut fresh = false;
        for byte in bytes(transmission) {
            first_arrived.entry(byte).or_insert_with(|| {
                fresh = true;
                at_ns
            });
        }
        duplicates += u32::from(!fresh);
    }
    (
        *first_sent.values().max().unwrap(),
        *first_arrived.values().max().unwrap(),
        again,
        duplicates,
    )
}

/// The packets of a course at both captures, acknowledged as a receiver does: how far it is whole.
fn packets(connection: Connection, stream: &[u8], transmissions: &[Transmission]) -> Vec<Seen> {
    let mut packets = Vec::new();
    let mut arrivals: Vec<(i64, &Transmission)> = Vec::new();
    for it in transmissions {
        let frame = connection.data(it.begin, &stream[it.begin..it.end], it.sent_ns);
        if let Some(at_ns) = it.arrived_ns {
            packets.push(Seen {
                at_ns,
                host: VirtualHost::STA1,
                frame: frame.clone(),
            });
            arrivals.push((at_ns, it));
        }
        packets.push(Seen {
            at_ns: it.sent_ns,
            host: VirtualHost::STA2,
            frame,
        });
    }
    arrivals.sort_by_key(|(at_ns, _)| *at_ns);
    let mut there = vec![false; stream.len()];
    for (at_ns, it) in arrivals {
        there[it.begin..it.end].fill(true);
        let whole = there.iter().take_while(|there| **there).count();
        let frame = connection.acknowledgement(whole, at_ns);
        packets.push(Seen {
            at_ns: at_ns + 1,
            host: VirtualHost::STA1,
            frame: frame.clone(),
        });
        packets.push(Seen {
            at_ns: at_ns + 20 * MILLISECOND,
            host: VirtualHost::STA2,
            frame,
        });
    }
    packets
}

fn stream(count: u64) -> (Vec<u8>, usize) {
    let messages: Vec<Vec<u8>> = (1..=count).map(state).collect();
    (messages.concat(), messages[0].len())
}

proptest! {
    #[test]
    fn each_message_is_found_with_its_times_whatever_tcp_does_with_it(
        (count, course) in (1_u64..30).prop_flat_map(|count| {
            let length = stream(count).0.len();
            (Just(count), transmissions(length))
        }),
        first_sequence: u32,
        with_clock: bool,
    ) {
        let (stream, length) = stream(count);
        let connection = Connection { first_sequence, with_clock };
        let given = deliveries(packets(connection, &stream, &course));
        let numbers: Vec<u64> = given.iter().map(|(_, delivery)| delivery.label.seq).collect();
        prop_assert_eq!(numbers, (1..=count).collect::<Vec<_>>());
        let mut in_order = i64::MIN;
        for (index, (ports, delivery)) in given.iter().enumerate() {
            prop_assert_eq!(*ports, Ports { topic: Topic::State, from: STATE_PORTS.0, to: STATE_PORTS.1 });
            let (sent, arrived, again, duplicates) = oracle(&course, index * length, (index + 1) * length);
            in_order = in_order.max(arrived);
            prop_assert_eq!(delivery.wire_out_unix_ns, Some(sent));
            prop_assert_eq!(delivery.wire_in_unix_ns, Some(arrived));
            prop_assert_eq!(delivery.in_order_unix_ns, Some(in_order));
            prop_assert_eq!(delivery.retransmissions, again);
            prop_assert_eq!(delivery.duplicates, duplicates);
        }
    }

    #[test]
    fn what_a_capture_did_not_get_costs_the_messages_in_it_and_no_others(
        dropped in prop::collection::vec(0_usize..20, 0..6)
    ) {
        // One segment a message; the sender's capture lacks some.
        let (stream, length) = stream(20);
        let course = a_segment_each(0..20, length, 20 * MILLISECOND);
        let connection = Connection { first_sequence: 7, with_clock: true };
        let mut packets = packets(connection, &stream, &course);
        packets.retain(|packet| {
            let index = usize::try_from(packet.at_ns / MILLISECOND / 20 - 1).unwrap();
            packet.host == VirtualHost::STA1 || packet.frame.len() < 100 || !dropped.contains(&index)
        });
        let numbers: Vec<u64> = deliveries(packets).iter().map(|(_, delivery)| delivery.label.seq).collect();
        let kept: Vec<u64> = (1..=20).filter(|seq| !dropped.contains(&(*seq as usize - 1))).collect();
        prop_assert_eq!(numbers, kept);
    }
}

/// Messages that are sent in a segment each, one every `every_ns`, and arrive 20 ms later.
fn a_segment_each(messages: Range<usize>, length: usize, every_ns: i64) -> Vec<Transmission> {
    let segment = |index: usize| {
        let sent_ns = (index as i64 + 1) * every_ns;
        Transmission {
            begin: index * length,
            end: (index + 1) * length,
            sent_ns,
            arrived_ns: Some(sent_ns + 20 * MILLISECOND),
        }
    };
    messages.map(segment).collect()
}

/// Sends states 1 to 3 a segment each; `change` is what happens to them on the way.
fn three(change: impl FnOnce(&mut Vec<Transmission>)) -> Vec<Delivery> {
    let (stream, length) = stream(3);
    let mut course = a_segment_each(0..3, length, 10 * MILLISECOND);
    change(&mut course);
    let connection = Connection {
        first_sequence: u32::MAX - 100,
        with_clock: true,
    };
    let given = deliveries(packets(connection, &stream, &course));
    given.into_iter().map(|(_, delivery)| delivery).collect()
}

fn counts(deliveries: &[Delivery]) -> Vec<(u32, u32, bool)> {
    let count = |it: &Delivery| (it.retransmissions, it.duplicates, it.reordered);
    deliveries.iter().map(count).collect()
}

#[test]
fn a_message_that_arrives_after_a_later_one_is_reordered_and_was_sent_once() {
    let given = three(|course| course[1].arrived_ns = Some(51 * MILLISECOND));
    assert_eq!(counts(&given), [(0, 0, false), (0, 0, true), (0, 0, false)]);
    let in_order: Vec<_> = given
        .iter()
        .map(|it| it.in_order_unix_ns.unwrap() / MILLISECOND)
        .collect();
    assert_eq!(in_order, [30, 51, 51]);
}

#[test]
fn a_lost_message_is_retransmitted_and_not_reordered() {
    let given = three(|course| {
        course[1].arrived_ns = None;
        let again = Transmission {
            sent_ns: 230 * MILLISECOND,
            arrived_ns: Some(250 * MILLISECOND),
            ..course[1].clone()
        };
        course.push(again);
    });
    assert_eq!(counts(&given), [(0, 0, false), (1, 0, false), (0, 0, false)]);
    assert_eq!(
        given[1].wire_in_unix_ns.unwrap() - given[1].wire_out_unix_ns.unwrap(),
        230 * MILLISECOND
    );
}

#[test]
fn a_link_that_loses_before_the_senders_capture_shows_the_second_attempt_as_one() {
    // netem on the sender's own device: what it loses was never on the wire that the capture sees.
    let given = three(|course| {
        let again = Transmission {
            sent_ns: 230 * MILLISECOND,
            arrived_ns: Some(250 * MILLISECOND),
            ..course.remove(0)
        };
        course.push(again);
    });
    assert_eq!(counts(&given), [(1, 0, false), (0, 0, false), (0, 0, false)]);
}

#[test]
fn a_duplicate_that_comes_after_the_acknowledgement_still_counts() {
    let given = three(|course| {
        let again = Transmission {
            sent_ns: 231 * MILLISECOND,
            arrived_ns: Some(900 * MILLISECOND),
            ..course[0].clone()
        };
        course.push(again);
    });
    assert_eq!(counts(&given), [(1, 1, false), (0, 0, false), (0, 0, false)]);
}

#[test]
fn both_directions_of_one_connection_and_two_connections_are_kept_apart() {
    let connection = Connection {
        first_sequence: 1,
        with_clock: true,
    };
    let mut packets = Vec::new();
    let mut pass =
        |topic: Topic, ports: (u16, u16), sequence: u32, acknowledged: u32, at_ms: i64, payload: &[u8]| {
            let frame = connection.frame(topic, ports, sequence, acknowledged, at_ms * MILLISECOND, payload);
            for (host, after_ms) in [(topic.sender(), 0), (topic.receiver(), 20)] {
                packets.push(Seen {
                    at_ns: (at_ms + after_ms) * MILLISECOND,
                    host,
                    frame: frame.clone(),
                });
            }
        };
    let (state, command) = (state(9), command(4));
    pass(Topic::State, (1, 2), 500, 900, 0, &state);
    pass(
        Topic::Command,
        (2, 1),
        900,
        500 + state.len() as u32,
        30,
        &command,
    );
    pass(
        Topic::State,
        (1, 2),
        500 + state.len() as u32,
        900 + command.len() as u32,
        60,
        &[],
    );
    pass(Topic::State, (3, 2), 77, 1, 70, &state);
    let given: Vec<_> = deliveries(packets)
        .into_iter()
        .map(|(ports, it)| (ports.topic, ports.from, it.label.seq))
        .collect();
    assert_eq!(
        given,
        [(Topic::State, 1, 9), (Topic::State, 3, 9), (Topic::Command, 2, 4)]
    );
}

#[test]
fn messages_of_many_connections_are_given_out_in_the_same_order_each_time() {
    let connection = Connection {
        first_sequence: 1,
        with_clock: true,
    };
    let mut packets = Vec::new();
    for port in (1..40).rev() {
        let state = state(9);
        let acknowledged = 1 + state.len() as u32;
        let data = connection.frame(Topic::State, (port, 2), 1, 1, 0, &state);
        let answer = connection.frame(Topic::Command, (2, port), 1, acknowledged, 0, &[]);
        packets.extend([data, answer].map(|frame| Seen {
            at_ns: 0,
            host: VirtualHost::STA2,
            frame,
        }));
    }
    // Long after, all of them are looked for at once.
    packets.push(Seen {
        at_ns: 60_000 * MILLISECOND,
        host: VirtualHost::STA2,
        frame: connection.frame(Topic::State, (100, 2), 1, 1, 0, b"x"),
    });
    let ports: Vec<u16> = deliveries(packets).iter().map(|(ports, _)| ports.from).collect();
    assert_eq!(ports, (1..40).collect::<Vec<_>>());
}

#[test]
fn ports_that_are_used_anew_are_another_connection() {
    let connection = Connection {
        first_sequence: 1,
        with_clock: true,
    };
    let bytes = state(1);
    let mut packets = Vec::new();
    for (round, first) in [(0_i64, 1000_u32), (1, 3_000_000_000)] {
        let open = |frame: &mut Vec<u8>| {
            // The TCP header's flags, behind Ethernet's 14 and IPv4's 20 bytes.
            frame[14 + 20 + 13] |= 0x02;
        };
        let at_ns = round * 1000 * MILLISECOND;
        let mut syn = connection.frame(Topic::State, STATE_PORTS, first, 0, at_ns, &[]);
        open(&mut syn);
        packets.push(Seen {
            at_ns,
            host: VirtualHost::STA2,
            frame: syn,
        });
        let data = connection.frame(Topic::State, STATE_PORTS, first + 1, 1, at_ns, &bytes);
        packets.push(Seen {
            at_ns: at_ns + 1,
            host: VirtualHost::STA2,
            frame: data,
        });
    }
    assert_eq!(deliveries(packets).len(), 2);
}

#[test]
fn a_whole_connection_needs_the_memory_of_what_is_under_way() {
    let (stream, length) = stream(2000);
    let course = a_segment_each(0..2000, length, 20 * MILLISECOND);
    let mut packets = packets(
        Connection {
            first_sequence: 1,
            with_clock: true,
        },
        &stream,
        &course,
    );
    packets.sort_by_key(|packet| packet.at_ns);
    let mut exchange = Exchange::of(Messages::Rates);
    let mut most = 0;
    for Seen { at_ns, host, frame } in &packets {
        let packet = Packet {
            stamp_unix_ns: *at_ns,
            original_bytes: frame.len(),
            bytes: frame,
        };
        exchange.take(*host, &packet, &mut |_, _| ()).unwrap();
        let kept: usize = exchange.flows.values().map(Flow::held_bytes).sum();
        assert_eq!(kept, exchange.held_bytes);
        most = most.max(kept);
    }
    // 40 s of 50 messages a second: 5 s of them wait for duplicates, the rest is gone.
    assert!(most < 300 * 256 + (128 << 10), "{most} bytes");
}

/// States of one connection each, or of a few; all at the same time.
fn take_states(
    count: u32,
    mut of: impl FnMut(u32) -> ((u16, u16), u32),
) -> (u32, Result<(), TooMuch>, Exchange) {
    let connection = Connection {
        first_sequence: 0,
        with_clock: false,
    };
    let mut exchange = Exchange::of(Messages::Rates);
    for number in 0..count {
        let (ports, sequence) = of(number);
        let frame = connection.frame(Topic::State, ports, sequence, 1, 0, b"x");
        let packet = Packet {
            stamp_unix_ns: 0,
            original_bytes: frame.len(),
            bytes: &frame,
        };
        if let Err(too_much) = exchange.take(VirtualHost::STA2, &packet, &mut |_, _| ()) {
            return (number, Err(too_much), exchange);
        }
    }
    (count, Ok(()), exchange)
}

#[test]
fn connections_without_end_are_too_many() {
    let ports = |number: u32| (number as u16, (1 + (number >> 16)) as u16);
    let (followed, outcome, _) = take_states(1 << 18, |number| (ports(number), 1));
    assert_eq!(outcome, Err(TooMuch::Connections));
    assert_eq!(followed, MOST_CONNECTIONS as u32);
}

#[test]
fn a_segment_far_ahead_or_far_behind_takes_no_memory_for_what_is_between() {
    // A thousand connections of two segments each, of which one is 8 MiB before the other.
    let between = |number: u32| ((number as u16 / 2, 1), (1 + number % 2) << 23);
    let (.., exchange) = take_states(2000, between);
    assert!(exchange.held_bytes < 2 << 20, "{} bytes", exchange.held_bytes);
    let (.., exchange) = take_states(200, |number| ((1, 1), u32::MAX - (number << 23)));
    assert!(exchange.held_bytes < 1 << 20, "{} bytes", exchange.held_bytes);
}

#[test]
fn messages_that_all_come_at_once_are_too_many() {
    let (stream, length) = stream(2000);
    let connection = Connection {
        first_sequence: 1,
        with_clock: true,
    };
    let mut exchange = Exchange::of(Messages::Rates);
    let mut take = |host, frame: &[u8]| {
        let packet = Packet {
            stamp_unix_ns: 0,
            original_bytes: frame.len(),
            bytes: frame,
        };
        exchange.take(host, &packet, &mut |_, _| ())
    };
    let mut outcome = Ok(());
    let segments = stream.chunks(200 * length);
    for (number, bytes) in segments.cycle().take(20_000).enumerate() {
        let offset = number * 200 * length;
        outcome = take(VirtualHost::STA2, &connection.data(offset, bytes, 0));
        outcome = outcome.and_then(|()| {
            let acknowledgement = connection.acknowledgement(offset + bytes.len(), 0);
            take(VirtualHost::STA2, &acknowledgement)
        });
        if outcome.is_err() {
            break;
        }
    }
    assert_eq!(outcome, Err(TooMuch::UnderWay));
}

#[test]
fn segments_of_one_connection_that_come_again_among_many_are_found_at_once() {
    let began = std::time::Instant::now();
    let place = |number: u32| match number {
        0..65_000 => number,
        _ => number.wrapping_mul(7919) % 65_000,
    };
    let (_, outcome, _) = take_states(200_000, |number| ((1, 2), 1 + 2 * place(number)));
    assert_eq!(outcome, Ok(()));
    // It takes 2 s without optimisation. To look at each of the others takes minutes.
    assert!(began.elapsed().as_secs() < 20, "{:?}", began.elapsed());
}
