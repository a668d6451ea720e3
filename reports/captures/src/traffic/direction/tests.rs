//! Packets whose course is known, against what is made of them.

use proptest::prelude::*;

use super::*;

const MILLISECOND: i64 = 1_000_000;
const PORTS: (u16, u16) = (41_000, 42_000);

/// A state of 100 bytes, the number-th of its connection; `identification` counts what the host sends.
fn state(number: u32, identification: u16) -> Segment<'static> {
    Segment {
        source: (address_in_the_ball(Topic::State.sender()), PORTS.0).into_addr(),
        destination: (address_in_the_ball(Topic::State.receiver()), PORTS.1).into_addr(),
        identification,
        sequence: number * 100,
        acknowledged: Some(1),
        opens: false,
        sent_clock: Some(u32::from(identification) * 20),
        payload_bytes: 100,
        payload: &[],
    }
}

/// What acknowledges the states before the number-th.
fn acknowledgement(number: u32) -> Segment<'static> {
    Segment {
        source: (address_in_the_ball(Topic::Command.sender()), PORTS.1).into_addr(),
        destination: (address_in_the_ball(Topic::Command.receiver()), PORTS.0).into_addr(),
        acknowledged: Some(number * 100),
        payload_bytes: 0,
        sent_clock: None,
        ..state(0, 0)
    }
}

trait IntoAddress {
    fn into_addr(self) -> std::net::SocketAddrV4;
}

impl IntoAddress for (std::net::Ipv4Addr, u16) {
    fn into_addr(self) -> std::net::SocketAddrV4 {
        std::net::SocketAddrV4::new(self.0, self.1)
    }
}

