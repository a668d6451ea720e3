use proptest::prelude::*;

use super::*;

const MS: i64 = 1_000_000;
const SECOND: i64 = 1_000 * MS;

/// A message a tick each way, then what is left; what was read, in order.
fn run(conditions: &Conditions, seed: u64, messages: i64, every_ns: i64, bytes: u64) -> Vec<Delivery<i64>> {
    let mut exchange = Exchange::new(conditions, seed);
    let mut read = Vec::new();
    for number in 0..messages {
        while let Some(delivery) = exchange.advance(number * every_ns) {
            read.push(delivery);
        }
        for peer in Peer::ALL {
            exchange.send(number * every_ns, peer, number, bytes);
        }
    }
    while let Some(delivery) = exchange.advance(i64::MAX) {
        read.push(delivery);
    }
    assert_eq!(exchange.next_ns(), None, "all is acknowledged");
    read
}

fn conditions(loss: f64, nagle: bool) -> Conditions {
    let impairment = Impairment {
        loss,
        ..Impairment::from(&NetworkSettings::default().link())
    };
    Conditions {
        impairment,
        nagle,
        stack_ns: 0,
        reading: Quantiles::default(),
    }
}

fn ages_ms(read: &[Delivery<i64>]) -> Vec<f64> {
    let mut ages: Vec<f64> = read
        .iter()
        .map(|delivery| (delivery.at_ns - delivery.sent_ns) as f64 / MS as f64)
        .collect();
    ages.sort_by(f64::total_cmp);
    ages
}

#[test]
fn without_losses_and_nagle_a_message_is_as_old_as_the_links_make_it() {
    let ages = ages_ms(&run(&conditions(0.0, false), 1, 2000, 20 * MS, 66));
    assert!(ages[0] > 18.0 && ages[ages.len() - 1] < 22.3, "{ages:?}");
    let mean = ages.iter().sum::<f64>() / ages.len() as f64;
    // Two link ends of 10 ms, and 0.1 ms for 132 bytes at 10 Mbit/s are within the bucket.
    assert!((mean - 20.0).abs() < 0.1, "{mean}");
}

/// One small message is under way at a time: of those that come every 20 ms, two wait for a round trip of 40 ms.
#[test]
fn with_nagle_a_message_waits_for_the_acknowledgement_of_the_one_before() {
    let ages = ages_ms(&run(&conditions(0.0, true), 1, 2000, 20 * MS, 66));
    let mean = ages.iter().sum::<f64>() / ages.len() as f64;
    assert!((38.0..52.0).contains(&mean), "{mean}");
    assert!(ages[ages.len() - 1] < 65.0);
}

#[test]
fn a_message_alone_that_is_lost_comes_after_the_timeout_of_a_round_trip_and_200_ms() {
    let mut fates = [0; 2];
    for seed in 0..200 {
        let read = run(&conditions(0.1, true), seed, 1, SECOND, 66);
        for delivery in read {
            let age_ms = (delivery.at_ns - delivery.sent_ns) / MS;
            match age_ms {
                18..=22 => fates[0] += 1,
                // 240 ms and a jiffy, and the way.
                258..=268 => fates[1] += 1,
                // Lost twice: a probe, then a timeout.
                400.. => {}
                _ => panic!("{age_ms} ms"),
            }
        }
    }
    assert!(fates[0] > 280 && fates[1] > 40, "{fates:?}");
}

#[test]
fn a_lost_message_among_others_comes_once_later_ones_were_acknowledged() {
    let ages = ages_ms(&run(&conditions(0.01, false), 3, 20_000, 20 * MS, 66));
    let share = |from_ms: f64, to_ms: f64| {
        ages.iter().filter(|age| (from_ms..to_ms).contains(age)).count() as f64 / ages.len() as f64
    };
    // The next was sent 20 ms later and is acknowledged 60 ms after the lost one was sent; that goes again and takes
    // 20 ms: 76 to 84 ms, unless its turn or the acknowledgement is lost too.
    assert!(
        (0.016..0.022).contains(&share(76.0, 85.0)),
        "{}",
        share(76.0, 85.0)
    );
    // Those behind it wait for it, and for the window.
    assert!(share(22.3, 76.0) > 0.05, "{}", share(22.3, 76.0));
    assert!(share(85.0, 1e9) < 0.01, "{}", share(85.0, 1e9));
}

prop_compose! {
    fn any_conditions()(
        delay_ns in 0_u64..50_000_000,
        jitter_share in 0.0..1.0_f64,
        loss in 0.0..0.2_f64,
        bits_per_second in 60_000_u64..10_000_000,
        limit in 3_usize..1000,
        nagle: bool,
        stack_ns in 0..500_000_i64,
        reads_after_us in prop_oneof![Just(0), 0..100_000_u64],
    ) -> Conditions {
        let jitter_ns = (delay_ns as f64 * jitter_share) as u64;
        let impairment = Impairment { delay_ns, jitter_ns, loss, bits_per_second, limit };
        let reading = Quantiles::always(Duration::from_micros(reads_after_us).into());
        Conditions { impairment, nagle, stack_ns, reading }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_message_is_lost_doubled_or_overtaken_and_time_never_goes_back(
        conditions in any_conditions(),
        seed: u64,
        every_ms in 4_i64..100,
        bytes in 1_u64..4000,
    ) {
        let messages = 200;
        let read = run(&conditions, seed, messages, every_ms * MS, bytes);
        for peer in Peer::ALL {
            let numbers: Vec<i64> = read
                .iter()
                .filter(|delivery| delivery.to == peer)
                .map(|delivery| delivery.message)
                .collect();
            prop_assert_eq!(numbers, (0..messages).collect::<Vec<_>>());
        }
        let least_ns = 2 * (conditions.impairment.delay_ns - conditions.impairment.jitter_ns) as i64;
        prop_assert!(read.iter().all(|delivery| delivery.at_ns >= delivery.sent_ns + least_ns + conditions.stack_ns));
        prop_assert!(read.is_sorted_by_key(|delivery| delivery.at_ns));
        prop_assert_eq!(&read, &run(&conditions, seed, messages, every_ms * MS, bytes));
    }

    #[test]
    fn no_byte_is_sent_beyond_the_receivers_window(conditions in any_conditions(), seed: u64, bytes in 1_u64..30_000) {
        let mut exchange = Exchange::new(&conditions, seed);
        for number in 0..100 {
            while exchange.advance(number * 20 * MS).is_some() {
                prop_assert!(exchange.unacknowledged_bytes(Peer::Plant) <= 64_240);
            }
            exchange.send(number * 20 * MS, Peer::Plant, number, bytes);
            prop_assert!(exchange.unacknowledged_bytes(Peer::Plant) <= 64_240);
        }
    }
}
