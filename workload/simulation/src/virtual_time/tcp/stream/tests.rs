//! A connection over a way of 20 ms each way that loses what the test names, told as a story of times.

use std::collections::VecDeque;

use rstest::rstest;

use super::*;
use crate::virtual_time::jiffies::DEBIAN_HZ;

const MS: i64 = 1_000_000;
const ONE_WAY_NS: i64 = 20 * MS;

/// What was on the wire, in its order: `Data` by its number, from 0.
struct Wire {
    stream: Stream<usize>,
    data: VecDeque<(i64, Data)>,
    acks: VecDeque<(i64, Ack)>,
    /// Which transmissions are lost, of data and of acknowledgements.
    lost_data: Vec<usize>,
    lost_acks: Vec<usize>,
    sent_data: Vec<(i64, Data)>,
    sent_acks: usize,
    read: Vec<Read<usize>>,
}

impl Wire {
    fn new(nagle: bool, lost_data: &[usize], lost_acks: &[usize]) -> Self {
        let settings = SenderSettings {
            nagle,
            first_round_trip_ns: 2 * ONE_WAY_NS,
            ..SenderSettings::default()
        };
        Self {
            stream: Stream::new(settings, Jiffies::new(DEBIAN_HZ, 0), Reader::at_once()),
            data: VecDeque::new(),
            acks: VecDeque::new(),
            lost_data: lost_data.to_vec(),
            lost_acks: lost_acks.to_vec(),
            sent_data: Vec::new(),
            sent_acks: 0,
            read: Vec::new(),
        }
    }

    /// Messages of 100 bytes every 20 ms from time zero.
    fn run(mut self, messages: usize) -> Self {
        for number in 0..messages {
            let now_ns = i64::try_from(number).unwrap() * 20 * MS;
            self.advance(now_ns);
            self.stream.write(now_ns, number, 100);
            self.put_on_wire(now_ns);
        }
        self.advance(i64::MAX);
        self
    }

    fn advance(&mut self, until_ns: i64) {
        let next_ns = |wire: &Self| {
            let data_ns = wire.data.front().map(|(at_ns, _)| *at_ns);
            let acks_ns = wire.acks.front().map(|(at_ns, _)| *at_ns);
            [data_ns, acks_ns, wire.stream.next_ns()]
                .into_iter()
                .flatten()
                .min()
        };
        while let Some(now_ns) = next_ns(self).filter(|next_ns| *next_ns <= until_ns) {
            while let Some(data) = pop_due(&mut self.data, now_ns) {
                self.stream.receive_data(now_ns, &data);
            }
            while let Some(ack) = pop_due(&mut self.acks, now_ns) {
                self.stream.receive_ack(now_ns, &ack);
            }
            let read = &mut self.read;
            self.stream.advance(now_ns, |message| read.push(message));
            self.put_on_wire(now_ns);
        }
    }

    fn put_on_wire(&mut self, now_ns: i64) {
        while let Some(data) = self.stream.take_data() {
            if !self.lost_data.contains(&self.sent_data.len()) {
                self.data.push_back((now_ns + ONE_WAY_NS, data));
            }
            self.sent_data.push((now_ns, data));
        }
        while let Some(ack) = self.stream.take_ack() {
            if !self.lost_acks.contains(&self.sent_acks) {
                self.acks.push_back((now_ns + ONE_WAY_NS, ack));
            }
            self.sent_acks += 1;
        }
    }

    /// When each segment was sent, in ms, and its bytes.
    fn story(&self) -> Vec<(i64, u64, u64)> {
        self.sent_data
            .iter()
            .map(|(at_ns, data)| (at_ns / MS, data.span.begin, data.span.end))
            .collect()
    }

    fn ages_ms(&self) -> Vec<i64> {
        self.read
            .iter()
            .map(|read| (read.read_ns - read.written_ns) / MS)
            .collect()
    }
}

fn pop_due<P>(under_way: &mut VecDeque<(i64, P)>, now_ns: i64) -> Option<P> {
    let due = under_way.front().is_some_and(|(at_ns, _)| *at_ns <= now_ns);
    due.then(|| under_way.pop_front())
        .flatten()
        .map(|(_, packet)| packet)
}

/// An acknowledgement that comes when a message is written is before it.
#[test]
fn with_nagle_two_messages_go_in_one_segment_each_round_trip() {
    let wire = Wire::new(true, &[], &[]).run(6);
    assert_eq!(
        wire.story(),
        [(0, 0, 100), (40, 100, 200), (80, 200, 400), (120, 400, 600)]
    );
    assert_eq!(wire.ages_ms(), [20, 40, 60, 40, 60, 40]);
}

