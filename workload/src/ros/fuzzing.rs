//! Gives what peers send to what reads it, without a connection.

use simulation::ros::{float64_multi_array, string};

use super::{
    connection_header::ConnectionHeader,
    frames::Frames,
    xml_rpc::{
        document::{read_call, read_response},
        http::{Inbox, Role},
    },
};

/// Frames of a TCPROS connection, each of them as a header and as a message; never held is more than what came and one frame.
pub fn tcpros(bytes: &[u8]) {
    const LIMIT: usize = 4096;
    let mut frames = Frames::new(LIMIT);
    for piece in bytes.chunks(61) {
        let space = frames.space();
        let Some(room) = space.get_mut(..piece.len()) else {
            return;
        };
        room.copy_from_slice(piece);
        frames.filled(piece.len());
        while let Ok(Some(frame)) = frames.next() {
            assert!(frame.len() <= LIMIT);
            if let Ok(header) = ConnectionHeader::parse(frame) {
                assert!(header.to_bytes().len() <= frame.len() + 64);
            }
            let _ = float64_multi_array::decode::<6>(frame);
            let _ = string::decode(frame);
        }
    }
}

/// A call and a response.
pub fn xml_rpc(bytes: &[u8]) {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = read_call(text);
        let _ = read_response(text);
    }
}

/// The messages of a connection, in pieces, as a server and as a client.
pub fn http(bytes: &[u8]) {
    for role in [Role::Requests, Role::Responses] {
        let mut inbox = Inbox::new(role);
        for piece in bytes.chunks(100) {
            inbox.take_in(piece);
            while let Ok(Some(message)) = inbox.next() {
                assert!(message.body.len() <= bytes.len());
            }
        }
        let _ = inbox.close();
    }
}
