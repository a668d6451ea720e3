//! One direction of a TCP connection as Linux 6.1 to 6.18 has it, for small messages: data one way, pure acknowledgements
//! back, as a ROS topic uses it. The main type is [`Stream`].
//!
//! | rule | where Linux has it |
//! |---|---|
//! | Nagle, with Minshall's variant | `tcp_nagle_check`, `tcp_minshall_update` |
//! | retransmission timeout, at least 200 ms, doubled | RFC 6298; `tcp_rtt_estimator`, `tcp_retransmit_timer` |
//! | tail loss probe | RFC 8985, 7; `tcp_schedule_loss_probe`, `tcp_send_loss_probe`, `tcp_process_tlp_ack` |
//! | losses by time, reordering window | RFC 8985, 6; `tcp_recovery.c` |
//! | selective acknowledgement, duplicates | RFC 2018, RFC 2883; `tcp_sacktag_write_queue`, `tcp_data_queue` |
//! | spurious timeouts | RFC 5682; `tcp_process_loss` |
//! | undoing a reduction | RFC 3522 (by time stamps), RFC 3708 (by duplicates); `tcp_try_undo_*` |
//! | reduction in recovery | RFC 6937; `tcp_cwnd_reduction` |
//! | window growth and reduction | RFC 9438; `tcp_cubic.c` |
//! | window validation, restart after idle | RFC 7661, RFC 2861; `tcp_cwnd_validate`, `tcp_slow_start_after_idle_check` |
//! | joining what is sent again | `tcp_retrans_try_collapse` |
//! | delayed and quick acknowledgements | `__tcp_ack_snd_check`, `tcp_send_delayed_ack`, `tcp_cleanup_rbuf` |
//! | fewer selective acknowledgements | `tcp_comp_sack_delay_ns` |
//!
//! Left out, because such a stream never gets there: pacing, ECN, window scaling and zero windows, urgent data, memory
//! pressure, SACK reneging, path MTU probes, F-RTO without SACK. Segmentation offload is left out too: a segment has at most
//! an MSS. Sequence numbers have 64 bits and begin at zero.

mod acknowledged;
mod congestion;
mod rack;
mod receiver;
mod recovery;
mod round_trip;
mod scoreboard;
pub mod segment;
mod sender;
mod stream;
mod transmission;

/// The congestion control that a stream has, as Linux calls it. Others wait otherwise after a loss.
pub const CONGESTION_CONTROL: &str = "cubic";

pub use self::{
    sender::{Counts, SenderSettings},
    stream::{Read, Reader, Stream},
};
