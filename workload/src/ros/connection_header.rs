//! The header with which a TCPROS connection begins, both ways. Pure. The main type is [`ConnectionHeader`].
//!
//! Source: <http://wiki.ros.org/ROS/Connection%20Header>: a length of 32 bits, then fields, each a length of 32 bits
//! and `name=value`. It is framed as messages are, see [`super::frames`].

/// Fields of a connection header, in the order they came.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct ConnectionHeader {
    fields: Vec<(String, String)>,
}

/// Why bytes are not a connection header.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum HeaderError {
    #[error("its header ends within a field")]
    Cut,
    #[error("a field of its header has no `=`")]
    NoEquals,
    #[error("a field of its header is not UTF-8")]
    NotText,
    #[error("its header has no `{0}`")]
    Missing(&'static str),
}

impl ConnectionHeader {
    pub fn new<const N: usize>(fields: [(&str, &str); N]) -> Self {
        Self {
            fields: fields
                .map(|(name, value)| (name.to_owned(), value.to_owned()))
                .into(),
        }
    }

    /// Reads a header, without the length before it.
    pub fn parse(mut bytes: &[u8]) -> Result<Self, HeaderError> {
        let mut fields = Vec::new();
        while !bytes.is_empty() {
            let (length, rest) = bytes.split_first_chunk::<4>().ok_or(HeaderError::Cut)?;
            let length = u32::from_le_bytes(*length) as usize;
            let (field, rest) = rest.split_at_checked(length).ok_or(HeaderError::Cut)?;
            let field = std::str::from_utf8(field).map_err(|_| HeaderError::NotText)?;
            let (name, value) = field.split_once('=').ok_or(HeaderError::NoEquals)?;
            fields.push((name.to_owned(), value.to_owned()));
            bytes = rest;
        }
        Ok(Self { fields })
    }

    /// As it goes over the wire, with the length before it.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut body = Vec::new();
        for (name, value) in &self.fields {
            let length = (name.len() + 1 + value.len()) as u32;
            body.extend_from_slice(&length.to_le_bytes());
            body.extend_from_slice(name.as_bytes());
            body.push(b'=');
            body.extend_from_slice(value.as_bytes());
        }
        let mut bytes = (body.len() as u32).to_le_bytes().to_vec();
        bytes.append(&mut body);
        bytes
    }

    pub fn get(&self, name: &str) -> Option<&str> {
        self.fields
            .iter()
            .find(|(field, _)| field == name)
            .map(|(_, value)| value.as_str())
    }

    pub fn require(&self, name: &'static str) -> Result<&str, HeaderError> {
        self.get(name).ok_or(HeaderError::Missing(name))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_header_is_written_as_the_wiki_shows_it() {
        let header = ConnectionHeader::new([("message_definition", "string data\n"), ("latching", "1")]);
        let bytes = header.to_bytes();
        assert_eq!(bytes[..4], 49_u32.to_le_bytes());
        assert_eq!(
            &bytes[4..],
            b"\x1f\0\0\0message_definition=string data\n\n\0\0\0latching=1"
        );
    }

    #[rstest::rstest]
    #[case(b"\x05\0\0\0a=b", HeaderError::Cut)]
    #[case(b"\xff\xff\xff\xffa=b", HeaderError::Cut)]
    #[case(b"\x03\0", HeaderError::Cut)]
    #[case(b"\x03\0\0\0abc", HeaderError::NoEquals)]
    #[case(b"\x03\0\0\0a=\xff", HeaderError::NotText)]
    fn a_malformed_header_is_refused(#[case] bytes: &[u8], #[case] error: HeaderError) {
        assert_eq!(ConnectionHeader::parse(bytes), Err(error));
    }

    #[test]
    fn a_missing_field_is_named() {
        let header = ConnectionHeader::new([("topic", "/state")]);
        assert_eq!(header.require("topic"), Ok("/state"));
        assert_eq!(header.require("md5sum"), Err(HeaderError::Missing("md5sum")));
    }

    proptest! {
        #[test]
        fn every_header_is_read_back_as_it_was_written(
            fields in proptest::collection::vec(("[a-z_]{1,12}", "(?s).{0,30}"), 0..8),
        ) {
            let header = ConnectionHeader { fields };
            prop_assert_eq!(ConnectionHeader::parse(&header.to_bytes()[4..]), Ok(header));
        }

        #[test]
        fn a_header_that_was_tampered_with_is_read_or_refused_and_holds_no_more_than_it_was(
            fields in proptest::collection::vec(("[a-z_]{1,12}", "(?s).{0,30}"), 1..8),
            changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..4),
        ) {
            let mut bytes = ConnectionHeader { fields }.to_bytes().split_off(4);
            for (place, byte) in changes {
                *place.get_mut(&mut bytes) = byte;
            }
            if let Ok(header) = ConnectionHeader::parse(&bytes) {
                let held = header.fields.iter().map(|(name, value)| name.len() + value.len());
                prop_assert!(held.sum::<usize>() < bytes.len());
            }
        }

        #[test]
        fn no_bytes_make_it_panic(bytes: Vec<u8>) {
            let _ = ConnectionHeader::parse(&bytes);
        }
    }
}
