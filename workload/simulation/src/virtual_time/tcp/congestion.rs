//! How many segments may be in flight. The main type is [`Congestion`].
//!
//! Growth and the size of a reduction are CUBIC's (RFC 9438 with the constants of `net/ipv4/tcp_cubic.c`), a reduction in
//! recovery is spread by PRR (RFC 6937, `tcp_cwnd_reduction`), and a window that nobody fills does not grow
//! (`tcp_is_cwnd_limited`, `tcp_cwnd_validate`).

use super::super::jiffies::Jiffies;

/// `TCP_INIT_CWND` (RFC 6928).
const INITIAL_SEGMENTS: u32 = 10;

/// The congestion window, in segments.
#[derive(Debug, Clone)]
pub(super) struct Congestion {
    pub window: u32,
    /// Slow start ends here; none until the first loss.
    pub threshold: u32,
    /// The window and the threshold before the last reduction.
    pub window_before: u32,
    pub threshold_before: u32,
    /// PRR: delivered and sent since the reduction began.
    delivered: u32,
    sent: u32,
    /// Acknowledged segments that have not made the window grow yet.
    towards_next: u32,
    cubic: Cubic,
    usage: Usage,
    jiffies: Jiffies,
}

/// How much of the window was used.
#[derive(Debug, Clone)]
struct Usage {
    limited: bool,
    most_out: u32,
    /// What was measured holds until this byte is acknowledged.
    until: u64,
    most_since_change: u32,
    changed_jiffy: i64,
}

impl Congestion {
    pub fn new(jiffies: Jiffies) -> Self {
        Self {
            window: INITIAL_SEGMENTS,
            threshold: u32::MAX,
            window_before: 0,
            threshold_before: 0,
            delivered: 0,
            sent: 0,
            towards_next: 0,
            cubic: Cubic::default(),
            usage: Usage {
                limited: false,
                most_out: 0,
                until: 0,
                most_since_change: 0,
                changed_jiffy: jiffies.count(0),
            },
            jiffies,
        }
    }

    /// `tcp_current_ssthresh` outside of a reduction.
    pub fn current_threshold(&self) -> u32 {
        self.threshold.max((self.window >> 1) + (self.window >> 2))
    }

    /// A recovery begins (`tcp_init_cwnd_reduction`).
    pub fn begin_reduction(&mut self) {
        self.towards_next = 0;
        self.window_before = self.window;
        self.delivered = 0;
        self.sent = 0;
        self.threshold = self.cubic.reduced(self.window);
    }

    /// A timeout (`tcp_enter_loss`): what is in flight, and one more.
    pub fn collapse(&mut self, in_flight: u32, now_ns: i64) {
        self.window = in_flight + 1;
        self.towards_next = 0;
        self.usage.changed_jiffy = self.jiffies.count(now_ns);
    }

    /// What a timeout reduces, if no recovery was under way.
    pub fn remember_and_reduce(&mut self, threshold_before: u32) {
        self.threshold_before = threshold_before;
        self.window_before = self.window;
        self.threshold = self.cubic.reduced(self.window);
    }

    /// CUBIC starts afresh after a timeout (`cubictcp_state`).
    pub fn forget(&mut self) {
        self.cubic = Cubic::default();
    }

    /// `tcp_cwnd_reduction`.
    pub fn reduce(&mut self, delivered: u32, in_flight: u32, advanced_without_loss: bool) {
        if delivered == 0 || self.window_before == 0 {
            return;
        }
        self.delivered += delivered;
        let room = i64::from(self.threshold) - i64::from(in_flight);
        let unsent = i64::from(self.delivered) - i64::from(self.sent);
        let may_send = if room < 0 {
            let before = u64::from(self.window_before);
            let share = (u64::from(self.threshold) * u64::from(self.delivered)).div_ceil(before);
            i64::try_from(share).unwrap_or(i64::MAX) - i64::from(self.sent)
        } else {
            let conserved = unsent.max(i64::from(delivered)) + i64::from(advanced_without_loss);
            conserved.min(room)
        };
        let may_send = may_send.max(i64::from(self.sent == 0));
        self.window = in_flight.saturating_add(u32::try_from(may_send).unwrap_or(0));
    }

    /// Counts what was sent during a reduction.
    pub fn count_sent(&mut self, segments: u32) {
        self.sent += segments;
    }

