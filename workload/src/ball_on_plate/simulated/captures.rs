//! The captures of a simulated run: each packet of the exchange as the Ethernet frame that it stands for, in a file for each host and
//! window. The main type is [`Captures`].
//!
//! The connections are there when the run begins, so that no handshake is captured; sequence numbers begin at 1 all the same. What is
//! not simulated is not made up: `h1` has no packet.

use std::{collections::VecDeque, io};

use etherparse::{IpHeaders, Ipv4Extensions, Ipv4Header, PacketBuilder, TcpOptionElement};
use record::{
    settings::CaptureSettings,
    topology::{address, mac},
    virtual_host::VirtualHost,
    window::CaptureRecord,
};
use simulation::{
    closed_loop::Simulation,
    virtual_time::exchange::{Heard, Packet, Peer, Segment},
};

use crate::{
    capture::{CaptureError, CapturedWindow, window_file::WindowFile},
    experiment::window_folder::WindowFolder,
};

/// What captured.
const TOOL: &str = "simulated";
/// Where the publisher of each peer listens, in [`Peer::ALL`]'s order.
const PUBLISHERS: [u16; 2] = [40_001, 40_002];
/// The subscriber's end of each connection, in the order of its publishers.
const SUBSCRIBERS: [u16; 2] = [50_001, 50_002];
/// The sequence number of a connection's first byte, each way.
const FIRST: u32 = 1;
/// What every segment says of its receiver's buffer, scaled by 128: 64 KiB.
const WINDOW: u16 = 501;
/// Bytes of a connection that are kept for segments that come late: no more are under way.
const KEPT_BYTES: usize = 256 << 10;

/// The files of the windows under way, and what their packets are made of.
pub struct Captures {
    snaplen: u32,
    written: [Written; 2],
    windows: VecDeque<Window>,
}

/// The files of a window, in [`VirtualHost::OF_THE_BALL`]'s order.
struct Window {
    /// On the clock of the simulation.
    ends_ns: i64,
    files: [WindowFile; 3],
}

/// The newest bytes of a connection.
#[derive(Default)]
struct Written {
    begin: u64,
    bytes: VecDeque<u8>,
}

impl Captures {
    /// Of a run whose windows were not opened yet.
    #[must_use]
    pub fn new(settings: &CaptureSettings) -> Self {
        Self {
            snaplen: u32::try_from(settings.snaplen.get()).unwrap_or(u32::MAX),
            written: Default::default(),
            windows: VecDeque::new(),
        }
    }

    /// Begins the files of the next window, which ends then.
    ///
    /// # Errors
    /// If one cannot be written.
    pub fn begin_window(&mut self, folder: &WindowFolder, ends_ns: i64) -> Result<(), CaptureError> {
        let [h1, sta1, sta2] =
            VirtualHost::OF_THE_BALL.map(|host| WindowFile::create(folder.capture(host), self.snaplen));
        self.windows.push_back(Window {
            ends_ns,
            files: [h1?, sta1?, sta2?],
        });
        Ok(())
    }

    /// Takes what was captured up to now. Packets after the last window are left out.
    ///
    /// # Errors
    /// If a packet cannot be one.
    pub fn take(&mut self, simulation: &mut Simulation, unix_offset_ns: i64) -> io::Result<()> {
        for peer in Peer::ALL {
            self.written[peer.index()].add(&simulation.take_written(peer));
        }
        let mut frame = Vec::new();
        while let Some(Heard { at, at_ns, packet }) = simulation.take_heard() {
            let Some(window) = self.windows.iter_mut().find(|window| at_ns < window.ends_ns) else {
                continue;
            };
            frame.clear();
            self.written[packet.of.index()].frame(&packet, &mut frame)?;
            let [_, sta1, sta2] = &mut window.files;
            let file = match at {
                Peer::Controller => sta1,
                Peer::Plant => sta2,
            };
            let kept = frame.len().min(self.snaplen as usize);
            file.write(
                at_ns + unix_offset_ns,
                frame.len(),
                frame.get(..kept).unwrap_or(&frame),
            );
        }
        Ok(())
    }

