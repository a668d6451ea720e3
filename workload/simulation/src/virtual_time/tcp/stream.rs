//! One direction of a connection with the messages in it. The main type is [`Stream`].

use std::collections::VecDeque;

use oorandom::Rand64;
use record::platform_model::Quantiles;

use super::{
    receiver::Receiver,
    segment::{Ack, Data},
    sender::{Counts, Sender, SenderSettings},
};
use crate::{stalls::Stalls, virtual_time::jiffies::Jiffies};

/// An established connection's way from a program that writes messages to one that reads each as soon as it can.
#[derive(Debug)]
pub struct Stream<M> {
    sender: Sender,
    receiver: Receiver,
    /// Messages that were not read, by the end of their bytes.
    messages: VecDeque<Written<M>>,
    reader: Reader,
    read_ns: Option<i64>,
}

/// When a program reads what has arrived.
#[derive(Debug)]
pub struct Reader {
    /// How long it takes, of itself.
    pub after: Quantiles,
    /// What that is drawn from.
    pub chance: Rand64,
    /// When its machine stands still.
    pub stalls: Stalls,
}

impl Reader {
    /// One that reads at once.
    #[cfg(test)]
    pub fn at_once() -> Self {
        Self {
            after: Quantiles::default(),
            chance: Rand64::new(0),
            stalls: Stalls::none(),
        }
    }

    /// When it reads what arrives now. Nothing is drawn where it takes no time.
    fn reads_ns(&mut self, now_ns: i64) -> i64 {
        let after_ns = match self.after.0.is_empty() {
            true => 0,
            false => self.after.at_ns(self.chance.rand_float()),
        };
        self.stalls.over_ns(now_ns + after_ns)
    }
}

#[derive(Debug)]
struct Written<M> {
    end: u64,
    written_ns: i64,
    message: M,
}

/// A message that was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Read<M> {
    /// When it was written.
    pub written_ns: i64,
    /// When it was read.
    pub read_ns: i64,
    /// The message.
    pub message: M,
}

impl<M> Stream<M> {
    /// Established at time zero, nothing written.
    #[must_use]
    pub fn new(settings: SenderSettings, jiffies: Jiffies, reader: Reader) -> Self {
        let round_trip_ns = settings.first_round_trip_ns;
        Self {
            sender: Sender::new(settings, jiffies),
            receiver: Receiver::new(jiffies, settings.receive_window, round_trip_ns),
            messages: VecDeque::new(),
            reader,
            read_ns: None,
        }
    }

    /// The program writes a message of so many bytes, of which there must be one.
    pub fn write(&mut self, now_ns: i64, message: M, bytes: u64) {
        self.sender.write(now_ns, bytes.max(1));
        self.messages.push_back(Written {
            end: self.sender.written,
            written_ns: now_ns,
            message,
        });
    }

    /// A segment arrives at the reader's host.
    pub fn receive_data(&mut self, now_ns: i64, data: &Data) {
        self.receiver.receive(now_ns, data);
        if self.receiver.is_readable() && self.read_ns.is_none() {
            self.read_ns = Some(self.reader.reads_ns(now_ns));
        }
    }

    /// An acknowledgement arrives at the writer's host.
    pub fn receive_ack(&mut self, now_ns: i64, ack: &Ack) {
        self.sender.receive(now_ns, ack);
    }

    /// The next segment to put on the wire.
    pub fn take_data(&mut self) -> Option<Data> {
        self.sender.outbox.pop_front()
    }

    /// The next acknowledgement to put on the wire.
    pub fn take_ack(&mut self) -> Option<Ack> {
        self.receiver.outbox.pop_front()
    }

    /// When a timer fires or the program reads.
    #[must_use]
    pub fn next_ns(&self) -> Option<i64> {
        [self.sender.next_ns(), self.receiver.next_ns(), self.read_ns]
            .into_iter()
            .flatten()
            .min()
    }

    /// Does what is due. What was read is handed to `reader`, in order.
    pub fn advance(&mut self, now_ns: i64, mut reader: impl FnMut(Read<M>)) {
        self.sender.advance(now_ns);
        self.receiver.advance(now_ns);
        if self.read_ns.is_none_or(|read_ns| read_ns > now_ns) {
            return;
        }
        self.read_ns = None;
        self.receiver.read();
        let complete = self.receiver.next;
        while self
            .messages
            .front()
            .is_some_and(|written| written.end <= complete)
        {
            let Some(written) = self.messages.pop_front() else {
                return;
            };
            reader(Read {
                written_ns: written.written_ns,
                read_ns: now_ns,
                message: written.message,
            });
        }
    }

    /// How many bytes were sent and are not acknowledged.
    #[must_use]
    pub fn unacknowledged_bytes(&self) -> u64 {
        self.sender.nxt - self.sender.una
    }

    /// What the sender did so far.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.sender.counts
    }
}

#[cfg(test)]
mod tests;
