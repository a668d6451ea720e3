//! Two programs that talk over an [`Exchange`], in virtual time. The main type is [`Program`]; [`run`] lets both go.
//!
//! What happens at one instant has an order: first what the network does, so that a message that comes exactly at a tick is
//! in time for it; then the plant's tick, then the controller's.

use super::exchange::{Delivery, Exchange, Peer};

/// A program on one of the hosts. It takes no time.
pub trait Program<M> {
    /// When it next does something of itself: its interval timer's next tick. It never goes back; nothing if it only
    /// answers.
    fn next_ns(&self) -> Option<i64>;

    /// It is that time.
    fn tick(&mut self, now_ns: i64, published: &mut Vec<Publication<M>>);

    /// It has read a message.
    fn read(&mut self, delivery: Delivery<M>, published: &mut Vec<Publication<M>>);
}

/// A message that a program publishes now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Publication<M> {
    /// The message.
    pub message: M,
    /// How many bytes it has on the connection, its length before it included.
    pub bytes: u64,
}

/// Lets both programs go until that time, which is included.
pub fn run<M>(
    exchange: &mut Exchange<M>,
    controller: &mut dyn Program<M>,
    plant: &mut dyn Program<M>,
    until_ns: i64,
) {
    let mut published = Vec::new();
    loop {
        let ticks = [
            (plant.next_ns(), Peer::Plant),
            (controller.next_ns(), Peer::Controller),
        ];
        let next = ticks
            .into_iter()
            .filter_map(|(next_ns, peer)| Some((next_ns?, peer)))
            .min_by_key(|(next_ns, _)| *next_ns);
        let limit_ns = next.map_or(until_ns, |(next_ns, _)| next_ns.min(until_ns));
        let delivery = exchange.advance(limit_ns);
        let next = next.filter(|(next_ns, _)| *next_ns <= until_ns);
        let (now_ns, peer) = match (&delivery, next) {
            (Some(delivery), _) => (delivery.at_ns, delivery.to),
            (None, Some(next)) => next,
            (None, None) => return,
        };
        let program: &mut dyn Program<M> = match peer {
            Peer::Controller => controller,
            Peer::Plant => plant,
        };
        match delivery {
            Some(delivery) => program.read(delivery, &mut published),
            None => program.tick(now_ns, &mut published),
        }
        for Publication { message, bytes } in published.drain(..) {
            exchange.send(now_ns, peer, message, bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use record::settings::NetworkSettings;
    use rstest::rstest;

    use super::*;
    use crate::{link::Impairment, virtual_time::exchange::Conditions};

    const MS: i64 = 1_000_000;
    const STEP_NS: i64 = 20 * MS;

    /// Publishes its step's number and notes when the answer to it is read.
    struct Asking {
        next: i64,
        answers: Vec<(i64, i64)>,
    }

    impl Program<i64> for Asking {
        fn next_ns(&self) -> Option<i64> {
            Some(self.next * STEP_NS)
        }

        fn tick(&mut self, _: i64, published: &mut Vec<Publication<i64>>) {
            published.push(Publication {
                message: self.next,
                bytes: 73,
            });
            self.next += 1;
        }

        fn read(&mut self, delivery: Delivery<i64>, _: &mut Vec<Publication<i64>>) {
            self.answers.push((delivery.message, delivery.at_ns));
        }
    }

    /// Answers what it reads and does nothing of itself.
    struct Answering;

    impl Program<i64> for Answering {
        fn next_ns(&self) -> Option<i64> {
            None
        }

        fn tick(&mut self, _: i64, _: &mut Vec<Publication<i64>>) {
            panic!("it has no tick");
        }

        fn read(&mut self, delivery: Delivery<i64>, published: &mut Vec<Publication<i64>>) {
            published.push(Publication {
                message: delivery.message,
                bytes: 58,
            });
        }
    }

    fn answers(impairment: Impairment, nagle: bool, until_ns: i64) -> Vec<(i64, i64)> {
        let conditions = Conditions {
            impairment,
            nagle,
            ..Conditions::of(&NetworkSettings::default())
        };
        let mut asking = Asking {
            next: 0,
            answers: Vec::new(),
        };
        let mut exchange = Exchange::new(&conditions, 1);
        run(&mut exchange, &mut asking, &mut Answering, until_ns);
        asking.answers
    }

    #[test]
    fn an_answer_is_read_a_round_trip_after_the_question() {
        let impairment = Impairment {
            delay_ns: 10_000_000,
            ..Impairment::NONE
        };
        let expected: Vec<(i64, i64)> = (0..5).map(|step| (step, step * STEP_NS + 40 * MS)).collect();
        assert_eq!(answers(impairment, false, 120 * MS), expected);
    }

    #[rstest]
    #[case::with_nagle(true)]
    #[case::without(false)]
    fn every_question_is_answered_once_and_in_order_whatever_is_lost(#[case] nagle: bool) {
        let impairment = Impairment {
            loss: 0.05,
            ..Impairment::from(&NetworkSettings::default().link())
        };
        let answers = answers(impairment, nagle, 100_000 * MS);
        let numbers: Vec<i64> = answers.iter().map(|(number, _)| *number).collect();
        assert!(numbers.len() > 4800, "{}", numbers.len());
        let count = i64::try_from(numbers.len()).unwrap();
        assert_eq!(numbers, (0..count).collect::<Vec<_>>());
    }
}