    /// The recovery is over: the window is what it was reduced to (`tcp_end_cwnd_reduction`).
    pub fn end_reduction(&mut self, now_ns: i64) {
        if self.threshold < u32::MAX {
            self.window = self.threshold;
            self.usage.changed_jiffy = self.jiffies.count(now_ns);
        }
    }

    /// The reduction was a mistake (`tcp_undo_cwnd_reduction`).
    pub fn undo(&mut self, now_ns: i64) {
        if self.threshold_before > 0 {
            self.window = self.window.max(self.window_before);
            self.threshold = self.threshold.max(self.threshold_before);
        }
        self.usage.changed_jiffy = self.jiffies.count(now_ns);
    }

    /// Segments were acknowledged, and no reduction is under way (`tcp_cong_avoid`).
    pub fn grow(&mut self, now_ns: i64, acked: u32, shortest_us: i64) {
        if self.is_limited() {
            let left = self.grow_slow_start(acked);
            if left > 0 {
                let now_ms = self.jiffies.in_us(self.jiffies.count(now_ns)) / 1000;
                let for_one = self
                    .cubic
                    .acks_for_one(now_ms, self.window, left, shortest_us / 1000);
                self.grow_by(for_one, left);
            }
        }
        self.usage.changed_jiffy = self.jiffies.count(now_ns);
    }

    fn in_slow_start(&self) -> bool {
        self.window < self.threshold
    }

    /// `tcp_slow_start`; what is left of the acknowledged segments.
    fn grow_slow_start(&mut self, acked: u32) -> u32 {
        if !self.in_slow_start() {
            return acked;
        }
        let window = self.window.saturating_add(acked).min(self.threshold);
        let left = acked - (window - self.window);
        self.window = window;
        left
    }

    /// `tcp_cong_avoid_ai`.
    fn grow_by(&mut self, acks_for_one: u32, acked: u32) {
        if self.towards_next >= acks_for_one {
            self.towards_next = 0;
            self.window += 1;
        }
        self.towards_next += acked;
        self.window += self.towards_next / acks_for_one;
        self.towards_next %= acks_for_one;
    }

    /// Whether the window is what holds the sender back (`tcp_is_cwnd_limited`).
    fn is_limited(&self) -> bool {
        self.usage.limited || (self.in_slow_start() && self.window < self.usage.most_out.saturating_mul(2))
    }

    /// After sending, or after being kept from it (`tcp_cwnd_validate`). `una` and `nxt` are the sender's.
    pub fn validate(&mut self, now: &SendingState) {
        let usage = &mut self.usage;
        if now.una >= usage.until || now.limited || (!usage.limited && now.out > usage.most_out) {
            usage.limited = now.limited;
            usage.most_out = now.out;
            usage.until = now.nxt;
        }
        let jiffy = self.jiffies.count(now.now_ns);
        if self.is_limited() {
            self.usage.most_since_change = 0;
            self.usage.changed_jiffy = jiffy;
            return;
        }
        self.usage.most_since_change = self.usage.most_since_change.max(now.out);
        if jiffy - self.usage.changed_jiffy >= now.timeout_jiffies {
            self.shrink_unused(now.open);
            self.usage.changed_jiffy = jiffy;
        }
    }

    /// `tcp_cwnd_application_limited`.
    fn shrink_unused(&mut self, open: bool) {
        if !open {
            return;
        }
        let used = self.usage.most_since_change.max(INITIAL_SEGMENTS);
        if used < self.window {
            self.threshold = self.current_threshold();
            self.window = u32::midpoint(self.window, used);
        }
        self.usage.most_since_change = 0;
    }

    /// Nothing was sent for longer than the timeout (`tcp_cwnd_restart`).
    pub fn restart(&mut self, now_ns: i64, idle_jiffies: i64, timeout_jiffies: i64) {
        self.threshold = self.current_threshold();
        let least = self.window.min(INITIAL_SEGMENTS);
        let mut left_jiffies = idle_jiffies - timeout_jiffies;
        while left_jiffies > 0 && self.window > least {
            self.window >>= 1;
            left_jiffies -= timeout_jiffies.max(1);
        }
        self.window = self.window.max(least);
        self.usage.changed_jiffy = self.jiffies.count(now_ns);
        self.usage.most_since_change = 0;
    }
}

