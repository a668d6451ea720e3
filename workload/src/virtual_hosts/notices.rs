//! Where the notices of master and nodes are kept until somebody writes them down: they come from threads that others'
//! connections drive, at whatever rate others choose. The main type is [`NoticeQueue`].

use std::sync::mpsc::Receiver;

use record::{progress::Progress, virtual_host::VirtualHost, window::NoticesRecord};

use crate::ros::{Notice, Notices};

/// Notices of one host between two looks; what is more is counted and forgotten.
const MOST_WAITING: usize = 256;

/// How many a run says; an attack is not to fill the disk. All are counted in the windows' records.
const MOST_SAID: u32 = 200;

/// One queue for each virtual host.
#[derive(Debug)]
pub struct NoticeQueue {
    queues: Vec<(VirtualHost, Notices, Receiver<Notice>)>,
    said: u32,
    forgotten: u64,
}

/// What has come between two looks.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct News {
    /// Host and words.
    pub texts: Vec<String>,
    /// How many more there were.
    pub forgotten: u64,
}

impl News {
    /// Adds them to a window's record, as far as that has room.
    pub fn add_to(self, record: &mut NoticesRecord) {
        let room = NoticesRecord::MOST.saturating_sub(record.first.len());
        record.count += self.texts.len() as u64 + self.forgotten;
        record.first.extend(self.texts.into_iter().take(room));
    }
}

impl NoticeQueue {
    /// One for those hosts, empty.
    #[must_use]
    pub fn on(hosts: impl IntoIterator<Item = VirtualHost>) -> Self {
        let queue = |host| {
            let (notices, queue) = Notices::queue(MOST_WAITING);
            (host, notices, queue)
        };
        Self {
            queues: hosts.into_iter().map(queue).collect(),
            said: 0,
            forgotten: 0,
        }
    }

    /// For whoever runs on that host.
    #[must_use]
    pub fn of(&self, host: VirtualHost) -> Notices {
        let found = self.queues.iter().find(|(of, ..)| *of == host);
        found.map_or_else(Notices::ignored, |(_, notices, _)| notices.clone())
    }

    /// Says what has come since the last look, as far as a run may, and gives it back for the window's record.
    pub fn look(&mut self, say: impl Fn(&Progress)) -> News {
        let mut news = News::default();
        for (host, _, queue) in &self.queues {
            // No more than the queue holds: whoever fills it may be as fast as this.
            for notice in queue.try_iter().take(MOST_WAITING) {
                let text = notice.to_string();
                news.texts.push(format!("{host}: {text}"));
                if self.said < MOST_SAID {
                    self.said += 1;
                    say(&Progress::Notice { host: *host, text });
                }
            }
        }
        let forgotten = self
            .queues
            .iter()
            .map(|(_, notices, _)| notices.forgotten())
            .sum();
        news.forgotten = forgotten - self.forgotten;
        self.forgotten = forgotten;
        news
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    fn notice() -> Notice {
        Notice::RegisteredAgain {
            node: "/plant".to_owned(),
        }
    }

    #[test]
    fn news_are_told_once_with_their_host() {
        let mut board = NoticeQueue::on(VirtualHost::OF_THE_BALL);
        board.of(VirtualHost::STA2).send(notice());
        let said = Cell::new(0);
        let say = |progress: &Progress| {
            assert!(matches!(progress, Progress::Notice { host, .. } if *host == VirtualHost::STA2));
            said.set(said.get() + 1);
        };
        let news = board.look(say);
        assert_eq!(
            news.texts,
            ["sta2: /plant has registered with the master that came after"]
        );
        assert_eq!(board.look(say), News::default());
        assert_eq!(said.get(), 1);
    }

    #[test]
    fn a_flood_is_counted_to_the_last_and_said_in_part() {
        let mut board = NoticeQueue::on(VirtualHost::OF_THE_BALL);
        let notices = board.of(VirtualHost::H1);
        let said = Cell::new(0);
        let mut counted = 0;
        for _ in 0..3 {
            for _ in 0..MOST_WAITING + 10 {
                notices.send(notice());
            }
            let news = board.look(|_| said.set(said.get() + 1));
            assert_eq!(news.forgotten, 10);
            counted += news.texts.len() as u64 + news.forgotten;
        }
        assert_eq!(counted, 3 * (MOST_WAITING as u64 + 10));
        assert_eq!(said.get(), MOST_SAID);
    }
}
