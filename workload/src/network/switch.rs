//! A learning switch, as an Ethernet bridge without VLANs (IEEE 802.1D, clause 7): pure. The main type is [`Switch`].
//!
//! Addresses do not age: the hosts never move.

use std::collections::HashMap;

/// How many addresses are remembered: a host that makes them up must not eat the memory.
const TABLE_LIMIT: usize = 1024;

/// Destination and source.
const ADDRESSES_BYTES: usize = 12;

/// Which port leads to which address. `Port` names a port.
#[derive(Debug)]
pub struct Switch<Port> {
    table: HashMap<[u8; 6], Port>,
}

/// Where a frame goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Forward<Port> {
    /// To this port.
    To(Port),
    /// To every port but the one it came from.
    Flood,
    /// Nowhere: it is too short to have addresses, or came from the port it leads to.
    Nowhere,
}

impl<Port: Copy + PartialEq> Switch<Port> {
    /// A switch that knows no address.
    #[must_use]
    pub fn new() -> Self {
        Self {
            table: HashMap::with_capacity(64),
        }
    }

    /// Learns the source of a frame that came in at a port, and says where the frame goes.
    pub fn forward(&mut self, from: Port, frame: &[u8]) -> Forward<Port> {
        let Some(&[d0, d1, d2, d3, d4, d5, s0, s1, s2, s3, s4, s5]) = frame.first_chunk::<ADDRESSES_BYTES>()
        else {
            return Forward::Nowhere;
        };
        self.learn([s0, s1, s2, s3, s4, s5], from);
        let destination = [d0, d1, d2, d3, d4, d5];
        if is_group(destination) {
            return Forward::Flood;
        }
        match self.table.get(&destination) {
            None => Forward::Flood,
            Some(port) if *port == from => Forward::Nowhere,
            Some(port) => Forward::To(*port),
        }
    }

    fn learn(&mut self, source: [u8; 6], port: Port) {
        let known = self.table.contains_key(&source);
        if !is_group(source) && (known || self.table.len() < TABLE_LIMIT) {
            self.table.insert(source, port);
        }
    }
}

impl<Port: Copy + PartialEq> Default for Switch<Port> {
    fn default() -> Self {
        Self::new()
    }
}

/// Whether an address is a multicast or the broadcast address.
fn is_group(address: [u8; 6]) -> bool {
    address[0] & 1 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: [u8; 6] = [0, 0, 0, 0, 0, 1];
    const B: [u8; 6] = [0, 0, 0, 0, 0, 2];
    const BROADCAST: [u8; 6] = [0xff; 6];
    const IPV6_MULTICAST: [u8; 6] = [0x33, 0x33, 0, 0, 0, 1];

    fn frame(destination: [u8; 6], source: [u8; 6]) -> Vec<u8> {
        [&destination[..], &source[..], &[0x08, 0x00, 1, 2, 3]].concat()
    }

    #[test]
    fn a_frame_to_an_unknown_address_is_flooded() {
        assert_eq!(Switch::new().forward(1, &frame(B, A)), Forward::Flood);
    }

    #[test]
    fn a_frame_to_an_address_seen_before_goes_to_its_port_alone() {
        let mut switch = Switch::new();
        switch.forward(1, &frame(B, A));
        assert_eq!(switch.forward(2, &frame(A, B)), Forward::To(1));
        assert_eq!(switch.forward(1, &frame(B, A)), Forward::To(2));
    }

    #[rstest::rstest]
    #[case(BROADCAST)]
    #[case(IPV6_MULTICAST)]
    fn group_addresses_are_flooded_and_never_learnt(#[case] group: [u8; 6]) {
        let mut switch = Switch::new();
        switch.forward(1, &frame(A, group));
        assert_eq!(switch.forward(2, &frame(group, B)), Forward::Flood);
    }

    #[test]
    fn a_frame_never_goes_back_where_it_came_from() {
        let mut switch = Switch::new();
        switch.forward(1, &frame(B, A));
        assert_eq!(switch.forward(1, &frame(A, B)), Forward::Nowhere);
    }

    #[test]
    fn a_host_that_moves_is_found_at_its_new_port() {
        let mut switch = Switch::new();
        switch.forward(1, &frame(B, A));
        switch.forward(3, &frame(B, A));
        assert_eq!(switch.forward(2, &frame(A, B)), Forward::To(3));
    }

    #[test]
    fn a_runt_goes_nowhere() {
        assert_eq!(Switch::new().forward(1, &[0xff; 11]), Forward::Nowhere);
    }

    #[test]
    fn made_up_addresses_fill_the_table_only_so_far_and_push_nobody_out() {
        let mut switch = Switch::new();
        switch.forward(1, &frame(B, A));
        for number in 0..5000_u32 {
            let [b0, b1, b2, b3] = number.to_be_bytes();
            switch.forward(2, &frame(B, [2, 0, b0, b1, b2, b3]));
        }
        assert_eq!(switch.table.len(), TABLE_LIMIT);
        assert_eq!(switch.forward(3, &frame(A, B)), Forward::To(1));
    }
}