/// What the validation of the window asks of the sender.
#[derive(Debug, Clone, Copy)]
pub(super) struct SendingState {
    pub now_ns: i64,
    pub una: u64,
    pub nxt: u64,
    pub out: u32,
    /// The window is full.
    pub limited: bool,
    /// No loss is being dealt with.
    pub open: bool,
    pub timeout_jiffies: i64,
}

/// CUBIC's state; times in milliseconds.
#[derive(Debug, Clone, Default)]
struct Cubic {
    last_maximum: u32,
    epoch: Option<Epoch>,
    acks_for_one: u32,
    /// When that was computed, and for which window. A reduction does not forget it.
    computed: Option<(i64, u32)>,
}

/// Since the window last became smaller.
#[derive(Debug, Clone)]
struct Epoch {
    began_ms: i64,
    /// When the curve is back at its plateau, from the beginning.
    plateau_ms: i64,
    plateau: u32,
    /// Acknowledged since Reno's window last grew.
    acked: u32,
    /// What Reno would have.
    reno_window: u32,
}

impl Cubic {
    /// A reduction is to 717/1024 of the window, to 2 at least (`cubictcp_recalc_ssthresh`). A window that did not
    /// reach the last maximum gives way faster.
    fn reduced(&mut self, window: u32) -> u32 {
        self.epoch = None;
        self.last_maximum = if window < self.last_maximum {
            window * (1024 + 717) / (2 * 1024)
        } else {
            window
        };
        (window.saturating_mul(717) / 1024).max(2)
    }

    /// How many acknowledged segments make the window larger by one (`bictcp_update`).
    fn acks_for_one(&mut self, now_ms: i64, window: u32, acked: u32, shortest_ms: i64) -> u32 {
        if let Some(epoch) = &mut self.epoch {
            epoch.acked += acked;
        }
        let computed = self.computed;
        if computed.is_some_and(|(at_ms, of)| of == window && now_ms - at_ms <= 1000 / 32) {
            return self.acks_for_one.max(2);
        }
        let last_maximum = self.last_maximum;
        let goes_on = self.epoch.is_some();
        let epoch = self.epoch.get_or_insert_with(|| Epoch {
            acked,
            ..Epoch::beginning(now_ms, window, last_maximum)
        });
        let acks = if goes_on && computed.is_some_and(|(at_ms, _)| at_ms == now_ms) {
            // The curve is looked at once a jiffy.
            i64::from(self.acks_for_one)
        } else {
            self.computed = Some((now_ms, window));
            let ahead = epoch.target(now_ms + shortest_ms) - i64::from(window);
            let acks = if ahead > 0 {
                i64::from(window) / ahead
            } else {
                100 * i64::from(window)
            };
            if last_maximum == 0 { acks.min(20) } else { acks }
        };
        let acks = acks.min(epoch.reno_acks_for_one(window)).max(2);
        self.acks_for_one = u32::try_from(acks).unwrap_or(u32::MAX);
        self.acks_for_one
    }
}

impl Epoch {
    fn beginning(now_ms: i64, window: u32, last_maximum: u32) -> Self {
        // K = ∛((Wmax − W) / C) with C = 0.4 segments/s³, here in ms.
        let below = u64::from(last_maximum.saturating_sub(window));
        Self {
            began_ms: now_ms,
            plateau_ms: cube_root(below * 2_500_000_000),
            plateau: last_maximum.max(window),
            acked: 0,
            reno_window: window,
        }
    }

    /// W(t) = C (t − K)³ + Wmax.
    fn target(&self, at_ms: i64) -> i64 {
        let offset_ms = i128::from(at_ms - self.began_ms - self.plateau_ms);
        let change = offset_ms.pow(3) * 4 / 10_000_000_000;
        i64::from(self.plateau) + i64::try_from(change).unwrap_or(i64::MAX / 2)
    }

    /// Where Reno would be faster, CUBIC follows it.
    fn reno_acks_for_one(&mut self, window: u32) -> i64 {
        // 8 (1024 + β) / 3 / (1024 − β), in eighths.
        let acks_for_one = ((window * 15) >> 3).max(1);
        // Reno's window grows with the acknowledgement after these, not with the last of them.
        let grown = self.acked.saturating_sub(1) / acks_for_one;
        self.reno_window += grown;
        self.acked -= grown * acks_for_one;
        match self.reno_window.checked_sub(window) {
            Some(ahead) if ahead > 0 => i64::from(window / ahead),
            _ => i64::MAX,
        }
    }
}

