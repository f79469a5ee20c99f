//! The checksums of FFV1's slices (RFC 9043, 4.9): libav's decoder fills a slice whose checksum differs from the
//! previous picture, without reporting it.
//!
//! In: the configuration record of the stream, and its packets. Out: whether all slices of a packet are intact. What
//! this cannot detect: anything, in streams without checksums (versions 0 and 1, or `-slicecrc 0`).

/// Where a slice ends: its size in 3 bytes, its state in 1, its checksum in 4.
const TRAILER: usize = 8;
/// States of a symbol.
const CONTEXT: usize = 32;

/// Whether slices have checksums, from the stream's configuration record; `None` when it cannot be parsed.
pub(super) fn has_checksums(configuration: &[u8]) -> Option<bool> {
    let mut coder = RangeDecoder::new(configuration.get(..configuration.len().checked_sub(4)?)?)?;
    let mut state = [128; CONTEXT];
    let version = coder.unsigned(&mut state)?;
    if version < 3 {
        return Some(false);
    }
    let minor = coder.unsigned(&mut state)?;
    // The coder's own state transitions.
    if coder.unsigned(&mut state)? == 2 {
        for _ in 1..256 {
            coder.symbol(&mut state, true)?;
        }
    }
    let _ = (minor, coder.unsigned(&mut state)?, coder.unsigned(&mut state)?); // colours, bits
    coder.bit(state.first_mut()?); // chroma planes
    let _ = (coder.unsigned(&mut state)?, coder.unsigned(&mut state)?); // subsampling
    coder.bit(state.first_mut()?); // transparency
    let _ = (coder.unsigned(&mut state)?, coder.unsigned(&mut state)?); // slices
    let tables = coder.unsigned(&mut state)?;
    if !(1..=8).contains(&tables) {
        return None;
    }
    let contexts: Vec<u32> = (0..tables).map(|_| coder.quantization()).collect::<Option<_>>()?;
    let mut own = [[128; CONTEXT]; CONTEXT];
    for count in contexts {
        if coder.bit(state.first_mut()?) {
            for _ in 0..count {
                for state in &mut own {
                    coder.symbol(state, true)?;
                }
            }
        }
    }
    Some(coder.unsigned(&mut state)? != 0)
}

/// Whether all slices of `packet`, from a stream with checksums, are intact.
pub(super) fn is_sound(packet: &[u8]) -> bool {
    let mut rest = packet;
    while !rest.is_empty() {
        let Some([a, b, c, ..]) = rest.len().checked_sub(TRAILER).and_then(|at| rest.get(at..)) else { return false };
        let size = u32::from_be_bytes([0, *a, *b, *c]) as usize + TRAILER;
        let Some(start) = rest.len().checked_sub(size) else { return false };
        if checksum(rest.get(start..).unwrap_or_default()) != 0 {
            return false;
        }
        rest = rest.get(..start).unwrap_or_default();
    }
    !packet.is_empty()
}

/// CRC-32 with the polynomial 0x04C11DB7, highest bit first, from 0: 0 over data and their own checksum.
fn checksum(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0; 256];
        let mut i = 0;
        while i < 256 {
            let mut crc = (i as u32) << 24;
            let mut bit = 0;
            while bit < 8 {
                crc = if crc & 0x8000_0000 == 0 { crc << 1 } else { (crc << 1) ^ 0x04C1_1DB7 };
                bit += 1;
            }
            table[i] = crc;
            i += 1;
        }
        table
    };
    bytes.iter().fold(0, |crc, byte| {
        let index = (crc >> 24) as u8 ^ byte;
        (crc << 8) ^ TABLE.get(usize::from(index)).copied().unwrap_or(0)
    })
}

/// The range decoder of RFC 9043, 3.8.1, with the default state transitions.
struct RangeDecoder<'a> {
    bytes: std::slice::Iter<'a, u8>,
    low: u32,
    range: u32,
    one: [u8; 256],
}

impl<'a> RangeDecoder<'a> {
    fn new(bytes: &'a [u8]) -> Option<Self> {
        let [a, b, rest @ ..] = bytes else { return None };
        let low = u32::from(u16::from_be_bytes([*a, *b])).min(0xFF00);
        Some(Self { bytes: rest.iter(), low, range: 0xFF00, one: transitions() })
    }