/// Segments seen at hosts, in the order of their stamps, in milliseconds.
fn passings(seen: &[(i64, VirtualHost, Segment<'_>)]) -> Vec<(Topic, Passing)> {
    let mut directions = Directions::default();
    let mut found = Vec::new();
    let mut out = |topic, passing| found.push((topic, passing));
    for (at_ms, host, segment) in seen {
        directions
            .take(*host, segment, at_ms * MILLISECOND, &mut out)
            .unwrap();
    }
    directions.finish(&mut out);
    found
}

fn arrivals(found: &[(Topic, Passing)]) -> Vec<(i64, bool)> {
    let arrivals = found.iter().filter_map(|(_, passing)| match passing {
        Passing::Arrived {
            one_way_ns,
            is_reordered,
            ..
        } => Some((one_way_ns / MILLISECOND, *is_reordered)),
        _ => None,
    });
    arrivals.collect()
}

const SENDER: VirtualHost = Topic::State.sender();
const RECEIVER: VirtualHost = Topic::State.receiver();

#[test]
fn a_packet_is_found_where_it_arrives_and_its_acknowledgement_where_it_was_sent() {
    let found = passings(&[
        (0, SENDER, state(1, 1)),
        (11, RECEIVER, state(1, 1)),
        (12, RECEIVER, acknowledgement(2)),
        (20, SENDER, state(2, 2)),
        (22, SENDER, acknowledgement(2)),
        (34, RECEIVER, state(2, 2)),
    ]);
    let ms = |ms: i64| ms * MILLISECOND;
    let expected = [
        Passing::Sent {
            at_unix_ns: 0,
            is_retransmitted: false,
        },
        Passing::Arrived {
            sent_unix_ns: 0,
            one_way_ns: ms(11),
            is_reordered: false,
            jitter_ns: None,
            gap_ns: None,
        },
        Passing::Sent {
            at_unix_ns: ms(20),
            is_retransmitted: false,
        },
        Passing::Acknowledged {
            sent_unix_ns: 0,
            took_ns: ms(22),
        },
        Passing::Arrived {
            sent_unix_ns: ms(20),
            one_way_ns: ms(14),
            is_reordered: false,
            jitter_ns: Some(ms(3)),
            gap_ns: Some(ms(23)),
        },
    ];
    assert_eq!(found, expected.map(|passing| (Topic::State, passing)));
}

#[test]
fn a_retransmitted_packet_is_a_packet_of_its_own() {
    let found = passings(&[
        (0, SENDER, state(1, 1)),
        (20, SENDER, state(2, 2)),
        (31, RECEIVER, state(2, 2)),
        (240, SENDER, state(1, 3)),
        (252, RECEIVER, state(1, 3)),
        (9_000, SENDER, state(4, 4)),
        (9_010, RECEIVER, state(4, 4)),
    ]);
    assert_eq!(arrivals(&found), [(11, false), (12, false), (10, false)]);
    let retransmitted = Passing::Sent {
        at_unix_ns: 240 * MILLISECOND,
        is_retransmitted: true,
    };
    assert!(found.contains(&(Topic::State, retransmitted)), "{found:?}");
    assert!(
        found.contains(&(Topic::State, Passing::Lost { sent_unix_ns: 0 })),
        "{found:?}"
    );
}

#[test]
fn one_that_arrives_after_a_later_one_is_reordered() {
    let found = passings(&[
        (0, SENDER, state(1, 1)),
        (1, SENDER, state(2, 2)),
        (10, RECEIVER, state(2, 2)),
        (12, RECEIVER, state(1, 1)),
    ]);
    assert_eq!(arrivals(&found), [(9, false), (12, true)]);
}

#[test]
fn what_may_be_under_way_when_the_captures_end_is_not_lost() {
    let sent: Vec<_> = [0, 500, 1_600]
        .map(|at_ms| (at_ms, SENDER, state(at_ms as u32 + 1, 1)))
        .into();
    let lost: Vec<_> = passings(&sent)
        .into_iter()
        .filter_map(|(_, passing)| match passing {
            Passing::Lost { sent_unix_ns } => Some(sent_unix_ns / MILLISECOND),
            _ => None,
        })
        .collect();
    assert_eq!(lost, [0, 500]);
}

#[test]
fn one_that_nobody_saw_leave_is_a_stray() {
    let found = passings(&[(5, RECEIVER, state(1, 1))]);
    let stray = Passing::Stray {
        at_unix_ns: 5 * MILLISECOND,
    };
    assert_eq!(found, [(Topic::State, stray)]);
}

#[test]
fn packets_of_others_are_none_of_it() {
    let mut other = state(1, 1);
    other.source = (address_in_the_ball(VirtualHost::H1), 11_311).into_addr();
    assert_eq!(passings(&[(0, VirtualHost::H1, other), (9, RECEIVER, other)]), []);
}

#[test]
fn memory_is_that_of_what_is_under_way_however_long_the_captures_are() {
    let mut directions = Directions::default();
    let mut ignore = |_, _| ();
    for number in 0..100_000_u32 {
        let at_ns = i64::from(number) * 20 * MILLISECOND;
        let packet = state(number, number as u16);
        directions.take(SENDER, &packet, at_ns, &mut ignore).unwrap();
        // Every hundredth is lost.
        if number % 100 > 0 {
            directions
                .take(RECEIVER, &packet, at_ns + 10 * MILLISECOND, &mut ignore)
                .unwrap();
        }
        directions
            .take(
                SENDER,
                &acknowledgement(number),
                at_ns + 15 * MILLISECOND,
                &mut ignore,
            )
            .unwrap();
    }
    let [direction, _] = &directions.directions;
    // Those of the longest way: 5 s at 50 a second, of which two are lost.
    assert_eq!((direction.departures.len(), direction.under_way.len()), (251, 2));
    assert_eq!(
        (direction.connections.followed.len(), direction.connections.kept),
        (1, 1)
    );
}

/// A state of the connection from the number-th of all pairs of ports.
fn state_of(number: u32) -> Segment<'static> {
    let ports = [number % 60_000 + 1, number / 60_000 + 1].map(|port| port as u16);
    let mut state = state(1, 1);
    state.source.set_port(ports[0]);
    state.destination.set_port(ports[1]);
    state
}

#[test]
fn connections_without_end_are_too_many() {
    let mut directions = Directions::default();
    let followed = (0..MOST_CONNECTIONS as u32)
        .map(|number| directions.take(SENDER, &state_of(number), 0, &mut |_, _| ()));
    let outcomes: Vec<_> = followed.collect();
    let most = MOST_CONNECTIONS / 2;
    assert!(outcomes[..most].iter().all(Result::is_ok));
    assert_eq!(outcomes[most], Err(TooMuch::Connections));
}

#[test]
fn connections_that_have_gone_silent_make_room_for_others() {
    let mut directions = Directions::default();
    for number in 0..3 * MOST_CONNECTIONS as u32 {
        // 20 a second: 20 000 are not silent.
        let at_ns = i64::from(number) * 50 * MILLISECOND;
        directions
            .take(SENDER, &state_of(number), at_ns, &mut |_, _| ())
            .unwrap();
    }
    assert!(directions.directions[0].connections.followed.len() <= MOST_CONNECTIONS / 2);
}

#[test]
fn segments_that_nobody_acknowledges_are_too_many_in_many_connections() {
    let mut directions = Directions::default();
    let mut send = || {
        for sequence in 0..1 << 12 {
            for connection in 0..1 << 10 {
                let segment = Segment {
                    sequence: sequence * 100,
                    ..state_of(connection)
                };
                directions.take(SENDER, &segment, 0, &mut |_, _| ())?;
            }
        }
        Ok(())
    };
    assert_eq!(send(), Err(TooMuch::UnderWay));
    let kept = directions.directions[0].connections.kept;
    assert_eq!(kept, MOST_KEPT + 1);
}

proptest! {
    /// Each packet has a delay or is lost, as drawn; whatever the order of arrival that comes of it, each is found, once.
    #[test]
    fn every_packet_is_lost_or_has_the_delay_that_it_had(
        fates in prop::collection::vec(prop::option::weighted(0.9, 1_i64..200), 1..300)
    ) {
        let mut seen = Vec::new();
        for (number, fate) in (1_u32..).zip(&fates) {
            let sent_ms = i64::from(number) * 20;
            seen.push((sent_ms, SENDER, state(number, number as u16)));
            seen.extend(fate.map(|delay_ms| (sent_ms + delay_ms, RECEIVER, state(number, number as u16))));
        }
        seen.sort_by_key(|(at_ms, ..)| *at_ms);
        // Long after, so that nothing can be under way.
        seen.push((1_000_000, SENDER, state(60_000, 0)));
        let found = passings(&seen);
        let mut delays: Vec<i64> = arrivals(&found).into_iter().map(|(delay, _)| delay).collect();
        let mut expected: Vec<i64> = fates.iter().flatten().copied().collect();
        delays.sort_unstable();
        expected.sort_unstable();
        prop_assert_eq!(delays, expected);
        let lost = found.iter().filter(|(_, passing)| matches!(passing, Passing::Lost { .. })).count();
        prop_assert_eq!(lost, fates.iter().filter(|fate| fate.is_none()).count());
    }
}