#[test]
fn without_nagle_each_message_goes_at_once() {
    let wire = Wire::new(false, &[], &[]).run(5);
    assert_eq!(wire.ages_ms(), [20; 5]);
}

/// The probe for one segment alone would wait for 2 · 40 + 200 ms and goes at the timeout of 40 + 200 ms instead, at the
/// next jiffy. It takes what has been waiting. Its selective acknowledgement comes 40 ms later and shows the loss.
#[test]
fn a_lost_segment_alone_is_found_by_a_probe_with_the_waiting_messages() {
    let wire = Wire::new(true, &[0], &[]).run(13);
    assert_eq!(wire.story()[..3], [(0, 0, 100), (244, 100, 1300), (284, 0, 100)]);
    assert_eq!(wire.ages_ms()[..3], [304, 284, 264]);
    let counts = wire.stream.counts();
    assert_eq!(
        (counts.probes, counts.probes_again, counts.fast, counts.timeouts),
        (1, 0, 1, 0)
    );
}

/// The acknowledgement of the first is lost: the probe carries new messages and nothing is sent twice.
#[test]
fn a_lost_acknowledgement_costs_a_probe_and_no_byte_twice() {
    let wire = Wire::new(true, &[], &[0]).run(13);
    assert_eq!(wire.story()[..2], [(0, 0, 100), (244, 100, 1300)]);
    assert_eq!(wire.ages_ms()[..2], [20, 244]);
}

/// The segment and its probe are lost: the timeout begins with the probe, and both go in one segment.
#[test]
fn when_the_probe_is_lost_too_the_timeout_sends_both_as_one() {
    let wire = Wire::new(true, &[0, 1], &[]).run(13);
    assert_eq!(wire.story()[2], (488, 0, 1300));
    assert_eq!(wire.stream.counts().timeouts, 1);
    assert_eq!(wire.ages_ms()[0], 508);
}

/// The second's acknowledgement comes at 60 ms. The first should have been acknowledged at 40, with a quarter of a round trip
/// for reordering at 50: it goes again at once. PRR lets one segment go for each that was delivered, so that the next
/// messages wait for 20 ms.
#[test]
fn without_nagle_the_next_messages_show_the_loss() {
    let wire = Wire::new(false, &[0], &[]).run(5);
    let again: Vec<_> = wire
        .story()
        .into_iter()
        .filter(|(_, begin, _)| *begin == 0)
        .collect();
    assert_eq!(again.len(), 2);
    assert_eq!(again[1].0, 60);
    assert_eq!(wire.ages_ms(), [80, 60, 40, 40, 40]);
}

/// Two segments are out at the end: the probe comes after two round trips and 2 ms, with the last of them again.
#[test]
fn a_lost_tail_of_two_is_found_after_two_round_trips() {
    let wire = Wire::new(false, &[1, 2], &[]).run(3);
    let story = wire.story();
    // 40 + 2 · 40 + 2 ms are 31 jiffies and a half, and the timer fires at the second jiffy after.
    assert_eq!(story[3], (128, 200, 300));
    assert_eq!(story[4].1, 100);
    assert_eq!(wire.read.len(), 3);
}

#[rstest]
#[case::doubled_each_time(&[0, 1, 2, 3], &[244, 488, 968])]
fn timeouts_in_a_row_wait_twice_as_long_each(#[case] lost: &[usize], #[case] at_ms: &[i64]) {
    let wire = Wire::new(true, lost, &[]).run(1);
    let sent: Vec<i64> = wire.story()[1..].iter().map(|(at_ms, ..)| *at_ms).collect();
    assert!(sent[0] == at_ms[0] && sent[1] == at_ms[1], "{sent:?}");
    // Beyond 252 ms the wheel counts in 32 ms.
    assert!((at_ms[2]..at_ms[2] + 36).contains(&sent[2]), "{sent:?}");
    assert_eq!(wire.read.len(), 1);
}

#[test]
fn recoveries_leave_a_window_of_two_or_three_to_who_does_not_fill_more() {
    let wire = Wire::new(false, &[10, 60, 110, 160, 210], &[]).run(300);
    assert_eq!(wire.stream.counts().fast, 5);
    let window = wire.stream.sender.congestion.window;
    assert!((2..=3).contains(&window), "{window}");
}
