//! `std_msgs/String`: a text. The functions are [`encode`] and [`decode`]; neither allocates while it works.
//!
//! Source: as for [`super::float64_multi_array`].

use super::message_type::MessageType;

/// The type as its publishers announce it.
pub const MESSAGE_TYPE: MessageType = MessageType {
    name: "std_msgs/String",
    md5sum: "992ce8a1687cec8c8bd883ec73ca41d1",
    definition: "string data\n",
};

/// How many bytes the text's length takes.
const PREFIX: usize = 4;

/// Makes `message` the message of the text that `write` appends. It grows only if it has not the capacity.
pub fn encode(message: &mut Vec<u8>, write: impl FnOnce(&mut Vec<u8>)) {
    message.clear();
    message.extend_from_slice(&[0; PREFIX]);
    write(message);
    let length = u32::try_from(message.len() - PREFIX).unwrap_or(u32::MAX);
    if let Some(prefix) = message.get_mut(..PREFIX) {
        prefix.copy_from_slice(&length.to_le_bytes());
    }
}

/// The text of a message; none if its length lies or it is no UTF-8.
#[must_use]
pub fn decode(message: &[u8]) -> Option<&str> {
    let (length, text) = message.split_first_chunk::<PREFIX>()?;
    let length = usize::try_from(u32::from_le_bytes(*length)).ok()?;
    std::str::from_utf8(text).ok().filter(|text| text.len() == length)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_text_is_encoded_as_rospy_does() {
        let mut message = Vec::new();
        encode(&mut message, |text| text.extend_from_slice(b"[0.1]"));
        // `std_msgs.msg.String("[0.1]").serialize` of Debian's rospy 1.15.15.
        assert_eq!(message, b"\x05\0\0\0[0.1]");
    }

    proptest! {
        #[test]
        fn a_text_arrives_as_it_was_sent(text: String) {
            let mut message = Vec::new();
            encode(&mut message, |bytes| bytes.extend_from_slice(text.as_bytes()));
            prop_assert_eq!(decode(&message), Some(text.as_str()));
            prop_assert_eq!(decode(&message[..message.len() - 1]), None);
        }

        #[test]
        fn no_bytes_make_the_decoder_panic(bytes: Vec<u8>) {
            let _ = decode(&bytes);
        }
    }
}
