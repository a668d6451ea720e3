//! `std_msgs/Float64MultiArray`: a row of doubles whose one dimension is labelled with the names of its fields, so
//! that `rostopic echo` explains itself. The main types are [`Encoder`] and [`decode`]; neither allocates while it
//! works, as both are called from real-time loops.
//!
//! Source: the definition in Debian's `libstd-msgs-dev` and the serialization rules of
//! <http://wiki.ros.org/roscpp/Overview/MessagesSerializationAndAdaptingTypes> (little endian, lengths of 32 bits).

use super::message_type::MessageType;

/// The type as its publishers announce it.
pub const MESSAGE_TYPE: MessageType = MessageType {
    name: "std_msgs/Float64MultiArray",
    md5sum: "4b7d974086d4060e7db4613a7e6c3ba4",
    definition: include_str!("float64_multi_array.txt"),
};

/// Why bytes are not a message of the wanted number of values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The message ends before what its lengths promise.
    #[error("the message of {length} bytes ends before its {part}")]
    TooShort {
        /// Bytes in the message.
        length: usize,
        /// What should have come.
        part: &'static str,
    },
    /// Another number of values than this topic carries.
    #[error("the message has {found} values, not {wanted}")]
    WrongCount {
        /// Values in the message.
        found: usize,
        /// Values of this topic.
        wanted: usize,
    },
    /// More bytes than its lengths account for.
    #[error("{surplus} bytes follow the message's last value")]
    TooLong {
        /// Bytes that nothing accounts for.
        surplus: usize,
    },
}

/// Writes messages of `N` values into one buffer that is made beforehand.
#[derive(Debug, Clone)]
pub struct Encoder<const N: usize> {
    /// The whole message: everything before the values never changes.
    message: Vec<u8>,
    values_at: usize,
}

impl<const N: usize> Encoder<N> {
    /// An encoder for values of these names, units included, such as `x_m`.
    #[must_use]
    pub fn new(field_names: [&str; N]) -> Self {
        let label = field_names.join(" ");
        let count = N as u32;
        let mut message = Vec::with_capacity(28 + label.len() + 8 * N);
        let mut put = |number: u32| message.extend_from_slice(&number.to_le_bytes());
        put(1); // dimensions
        put(label.len() as u32);
        message.extend_from_slice(label.as_bytes());
        let mut put = |number: u32| message.extend_from_slice(&number.to_le_bytes());
        put(count); // size of the dimension
        put(count); // its stride
        put(0); // data_offset
        put(count); // length of data
        let values_at = message.len();
        message.resize(values_at + 8 * N, 0);
        Self { message, values_at }
    }

    /// The message with these values. Does not allocate.
    pub fn encode(&mut self, values: &[f64; N]) -> &[u8] {
        let places = self.message.iter_mut().skip(self.values_at);
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        for (place, byte) in places.zip(bytes) {
            *place = byte;
        }
        &self.message
    }
}

/// The values of a message, whatever its layout says about their names. Does not allocate.
///
/// # Errors
/// [`DecodeError`] if the lengths lie or the number of values is not `N`.
pub fn decode<const N: usize>(message: &[u8]) -> Result<[f64; N], DecodeError> {
    let mut rest = Rest { message, at: 0 };
    let dimensions = rest.number("number of dimensions")?;
    for _ in 0..dimensions {
        let label = rest.number("label's length")?;
        rest.bytes(label as usize, "label")?;
        rest.bytes(8, "size and stride")?;
    }
    rest.number("data offset")?;
    let count = rest.number("number of values")? as usize;
    if count != N {
        return Err(DecodeError::WrongCount {
            found: count,
            wanted: N,
        });
    }
    let data = rest.bytes(8 * N, "values")?;
    let surplus = message.len() - rest.at;
    if surplus != 0 {
        return Err(DecodeError::TooLong { surplus });
    }
    let mut values = [0.0; N];
    for (value, bytes) in values.iter_mut().zip(data.chunks_exact(8)) {
        *value = f64::from_le_bytes(bytes.try_into().unwrap_or_default());
    }
    Ok(values)
}

/// What is left to read of a message.
struct Rest<'a> {
    message: &'a [u8],
    at: usize,
}

impl<'a> Rest<'a> {
    fn bytes(&mut self, count: usize, part: &'static str) -> Result<&'a [u8], DecodeError> {
        let too_short = DecodeError::TooShort {
            length: self.message.len(),
            part,
        };
        let end = self.at.checked_add(count).ok_or(too_short)?;
        let bytes = self.message.get(self.at..end).ok_or(too_short)?;
        self.at = end;
        Ok(bytes)
    }

    fn number(&mut self, part: &'static str) -> Result<u32, DecodeError> {
        let bytes = self.bytes(4, part)?;
        Ok(u32::from_le_bytes(bytes.try_into().unwrap_or_default()))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// As Debian's rospy 1.15.15 serializes `Float64MultiArray` with one dimension ("a b", 2, 2) and data [1.5, -2].
    const FROM_ROSPY: &[u8] = b"\x01\0\0\0\x03\0\0\0a b\x02\0\0\0\x02\0\0\0\0\0\0\0\x02\0\0\0\
        \0\0\0\0\0\0\xf8?\0\0\0\0\0\0\0\xc0";

    #[test]
    fn a_message_is_encoded_as_rospy_does() {
        assert_eq!(Encoder::new(["a", "b"]).encode(&[1.5, -2.0]), FROM_ROSPY);
    }

    #[test]
    fn a_message_of_rospy_is_decoded() {
        assert_eq!(decode::<2>(FROM_ROSPY), Ok([1.5, -2.0]));
    }

    #[test]
    fn a_message_without_a_layout_is_decoded() {
        let mut bytes = [0_u8; 20];
        bytes[8] = 1;
        bytes[12..].copy_from_slice(&3.25_f64.to_le_bytes());
        assert_eq!(decode::<1>(&bytes), Ok([3.25]));
    }

    #[test]
    fn another_number_of_values_is_refused() {
        assert_eq!(
            decode::<3>(FROM_ROSPY),
            Err(DecodeError::WrongCount { found: 2, wanted: 3 })
        );
    }

    #[rstest::rstest]
    #[case::dimensions(0)]
    #[case::label(4)]
    #[case::values(23)]
    fn a_length_that_lies_is_refused(#[case] at: usize) {
        let mut bytes = FROM_ROSPY.to_vec();
        bytes[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(decode::<2>(&bytes).is_err());
    }

    #[test]
    fn bytes_after_the_last_value_are_refused() {
        let mut bytes = FROM_ROSPY.to_vec();
        bytes.push(0);
        assert_eq!(decode::<2>(&bytes), Err(DecodeError::TooLong { surplus: 1 }));
    }

    #[test]
    fn a_message_cut_anywhere_is_refused() {
        for length in 0..FROM_ROSPY.len() {
            assert!(
                decode::<2>(&FROM_ROSPY[..length]).is_err(),
                "cut to {length} bytes"
            );
        }
    }

    proptest! {
        #[test]
        fn all_values_arrive_to_the_bit(values: [u64; 5]) {
            let values = values.map(f64::from_bits);
            let mut encoder = Encoder::new(["seq", "stamp_s", "x_m", "y_m", "z_m"]);
            let decoded = decode::<5>(encoder.encode(&values)).unwrap();
            prop_assert_eq!(decoded.map(f64::to_bits), values.map(f64::to_bits));
        }

        #[test]
        fn no_bytes_make_the_decoder_panic(bytes: Vec<u8>) {
            let _ = decode::<3>(&bytes);
        }
    }
}
