//! Where a master or node listens, from its URI. The main function is [`resolve`].
//!
//! `getaddrinfo` is left alone: in a static binary it loads the system's libraries behind the linker's back. Nodes of
//! ROS name themselves by number (`ROS_IP`), or by a name that `/etc/hosts` has; so those two are read.

use std::{
    fs,
    net::{Ipv4Addr, SocketAddrV4},
};

use super::RosError;

/// Host, port and path of an `http://` (or `rosrpc://`) URI.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Address {
    pub socket: SocketAddrV4,
    /// As the `Host` field wants it.
    pub authority: String,
    pub path: String,
}

/// Reads a URI; host names are looked up in `/etc/hosts`.
pub(super) fn resolve(uri: &str) -> Result<Address, RosError> {
    let read = || parse(uri, &fs::read_to_string("/etc/hosts").unwrap_or_default());
    read().ok_or_else(|| RosError::BadUri { uri: uri.to_owned() })
}

fn parse(uri: &str, hosts: &str) -> Option<Address> {
    let rest = uri.strip_prefix("http://")?;
    let (authority, path) = rest.split_at(rest.find('/').unwrap_or(rest.len()));
    let (host, port) = authority.rsplit_once(':')?;
    let port = port.parse().ok().filter(|port| *port != 0)?;
    let writable = |text: &str| text.bytes().all(|byte| byte.is_ascii_graphic());
    if !writable(authority) || !writable(path) {
        return None;
    }
    Some(Address {
        socket: SocketAddrV4::new(find_host(host, hosts)?, port),
        authority: authority.to_owned(),
        path: if path.is_empty() {
            "/".to_owned()
        } else {
            path.to_owned()
        },
    })
}

/// The IPv4 address of a host.
pub(super) fn resolve_host(host: &str) -> Option<Ipv4Addr> {
    find_host(host, &fs::read_to_string("/etc/hosts").unwrap_or_default())
}

fn find_host(host: &str, hosts: &str) -> Option<Ipv4Addr> {
    if let Ok(address) = host.parse() {
        return Some(address);
    }
    let lines = hosts.lines().filter_map(|line| line.split('#').next());
    let mut named = lines.filter_map(|line| {
        let mut words = line.split_whitespace();
        let address = words.next()?.parse().ok()?;
        words
            .any(|name| name.eq_ignore_ascii_case(host))
            .then_some(address)
    });
    named.next().or_else(|| {
        host.eq_ignore_ascii_case("localhost")
            .then_some(Ipv4Addr::LOCALHOST)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOSTS: &str = "# comment\n::1 h1\n10.0.0.1\th1 master # h2\n";

    #[rstest::rstest]
    #[case("http://10.0.0.2:40001/", "10.0.0.2:40001")]
    #[case("http://10.0.0.2:40001", "10.0.0.2:40001")]
    #[case("http://Master:11311/", "10.0.0.1:11311")]
    #[case("http://localhost:1/", "127.0.0.1:1")]
    fn a_uri_names_an_address(#[case] uri: &str, #[case] address: SocketAddrV4) {
        assert_eq!(parse(uri, HOSTS).unwrap().socket, address);
    }

    #[rstest::rstest]
    #[case("https://10.0.0.1:1/")]
    #[case("http://10.0.0.1/")]
    #[case("http://10.0.0.1:0/")]
    #[case("http://10.0.0.1:66000/")]
    #[case("http://h2:11311/")]
    #[case("http://10.0.0.1:1/\r\nX: y")]
    #[case("")]
    fn what_names_none_is_refused(#[case] uri: &str) {
        assert_eq!(parse(uri, HOSTS), None);
    }
}