/// The whole part, by halving.
fn cube_root(of: u64) -> i64 {
    let (mut low, mut high) = (0_u64, 1 << 21);
    while low + 1 < high {
        let middle = u64::midpoint(low, high);
        if middle.pow(3) <= of {
            low = middle;
        } else {
            high = middle;
        }
    }
    i64::try_from(low).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::virtual_time::jiffies::DEBIAN_HZ;

    fn congestion() -> Congestion {
        Congestion::new(Jiffies::new(DEBIAN_HZ, 0))
    }

    /// The window is full, with byte `number` the first that is not acknowledged, and then so many segments are.
    fn fill_and_acknowledge(congestion: &mut Congestion, number: u64, now_ns: i64, acked: u32) {
        congestion.validate(&SendingState {
            now_ns,
            una: number,
            nxt: number + 1,
            out: congestion.window,
            limited: true,
            open: true,
            timeout_jiffies: 60,
        });
        congestion.grow(now_ns, acked, 40_000);
    }

    #[test]
    fn a_reduction_is_to_seven_tenths_and_never_below_two() {
        let mut congestion = congestion();
        for expected in [7, 4, 2, 2, 2] {
            congestion.begin_reduction();
            congestion.end_reduction(0);
            assert_eq!(congestion.window, expected);
        }
    }

    #[test]
    fn a_window_that_is_not_filled_does_not_grow() {
        let mut congestion = congestion();
        congestion.threshold = 4;
        congestion.window = 4;
        (0..100).for_each(|second| congestion.grow(second * 1_000_000_000, 1, 40_000));
        assert_eq!(congestion.window, 4);
    }

    #[test]
    fn a_window_that_is_filled_grows() {
        let mut congestion = congestion();
        congestion.begin_reduction();
        congestion.end_reduction(0);
        for number in 0..200_u64 {
            let now_ns = i64::try_from(number).unwrap() * 40_000_000;
            let acked = congestion.window;
            fill_and_acknowledge(&mut congestion, number, now_ns, acked);
        }
        // CUBIC's curve would be at 0.4 (8 − 1.96)³ + 10 = 98, Reno's at 7 + 200 · 8/15 = 114.
        assert!((110..=118).contains(&congestion.window), "{}", congestion.window);
    }

    /// The numbers are from a transcript of `tcp_cubic.c` of Linux 6.1 in Python, with 250 jiffies a second: three losses make 2 of 10, and
    /// then an acknowledgement comes each 20 ms.
    #[test]
    fn a_small_window_grows_with_the_same_acknowledgements_as_the_kernels() {
        let mut congestion = congestion();
        for _ in 0..3 {
            congestion.begin_reduction();
            congestion.end_reduction(0);
        }
        let mut grew = Vec::new();
        for number in 0..60_u64 {
            let now_ns = 4_000_000 + i64::try_from(number).unwrap() * 20_000_000;
            let before = congestion.window;
            fill_and_acknowledge(&mut congestion, number, now_ns, 1);
            if congestion.window > before {
                grew.push(number);
            }
        }
        assert_eq!(grew, [1, 10, 17, 26, 37, 50]);
        assert_eq!(congestion.window, 8);
    }

    #[test]
    fn prr_sends_what_was_delivered_and_ends_at_the_threshold() {
        let mut congestion = congestion();
        congestion.begin_reduction();
        // Ten were in flight, one is lost: eight remain after each selective acknowledgement.
        congestion.reduce(1, 8, false);
        assert_eq!(congestion.window, 9, "the first lets the lost segment go again");
        congestion.count_sent(1);
        congestion.reduce(1, 8, false);
        assert_eq!(congestion.window, 9);
        congestion.end_reduction(0);
        assert_eq!(congestion.window, 7);
    }

    proptest! {
        #[test]
        fn the_cube_root_is_the_whole_part(of in 0..9_000_000_000_000_000_000_u64) {
            let root = cube_root(of).unsigned_abs();
            prop_assert!(root.pow(3) <= of && (root + 1).pow(3) > of);
        }
    }
}
