use VirtualHost::{H1, Sta1, Sta2};

use super::*;

const MS: u64 = 1_000_000;

/// Two passes of 10 ms and no chance.
const STEADY: Impairment = Impairment {
    delay_ns: 10 * MS,
    jitter_ns: 0,
    loss: 0.0,
    bits_per_second: 10_000_000,
    limit: 1000,
};

/// Remembers what came where and when it was due; it comes so much later than due, as a busy machine would have it.
#[derive(Default)]
struct Inbox {
    late_ns: u64,
    full: bool,
    frames: Vec<(VirtualHost, u64, u8)>,
}

impl Delivery for Inbox {
    fn deliver(&mut self, host: VirtualHost, due_ns: u64, frame: &[u8]) -> Option<u64> {
        if self.full {
            return None;
        }
        self.frames.push((host, due_ns, frame[14]));
        Some(due_ns + self.late_ns)
    }
}

fn frame(from: VirtualHost, to: [u8; 6], mark: u8) -> Vec<u8> {
    [&to[..], &from.mac()[..], &[8, 0, mark]].concat()
}

fn advance(star: &mut Star, now_ns: u64) -> Vec<(VirtualHost, u64, u8)> {
    let mut inbox = Inbox::default();
    star.advance(now_ns, &mut inbox);
    inbox.frames
}

/// A star whose switch knows all three hosts, quiet from 1 s on.
fn acquainted(impairment: Impairment) -> Star {
    let mut star = Star::new(impairment, 7);
    for host in VirtualHost::ALL {
        star.switch.forward(host, &frame(host, [0xff; 6], 0));
    }
    star
}

#[test]
fn a_frame_takes_two_passes_to_the_host_that_it_is_for() {
    let mut star = acquainted(STEADY);
    star.send(1000 * MS, Sta1, &frame(Sta1, Sta2.mac(), 1));
    assert_eq!(star.next_due_ns(), Some(1010 * MS));
    assert_eq!(advance(&mut star, 1020 * MS - 1), vec![]);
    assert_eq!(advance(&mut star, 1020 * MS), vec![(Sta2, 1020 * MS, 1)]);
    assert_eq!(star.next_due_ns(), None);
}

#[test]
fn coming_to_look_late_does_not_delay_what_follows() {
    let mut star = acquainted(STEADY);
    star.send(1000 * MS, Sta1, &frame(Sta1, Sta2.mac(), 1));
    assert_eq!(advance(&mut star, 1013 * MS), vec![]);
    assert_eq!(advance(&mut star, 1050 * MS), vec![(Sta2, 1020 * MS, 1)]);
    let sta1 = &star.links()[Sta1.index()];
    assert_eq!(sta1.up.lateness_max_of_run_ns, Some(3 * MS));
}

#[test]
fn a_broadcast_reaches_both_others() {
    let mut star = Star::new(STEADY, 7);
    star.send(0, Sta1, &frame(Sta1, [0xff; 6], 9));
    assert_eq!(
        advance(&mut star, 100 * MS),
        vec![(H1, 20 * MS, 9), (Sta2, 20 * MS, 9)]
    );
}

#[test]
fn two_senders_share_the_receivers_link() {
    let mut star = acquainted(STEADY);
    let long = |from: VirtualHost| [frame(from, Sta2.mac(), from as u8), vec![0; 1499]].concat();
    for _ in 0..50 {
        star.send(0, H1, &long(H1));
        star.send(0, Sta1, &long(Sta1));
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
    let mut star = acquainted(Impairment {
        loss: 0.1,
        limit: 5,
        ..STEADY
    });
    for number in 0..1000 {
        star.send(number * MS, Sta1, &frame(Sta1, Sta2.mac(), 1));
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
    let [h1, sta1, sta2] = star.links();
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
    let mut star = acquainted(STEADY);
    star.send(0, Sta1, &frame(Sta1, Sta2.mac(), 1));
    star.advance(
        u64::MAX,
        &mut Inbox {
            full: true,
            ..Inbox::default()
        },
    );
    let down = star.links()[Sta2.index()].down;
    assert_eq!((down.offered, down.overflowed, down.delivered), (1, Some(1), 0));
}

#[test]
fn the_same_seed_gives_the_same_run_and_another_seed_another() {
    let impairment = Impairment {
        jitter_ns: MS,
        loss: 0.1,
        ..STEADY
    };
    let run = |seed| {
        let mut star = Star::new(impairment, seed);
        for number in 0..100 {
            star.send(number * MS, Sta1, &frame(Sta1, Sta2.mac(), number as u8));
        }
        advance(&mut star, u64::MAX)
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn no_end_of_a_link_draws_the_same_as_another() {
    let star = Star::new(Impairment { loss: 0.5, ..STEADY }, 0);
    let mut draws: Vec<Vec<bool>> = star
        .up
        .into_iter()
        .chain(star.down)
        .map(|mut pass| (0..64).map(|_| pass.offer(0, vec![0; 60]).is_some()).collect())
        .collect();
    draws.sort();
    draws.dedup();
    assert_eq!(draws.len(), 6);
}

#[test]
fn the_pool_gets_every_buffer_back() {
    let mut star = Star::new(
        Impairment {
            loss: 0.2,
            limit: 20,
            ..STEADY
        },
        7,
    );
    for round in 0..200 {
        let now_ns = round * 100 * MS;
        for mark in 0..50 {
            star.send(now_ns, H1, &frame(H1, [0xff; 6], mark));
            star.send(now_ns, Sta1, &frame(Sta1, Sta2.mac(), mark));
            star.send(now_ns, Sta2, &[1, 2, 3]);
        }
        advance(&mut star, now_ns + 99 * MS);
    }
    assert_eq!(star.pool.len(), POOL_FRAMES);
}

#[test]
fn an_impairment_put_on_later_draws_what_it_would_have_drawn_from_the_start() {
    let lossy = Impairment {
        loss: 0.5,
        jitter_ns: MS,
        ..STEADY
    };
    let carried = |mut star: Star| {
        for mark in 0..200 {
            star.send(
                (1000 + 5 * u64::from(mark)) * MS,
                Sta1,
                &frame(Sta1, Sta2.mac(), mark),
            );
        }
        advance(&mut star, u64::MAX)
    };
    let mut star = acquainted(Impairment::NONE);
    star.send(MS, Sta2, &frame(Sta2, Sta1.mac(), 0));
    assert_eq!(advance(&mut star, MS), vec![(Sta1, MS, 0)]);
    star.impair(lossy);
    assert_eq!(carried(star), carried(acquainted(lossy)));
}

#[test]
fn how_late_each_pass_was_is_counted_over_all_of_them() {
    let mut star = acquainted(STEADY);
    let began = star.release_lateness().counts();
    star.send(1000 * MS, Sta1, &frame(Sta1, Sta2.mac(), 1));
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
