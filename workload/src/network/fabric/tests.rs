use record::{
    quantity::{BitRate, Fraction, TimeSpan},
    settings::NetworkSettings,
    topology::{Link, mac},
};
use serde_json::json;

use super::*;

const H1: usize = 0;
const STA1: usize = 1;
const STA2: usize = 2;

const MS: u64 = 1_000_000;

/// Two passes of 10 ms and no chance.
fn steady() -> Link {
    Link {
        delay: TimeSpan::from_millis(10),
        jitter: TimeSpan::from_millis(0),
        loss: Fraction::from_percent(0.0),
        bandwidth: BitRate::from_mbit(10),
        limit_packets: 1000,
    }
}

/// Remembers what came where and when it was due; it comes so much later than due, as a busy machine would have it.
#[derive(Default)]
struct Inbox {
    late_ns: u64,
    full: bool,
    frames: Vec<(usize, u64, u8)>,
}

impl Delivery for Inbox {
    fn deliver(&mut self, host: usize, due_ns: u64, frame: &[u8]) -> Option<u64> {
        if self.full {
            return None;
        }
        self.frames.push((host, due_ns, frame[14]));
        Some(due_ns + self.late_ns)
    }
}

fn frame(from: usize, to: [u8; 6], mark: u8) -> Vec<u8> {
    [&to[..], &mac(from)[..], &[8, 0, mark]].concat()
}

/// The three hosts at their switch, not impaired yet.
fn unimpaired(link: Link, seed: u64) -> Fabric {
    let network = NetworkSettings {
        delay: link.delay,
        jitter: link.jitter,
        loss: link.loss,
        bandwidth: link.bandwidth,
        limit_packets: link.limit_packets,
        ..NetworkSettings::default()
    };
    Fabric::new(&network.topology(), seed)
}

fn star(link: Link, seed: u64) -> Fabric {
    let mut fabric = unimpaired(link, seed);
    fabric.impair();
    fabric
}

fn links<const N: usize>(fabric: &Fabric) -> [LinkRecord; N] {
    let mut links = Vec::new();
    fabric.record_links(&mut links);
    links.try_into().unwrap()
}

fn advance(star: &mut Fabric, now_ns: u64) -> Vec<(usize, u64, u8)> {
    let mut inbox = Inbox::default();
    star.advance(now_ns, &mut inbox);
    inbox.frames
}

/// A star whose switch knows all three hosts, quiet from 1 s on.
fn acquainted(link: Link) -> Fabric {
    acquaint(star(link, 7))
}

fn acquaint(mut fabric: Fabric) -> Fabric {
    for host in [H1, STA1, STA2] {
        fabric.switches[0]
            .switch
            .forward(2 * host + 1, &frame(host, [0xff; 6], 0));
    }
    fabric
}

#[test]
fn a_frame_takes_two_passes_to_the_host_that_it_is_for() {
    let mut star = acquainted(steady());
    star.send(1000 * MS, STA1, &frame(STA1, mac(STA2), 1));
    assert_eq!(star.next_due_ns(), Some(1010 * MS));
    assert_eq!(advance(&mut star, 1020 * MS - 1), vec![]);
    assert_eq!(advance(&mut star, 1020 * MS), vec![(STA2, 1020 * MS, 1)]);
    assert_eq!(star.next_due_ns(), None);
}

#[test]
fn coming_to_look_late_does_not_delay_what_follows() {
    let mut star = acquainted(steady());
    star.send(1000 * MS, STA1, &frame(STA1, mac(STA2), 1));
    assert_eq!(advance(&mut star, 1013 * MS), vec![]);
    assert_eq!(advance(&mut star, 1050 * MS), vec![(STA2, 1020 * MS, 1)]);
    let [_, sta1, _] = links(&star);
    assert_eq!(sta1.up.lateness_max_of_run_ns, Some(3 * MS));
}

#[test]
fn a_broadcast_reaches_both_others() {
    let mut star = star(steady(), 7);
    star.send(0, STA1, &frame(STA1, [0xff; 6], 9));
    assert_eq!(
        advance(&mut star, 100 * MS),
        vec![(H1, 20 * MS, 9), (STA2, 20 * MS, 9)]
    );
}