    fn bit(&mut self, state: &mut u8) -> bool {
        let at = |index: u8, of: &[u8; 256]| of.get(usize::from(index)).copied().unwrap_or(0);
        let part = (self.range * u32::from(*state)) >> 8;
        self.range -= part;
        let bit = self.low >= self.range;
        *state = if bit {
            self.low -= self.range;
            self.range = part;
            at(*state, &self.one)
        } else {
            // A zero in this state equals a one in the opposite state.
            0u8.wrapping_sub(at(0u8.wrapping_sub(*state), &self.one))
        };
        if self.range < 0x100 {
            self.range <<= 8;
            self.low = (self.low << 8) | self.bytes.next().map_or(0, |byte| u32::from(*byte));
        }
        bit
    }

    fn symbol(&mut self, state: &mut [u8; CONTEXT], signed: bool) -> Option<i64> {
        if self.bit(state.first_mut()?) {
            return Some(0);
        }
        let mut exponent = 0;
        while self.bit(state.get_mut(1 + exponent.min(9))?) {
            exponent += 1;
            if exponent > 31 {
                return None;
            }
        }
        let mut value = 1_i64;
        for k in (0..exponent).rev() {
            value = 2 * value + i64::from(self.bit(state.get_mut(22 + k.min(9))?));
        }
        let negative = signed && self.bit(state.get_mut(11 + exponent.min(10))?);
        Some(if negative { -value } else { value })
    }

    fn unsigned(&mut self, state: &mut [u8; CONTEXT]) -> Option<u32> {
        u32::try_from(self.symbol(state, false)?).ok()
    }

    /// Skips the five tables of a set; returns the number of their contexts.
    fn quantization(&mut self) -> Option<u32> {
        let mut count = 1_u32;
        for _ in 0..5 {
            let mut state = [128; CONTEXT];
            let (mut filled, mut values) = (0, 0);
            while filled < 128 {
                let run = self.unsigned(&mut state)?.checked_add(1)?;
                if run > 128 - filled {
                    return None;
                }
                filled += run;
                values += 1;
            }
            count = count.checked_mul(2 * values - 1).filter(|count| *count <= 32_768)?;
        }
        Some(count.div_ceil(2))
    }
}

/// For each state, the state that follows a one.
fn transitions() -> [u8; 256] {
    const ONE: i64 = 1 << 32;
    const FACTOR: i64 = (0.05 * (1_u64 << 32) as f64) as i64;
    const MAX_STATE: i64 = 256 - 8;
    let next = |p: i64| p + (((ONE - p) as i128 * FACTOR as i128 + (ONE / 2) as i128) >> 32) as i64;
    let mut one = [0_u8; 256];
    let mut set = |at: i64, value: i64| {
        if let Some(place) = usize::try_from(at).ok().and_then(|at| one.get_mut(at))
            && *place == 0
        {
            *place = value as u8;
        }
    };
    let (mut last, mut p) = (0, ONE / 2);
    for _ in 0..128 {
        let state = ((256 * p + ONE / 2) >> 32).max(last + 1);
        if last != 0 && last < 256 && state <= MAX_STATE {
            set(last, state);
        }
        p = next(p);
        last = state;
    }
    for state in 256 - MAX_STATE..=MAX_STATE {
        let p = next((state * ONE + 128) >> 8);
        set(state, ((256 * p + ONE / 2) >> 32).max(state + 1).min(MAX_STATE));
    }
    one
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_over_data_and_their_checksum_is_zero() {
        let mut data = b"a slice of a picture".to_vec();
        let crc = checksum(&data);
        data.extend(crc.to_be_bytes());
        assert_eq!(checksum(&data), 0);
        data[3] ^= 1;
        assert_ne!(checksum(&data), 0);
    }

    /// Two slices, each with its size and checksum.
    fn packet() -> Vec<u8> {
        let mut packet = Vec::new();
        for content in [&b"the upper half"[..], b"and the lower"] {
            let start = packet.len();
            packet.extend(content);
            packet.extend((content.len() as u32).to_be_bytes().into_iter().skip(1));
            packet.push(0);
            let crc = checksum(&packet[start..]);
            packet.extend(crc.to_be_bytes());
        }
        packet
    }

    #[test]
    fn a_single_bit_in_any_slice_is_noticed() {
        let sound = packet();
        assert!(is_sound(&sound));
        for bit in 0..8 * sound.len() {
            let mut damaged = sound.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(!is_sound(&damaged), "bit {bit}");
        }
        for length in 0..sound.len() {
            assert!(!is_sound(&sound[..length]) || length == 22, "{length}");
        }
    }

    #[test]
    fn what_is_no_configuration_is_not_understood() {
        for bytes in [&b""[..], b"abc", &[0; 12], &[255; 40]] {
            assert_ne!(has_checksums(bytes), Some(true), "{bytes:?}");
        }
    }
}
