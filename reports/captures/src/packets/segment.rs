//! What one packet says about a TCP connection. The main type is [`Segment`].

use std::net::SocketAddrV4;

use etherparse::{
    EtherType, Ethernet2HeaderSlice, IpNumber, Ipv4HeaderSlice, TcpHeaderSlice, TcpOptionElement,
};

use super::{Packet, sequence::Departure};

/// A TCP segment over IPv4 over Ethernet (RFC 9293), without copying anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment<'a> {
    /// Who sent it.
    pub source: SocketAddrV4,
    /// To whom.
    pub destination: SocketAddrV4,
    /// IP's number of it: Linux counts the packets of a connection with it, so that a retransmitted segment has another.
    pub identification: u16,
    /// Sequence number of its first byte, or of its SYN.
    pub sequence: u32,
    /// Up to where the sender has received the other direction.
    pub acknowledged: Option<u32>,
    /// Whether it opens the direction; the SYN takes a place before the first byte.
    pub opens: bool,
    /// The sender's clock of RFC 7323, if the option is there: it distinguishes a retransmitted segment from a
    /// reordered one.
    pub sent_clock: Option<u32>,
    /// Bytes of the stream that it carried.
    pub payload_bytes: u32,
    /// What the capture kept of them: their beginning, or all.
    pub payload: &'a [u8],
}

impl<'a> Segment<'a> {
    /// What tells when it was sent.
    pub const fn departure(&self) -> Departure {
        Departure {
            clock: self.sent_clock,
            identification: self.identification,
        }
    }

    /// The segment in a packet; none if the packet is something else, or cut within its headers.
    #[must_use]
    pub fn parse(packet: &Packet<'a>) -> Option<Self> {
        let ethernet = Ethernet2HeaderSlice::from_slice(packet.bytes).ok()?;
        if ethernet.ether_type() != EtherType::IPV4 {
            return None;
        }
        let above = packet.bytes.get(ethernet.slice().len()..)?;
        let ip = Ipv4HeaderSlice::from_slice(above).ok()?;
        if ip.protocol() != IpNumber::TCP || ip.is_fragmenting_payload() {
            return None;
        }
        let above = above.get(ip.slice().len()..)?;
        let tcp = TcpHeaderSlice::from_slice(above).ok()?;
        let headers = ip.slice().len() + tcp.slice().len();
        // A short packet is padded to 60 bytes: only IP's own length says where it ends.
        let payload_bytes = usize::from(ip.total_len()).checked_sub(headers)?;
        let kept = above.get(tcp.slice().len()..)?;
        let sent_clock = tcp.options_iterator().find_map(|option| match option {
            Ok(TcpOptionElement::Timestamp(clock, _)) => Some(clock),
            _ => None,
        });
        Some(Self {
            source: SocketAddrV4::new(ip.source_addr(), tcp.source_port()),
            destination: SocketAddrV4::new(ip.destination_addr(), tcp.destination_port()),
            identification: ip.identification(),
            sequence: tcp.sequence_number(),
            acknowledged: tcp.ack().then(|| tcp.acknowledgment_number()),
            opens: tcp.syn(),
            sent_clock,
            payload_bytes: u32::try_from(payload_bytes).ok()?,
            payload: kept.get(..payload_bytes).unwrap_or(kept),
        })
    }
}

#[cfg(test)]
mod tests {
    use etherparse::{PacketBuilder, TcpOptionElement};
    use proptest::prelude::*;

    use super::*;

    fn frame(payload: &[u8], clock: Option<u32>) -> Vec<u8> {
        let builder = PacketBuilder::ethernet2([0; 6], [1; 6])
            .ipv4([10, 0, 0, 3], [10, 0, 0, 2], 64)
            .tcp(4000, 5000, 7, 1024)
            .ack(99);
        let mut bytes = Vec::new();
        match clock {
            Some(clock) => {
                let options = [
                    TcpOptionElement::Noop,
                    TcpOptionElement::Noop,
                    TcpOptionElement::Timestamp(clock, 0),
                ];
                builder
                    .options(&options)
                    .unwrap()
                    .write(&mut bytes, payload)
                    .unwrap();
            }
            None => builder.write(&mut bytes, payload).unwrap(),
        }
        bytes
    }

    fn parse(bytes: &[u8], original_bytes: usize) -> Option<Segment<'_>> {
        Segment::parse(&Packet {
            stamp_unix_ns: 0,
            original_bytes,
            bytes,
        })
    }

    #[test]
    fn a_segment_is_what_its_headers_say() {
        let bytes = frame(b"hello", Some(12));
        let segment = parse(&bytes, bytes.len()).unwrap();
        assert_eq!(segment.source, "10.0.0.3:4000".parse().unwrap());
        assert_eq!(segment.destination, "10.0.0.2:5000".parse().unwrap());
        assert_eq!((segment.sequence, segment.acknowledged), (7, Some(99)));
        assert_eq!((segment.sent_clock, segment.opens), (Some(12), false));
        assert_eq!((segment.payload_bytes, segment.payload), (5, &b"hello"[..]));
    }

    #[test]
    fn the_padding_of_a_short_packet_is_not_payload() {
        let mut bytes = frame(b"", None);
        bytes.resize(60, 0xAA);
        let segment = parse(&bytes, 60).unwrap();
        assert_eq!((segment.payload_bytes, segment.payload), (0, &b""[..]));
        assert_eq!(segment.sent_clock, None);
    }

    #[test]
    fn of_a_cut_packet_the_length_of_the_payload_is_still_known() {
        let bytes = frame(&[5; 200], None);
        let segment = parse(&bytes[..96], bytes.len()).unwrap();
        assert_eq!(segment.payload_bytes, 200);
        assert_eq!(segment.payload, &[5; 96 - 54]);
    }

    proptest! {
        #[test]
        fn no_packet_makes_it_panic(mut bytes: Vec<u8>, cut in 0_usize..80, at in 0_usize..80, byte: u8) {
            let _ = parse(&bytes, bytes.len());
            let real = frame(b"hello", Some(12));
            bytes = real[..cut.min(real.len())].to_vec();
            if let Some(place) = bytes.get_mut(at) {
                *place = byte;
            }
            let _ = parse(&bytes, real.len());
        }
    }
}