#[test]
fn two_senders_share_the_receivers_link() {
    let mut star = acquainted(steady());
    let long = |from: usize| [frame(from, mac(STA2), from as u8), vec![0; 1499]].concat();
    for _ in 0..50 {
        star.send(0, H1, &long(H1));
        star.send(0, STA1, &long(STA1));
    }
    let frames = advance(&mut star, u64::MAX);
    let passed_s = (frames[99].1 - frames[0].1) as f64 / 1e9;
    let rate = 100.0 * 1514.0 * 8.0 / passed_s;
    assert_eq!(frames.len(), 100);
    assert!(
        (rate / 10e6 - 1.0).abs() < 0.03,
        "{rate} bit/s through a link of 10 Mbit/s"
    );
}

/// What is told of a pass that nothing went through.
const IDLE: PassRecord = PassRecord {
    offered: 0,
    lost: 0,
    overflowed: Some(0),
    delivered: 0,
    lateness_mean_ns: Some(0.0),
    lateness_max_of_run_ns: Some(0),
};

#[test]
fn everything_is_counted_where_it_happens() {
    let mut star = acquainted(Link {
        loss: Fraction::from_percent(10.0),
        limit_packets: 5,
        ..steady()
    });
    for number in 0..1000 {
        star.send(number * MS, STA1, &frame(STA1, mac(STA2), 1));
        let mut inbox = Inbox {
            late_ns: 500,
            ..Inbox::default()
        };
        star.advance(number * MS, &mut inbox);
    }
    let mut inbox = Inbox {
        late_ns: 500,
        ..Inbox::default()
    };
    star.advance(u64::MAX, &mut inbox);
    let [h1, sta1, sta2] = links(&star);
    assert_eq!((h1.up, h1.down), (IDLE, IDLE));
    assert_eq!((sta1.up.offered, sta1.down), (1000, IDLE));
    assert_eq!(sta2.down.offered, sta1.up.delivered);
    for pass in [sta1.up, sta2.down] {
        assert_eq!(
            pass.offered,
            pass.lost + pass.overflowed.unwrap() + pass.delivered
        );
        assert!(pass.lost > 0);
    }
    assert!(
        sta1.up.overflowed > Some(0),
        "ten packets at once want to wait where five may"
    );
    assert_eq!(
        (sta2.down.lateness_mean_ns, sta2.down.lateness_max_of_run_ns),
        (Some(500.0), Some(500))
    );
}

#[test]
fn a_frame_that_the_host_has_no_room_for_is_not_delivered() {
    let mut star = acquainted(steady());
    star.send(0, STA1, &frame(STA1, mac(STA2), 1));
    star.advance(
        u64::MAX,
        &mut Inbox {
            full: true,
            ..Inbox::default()
        },
    );
    let [_, _, sta2] = links(&star);
    let down = sta2.down;
    assert_eq!((down.offered, down.overflowed, down.delivered), (1, Some(1), 0));
}