    /// Completes the files of the oldest window.
    pub fn end_window(&mut self) -> Vec<CapturedWindow> {
        let Some(window) = self.windows.pop_front() else {
            return Vec::new();
        };
        let files = VirtualHost::OF_THE_BALL.into_iter().zip(window.files);
        let captured = files.map(|(host, file)| CapturedWindow {
            file: file.path().to_owned(),
            outcome: file.complete().map(|packets| CaptureRecord {
                host,
                packets,
                dropped: 0,
                tool: TOOL.to_owned(),
            }),
        });
        captured.collect()
    }
}

impl Written {
    fn add(&mut self, bytes: &[u8]) {
        self.bytes.extend(bytes);
        let beyond = self.bytes.len().saturating_sub(KEPT_BYTES);
        self.bytes.drain(..beyond);
        self.begin += beyond as u64;
    }

    /// The bytes from one place to another of the stream; fewer if they are not kept any more.
    fn between(&self, begin: u64, end: u64) -> impl Iterator<Item = u8> + '_ {
        let place = |at: u64| usize::try_from(at.saturating_sub(self.begin)).unwrap_or(usize::MAX);
        let end = place(end).min(self.bytes.len());
        self.bytes.range(place(begin).min(end)..end).copied()
    }

    /// Writes a packet of the connection as an Ethernet frame.
    fn frame(&self, packet: &Packet, into: &mut Vec<u8>) -> io::Result<()> {
        let publisher = packet.of.index();
        let (from, to) = (host(packet.from()), host(packet.from().other()));
        let ip = Ipv4Header {
            identification: packet.number as u16,
            dont_fragment: true,
            time_to_live: 64,
            source: address(from).octets(),
            destination: address(to).octets(),
            ..Ipv4Header::default()
        };
        let on_ip =
            PacketBuilder::ethernet2(mac(from), mac(to)).ip(IpHeaders::Ipv4(ip, Ipv4Extensions::default()));
        let (published, subscribed) = (PUBLISHERS[publisher], SUBSCRIBERS[publisher]);
        let clock = |ms: i64| ms as u32;
        let stamps =
            |sent_ms| TcpOptionElement::Timestamp(clock(sent_ms), clock(packet.echo_ms.unwrap_or(0)));
        match packet.segment {
            Segment::Data(data) => {
                let payload: Vec<u8> = self.between(data.span.begin, data.span.end).collect();
                on_ip
                    .tcp(published, subscribed, number(data.span.begin), WINDOW)
                    .ack(FIRST)
                    .psh()
                    .options(&[
                        TcpOptionElement::Noop,
                        TcpOptionElement::Noop,
                        stamps(data.stamp_ms),
                    ])
                    .map_err(io::Error::other)?
                    .write(into, &payload)
                    .map_err(io::Error::other)
            }
            Segment::Ack(ack) => {
                let mut blocks = ack.spans().map(|span| (number(span.begin), number(span.end)));
                let mut options = vec![
                    TcpOptionElement::Noop,
                    TcpOptionElement::Noop,
                    stamps(packet.sent_ns / 1_000_000),
                ];
                if let Some(first) = blocks.next() {
                    let further = [blocks.next(), blocks.next(), None];
                    options.extend([TcpOptionElement::Noop, TcpOptionElement::Noop]);
                    options.push(TcpOptionElement::SelectiveAcknowledgement(first, further));
                }
                on_ip
                    .tcp(subscribed, published, FIRST, WINDOW)
                    .ack(number(ack.next))
                    .options(&options)
                    .map_err(io::Error::other)?
                    .write(into, &[])
                    .map_err(io::Error::other)
            }
        }
    }
}

/// The position of a peer's host.
const fn host(peer: Peer) -> usize {
    peer.index() + 1
}

/// TCP's number of a place in the stream.
#[allow(clippy::cast_possible_truncation)] // Numbers begin anew after 4 GiB (RFC 9293, 3.4).
const fn number(place: u64) -> u32 {
    (place as u32).wrapping_add(FIRST)
}