#[test]
fn the_same_seed_gives_the_same_run_and_another_seed_another() {
    let link = Link {
        jitter: TimeSpan::from_millis(1),
        loss: Fraction::from_percent(10.0),
        ..steady()
    };
    let run = |seed| {
        let mut star = star(link, seed);
        for number in 0..100 {
            star.send(number * MS, STA1, &frame(STA1, mac(STA2), number as u8));
        }
        advance(&mut star, u64::MAX)
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn no_end_of_a_link_draws_the_same_as_another() {
    let link = Link {
        loss: Fraction::from_percent(50.0),
        ..steady()
    };
    let mut draws: Vec<Vec<bool>> = star(link, 0)
        .passes
        .into_iter()
        .map(|mut pass| (0..64).map(|_| pass.offer(0, vec![0; 60]).is_some()).collect())
        .collect();
    draws.sort();
    draws.dedup();
    assert_eq!(draws.len(), 6);
}

#[test]
fn the_pool_gets_every_buffer_back() {
    let link = Link {
        loss: Fraction::from_percent(20.0),
        limit_packets: 20,
        ..steady()
    };
    let mut star = star(link, 7);
    for round in 0..200 {
        let now_ns = round * 100 * MS;
        for mark in 0..50 {
            star.send(now_ns, H1, &frame(H1, [0xff; 6], mark));
            star.send(now_ns, STA1, &frame(STA1, mac(STA2), mark));
            star.send(now_ns, STA2, &[1, 2, 3]);
        }
        advance(&mut star, now_ns + 99 * MS);
    }
    assert_eq!(star.pool.len(), POOL_FRAMES);
}

#[test]
fn an_impairment_put_on_later_draws_what_it_would_have_drawn_from_the_start() {
    let lossy = Link {
        loss: Fraction::from_percent(50.0),
        jitter: TimeSpan::from_millis(1),
        ..steady()
    };
    let carried = |mut star: Fabric| {
        for mark in 0..200 {
            star.send(
                (1000 + 5 * u64::from(mark)) * MS,
                STA1,
                &frame(STA1, mac(STA2), mark),
            );
        }
        advance(&mut star, u64::MAX)
    };
    let mut star = acquaint(unimpaired(lossy, 7));
    star.send(MS, STA2, &frame(STA2, mac(STA1), 0));
    assert_eq!(advance(&mut star, MS), vec![(STA1, MS, 0)]);
    star.impair();
    assert_eq!(carried(star), carried(acquainted(lossy)));
}

#[test]
fn how_late_each_pass_was_is_counted_over_all_of_them() {
    let mut star = acquainted(steady());
    let began = star.release_lateness().counts();
    star.send(1000 * MS, STA1, &frame(STA1, mac(STA2), 1));
    let mut inbox = Inbox {
        late_ns: 50,
        ..Inbox::default()
    };
    // The first pass was due at 1010 ms and the driver comes 30 ns late, the second ends 50 ns after it was due.
    star.advance(1010 * MS + 30, &mut inbox);
    star.advance(1020 * MS, &mut inbox);
    let releases = star.release_lateness().counts().since(&began);
    assert_eq!(
        (
            releases.released,
            releases.lateness_mean_ns,
            releases.lateness_max_ns
        ),
        (2, 40.0, 50)
    );
}

/// robot at s3, base at s1; s3 behind s2 behind s1.
fn chain() -> Fabric {
    let network: NetworkSettings = serde_json::from_value(json!({
        "delay": "10ms", "jitter": "0ms", "loss": "0%", "bandwidth": "1000Mbit",
        "hosts": {"robot": {"switch": "s3", "delay": "1ms"}, "base": {}, "other": {"switch": "s2"}},
        "switches": {"s1": {}, "s2": {"delay": "2ms"}, "s3": {"switch": "s2", "delay": "4ms"}},
    }))
    .unwrap();
    let mut fabric = Fabric::new(&network.topology(), 7);
    fabric.impair();
    fabric
}

#[test]
fn a_frame_passes_each_link_on_its_way_with_what_that_link_does() {
    let mut chain = chain();
    let [robot, base, other] = [0, 1, 2];
    // Of an unknown address: every other host hears it.
    chain.send(0, robot, &frame(robot, mac(base), 1));
    let heard: Vec<(usize, u64)> = advance(&mut chain, 100 * MS)
        .iter()
        .map(|it| (it.0, it.1 / MS))
        .collect();
    assert_eq!(heard, [(other, 1 + 4 + 10), (base, 1 + 4 + 2 + 10)]);
    // The way back is known to all switches.
    chain.send(100 * MS, base, &frame(base, mac(robot), 2));
    let heard = advance(&mut chain, 200 * MS);
    assert_eq!(
        heard.iter().map(|it| (it.0, it.1 / MS)).collect::<Vec<_>>(),
        [(robot, 117)]
    );
    let [of_robot, _, of_other, s2, s3] = links(&chain);
    assert_eq!((s2.host.name(), s2.up.delivered, s2.down.delivered), ("s2", 1, 1));
    assert_eq!((s3.host.name(), s3.up.delivered, s3.down.delivered), ("s3", 1, 1));
    assert_eq!((of_robot.down.delivered, of_other.down.delivered), (1, 1));
}
