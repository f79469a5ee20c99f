//! The Huffman codes of a sequential scan (ITU-T T.81, F.2.2), and the bits that they are read from.

const EXCESS_DATA: &str = "there is more coded picture than the picture has blocks";
const RESTART: std::ops::RangeInclusive<u8> = 0xd0..=0xd7;
/// Coefficients of 8-bit samples are smaller, apart from rounding.
const LARGEST_COEFFICIENT: i32 = 1200;
/// Most bits of a difference of means of 8-bit samples.
const MOST_DIRECT_BITS: u8 = 11;
/// Codes of up to so many bits are looked up at once, with their value if it is within them too.
const LOOKED_UP: u32 = 10;
/// Bits of the longest code, and of the value after it.
const MOST_BITS: i32 = 16 + 15;

/// What can be wrong with a block's codes: small, because it is asked for after each.
#[derive(Debug, Clone, Copy)]
pub(super) enum Fault {
    EndsEarly,
    NoCode,
    TooMany,
    OutOfRange,
}

impl From<Fault> for &'static str {
    fn from(fault: Fault) -> Self {
        match fault {
            Fault::EndsEarly => "the coded picture ends early",
            Fault::NoCode => "there is a code that no table has",
            Fault::TooMany => "a block has too many coefficients",
            Fault::OutOfRange => "there are samples out of range",
        }
    }
}

/// A table of codes.
pub(super) struct Table {
    /// By the next bits.
    short: Box<[Entry; 1 << LOOKED_UP]>,
    /// For each length from 1, the first code and the values of all codes.
    long: Vec<(u32, Vec<u8>)>,
}

/// What the next bits mean.
#[derive(Clone, Copy, Default)]
struct Entry {
    /// Bits of the code, and of the value if there is one; 0 if the code is longer than these bits, or there is none.
    length: u8,
    symbol: u8,
    /// The value after the code, if all its bits are within these; else 0.
    value: i16,
}

impl Table {
    /// A table by the number of codes of each length, and their symbols.
    pub(super) fn new(counts: &[u8; 16], symbols: &[u8]) -> Option<Self> {
        let mut table = Self { short: Box::new([Entry::default(); _]), long: Vec::with_capacity(16) };
        let (mut code, mut symbols) = (0_u32, symbols.iter());
        for (length, count) in (1_u32..).zip(counts) {
            let these: Vec<u8> = symbols.by_ref().take(usize::from(*count)).copied().collect();
            if let Some(after) = LOOKED_UP.checked_sub(length) {
                for (k, symbol) in (code..).zip(&these) {
                    let size = u32::from(symbol & 15);
                    let from = (k << after) as usize;
                    for (rest, entry) in (0_u32..).zip(table.short.get_mut(from..from + (1 << after))?) {
                        let (length, value) = match after.checked_sub(size) {
                            Some(unused) => (length + size, signed(rest >> unused, size)),
                            None => (length, 0),
                        };
                        *entry = Entry { length: length as u8, symbol: *symbol, value: value as i16 };
                    }
                }
            }
            let after = code + these.len() as u32;
            if after > 1 << length {
                return None;
            }
            table.long.push((code, these));
            code = after << 1;
        }
        Some(table)
    }

    /// The next code, and the value of the bits after it: as many as its lower half says. Whether there were so many
    /// bits is asked after the block.
    #[inline(always)]
    fn next(&self, bits: &mut Bits<'_>) -> Result<(u8, i32), Fault> {
        if bits.count < MOST_BITS {
            bits.fill();
        }
        let Entry { length, symbol, value } = self.short[bits.next(LOOKED_UP) as usize];
        bits.skip(length.into());
        if value != 0 {
            return Ok((symbol, value.into()));
        }
        let symbol = if length > 0 { symbol } else { self.next_long(bits)? };
        let size = u32::from(symbol & 15);
        if size == 0 {
            return Ok((symbol, 0));
        }
        let value = signed(bits.next(size), size);
        bits.skip(size);
        Ok((symbol, value))
    }

    /// The next code, longer than those that are looked up.
    #[cold]
    fn next_long(&self, bits: &mut Bits<'_>) -> Result<u8, Fault> {
        for (length, (first, symbols)) in (1..).zip(&self.long).skip(LOOKED_UP as usize) {
            let index = bits.next(length).checked_sub(*first);
            if let Some(symbol) = index.and_then(|k| symbols.get(k as usize)) {
                bits.skip(length);
                return Ok(*symbol);
            }
        }
        Err(Fault::NoCode)
    }
}

/// The value of `size` bits: the upper half of them is positive (T.81, F.2.2.1). None is zero.
fn signed(bits: u32, size: u32) -> i32 {
    let most = (1 << size) - 1;
    if 2 * bits > most { bits as i32 } else { bits as i32 - most as i32 }
}

/// The bits of a scan.
pub(super) struct Bits<'a> {
    rest: &'a [u8],
    /// The next bits, from the highest; zeros after them.
    held: u64,
    /// How many; negative if more were skipped than there were.
    count: i32,
}

impl<'a> Bits<'a> {
    pub(super) fn new(rest: &'a [u8]) -> Self {
        Self { rest, held: 0, count: 0 }
    }

    /// Reads bytes, up to a marker.
    #[inline]
    fn fill(&mut self) {
        if let Some(eight) = self.rest.first_chunk()
            && !eight.contains(&0xff)
        {
            // Those that find room.
            let bytes = (64 - self.count) / 8;
            if bytes > 0 {
                let unused = 64 - 8 * bytes;
                self.held |= u64::from_be_bytes(*eight) >> unused << unused >> self.count;
                self.count += 8 * bytes;
                self.rest = self.rest.get(bytes as usize..).unwrap_or_default();
            }
            return;
        }
        while self.count <= 56 {
            let byte = match self.rest {
                [0xff, 0, rest @ ..] => {
                    self.rest = rest;
                    0xff
                }
                [0xff, ..] | [] => return,
                [byte, rest @ ..] => {
                    self.rest = rest;
                    *byte
                }
            };
            self.held |= u64::from(byte) << (56 - self.count);
            self.count += 8;
        }
    }

    /// The next bits, 1 to 32 of them, zeros after the last.
    fn next(&self, count: u32) -> u32 {
        (self.held >> (64 - count)) as u32
    }

    fn skip(&mut self, count: u32) {
        self.count -= count as i32;
        self.held <<= count;
    }

    /// Skips restart marker number `index`.
    pub(super) fn restart(&mut self, index: usize) -> Result<(), &'static str> {
        const MISSING: &str = "a restart marker is missing";
        self.fill();
        if self.count >= 8 {
            return Err(MISSING);
        }
        match self.rest {
            [0xff, code, rest @ ..] if RESTART.contains(code) && usize::from(code & 7) == index % 8 => {
                *self = Self::new(rest);
                Ok(())
            }
            _ => Err(MISSING),
        }
    }

    /// The end of the scan: only padding may be left. Returns what follows.
    pub(super) fn end(mut self) -> Result<&'a [u8], &'static str> {
        // The padding of the last byte is ones (T.81, F.1.2.3), with some encoders zeros.
        let padding = |bits: u32, count: u32| bits == 0 || bits == (1 << count) - 1;
        loop {
            self.fill();
            if self.count == 0 {
                return Ok(self.rest);
            }
            let count = (self.count as u32 - 1) % 8 + 1;
            if !padding(self.next(count), count) {
                return Err(EXCESS_DATA);
            }
            self.skip(count);
        }
    }
}

/// How the blocks of a component are coded.
pub(super) struct BlockCoder<'a> {
    direct: &'a Table,
    others: &'a Table,
    /// Of each coefficient, in the order of the scan: its step, and the largest value that samples of 8 bits can have,
    /// apart from rounding. A damaged code can point beyond the 64th, where none but zero is possible.
    limits: [(i32, i32); 128],
    /// The mean of the block before.
    before: i32,
}

/// A block's coefficients that are not zero, multiplied by their steps.
pub(super) struct Block {
    pub mean: i32,
    /// Sum of the absolute values of the others.
    pub sum: u32,
    places: [u8; 64],
    values: [i32; 64],
    count: usize,
}

impl Block {
    pub(super) const EMPTY: Self = Self { mean: 0, sum: 0, places: [0; 64], values: [0; 64], count: 0 };

    /// Place in the order of the scan and value of all but the mean.
    pub(super) fn waves(&self) -> impl Iterator<Item = (usize, i32)> {
        self.places.iter().zip(&self.values).take(self.count).map(|(k, value)| (usize::from(*k), *value))
    }

    /// Of places and values in the order of the scan, the mean first.
    #[cfg(test)]
    pub(super) fn of(coefficients: &[(usize, i32)]) -> Self {
        let mut block = Self::EMPTY;
        for (k, value) in coefficients {
            if *k == 0 { block.clear(*value) } else { block.push(*k, *value) }
        }
        block
    }

    fn clear(&mut self, mean: i32) {
        (self.mean, self.sum, self.count) = (mean, 0, 0);
    }

    /// Adds one of the 63 others.
    fn push(&mut self, k: usize, value: i32) {
        // One for each place at most: `k` only grows.
        let at = self.count % 64;
        (self.places[at], self.values[at]) = (k as u8, value);
        self.count += 1;
        self.sum += value.unsigned_abs();
    }
}

impl<'a> BlockCoder<'a> {
    pub(super) fn new(direct: &'a Table, others: &'a Table, steps: &[i32; 64]) -> Self {
        let mut limits = [(0, 0); 128];
        for (limits, step) in limits.iter_mut().zip(steps) {
            *limits = (*step, LARGEST_COEFFICIENT / step.max(&1) + 1);
        }
        Self { direct, others, limits, before: 0 }
    }

    /// After a restart marker.
    pub(super) fn restart(&mut self) {
        self.before = 0;
    }

    /// Reads the next block.
    #[inline(always)]
    pub(super) fn read(&mut self, bits: &mut Bits<'_>, block: &mut Block) -> Result<(), Fault> {
        let result = self.coefficients(bits, block);
        if bits.count < 0 { Err(Fault::EndsEarly) } else { result }
    }

    #[inline(always)]
    fn coefficients(&mut self, bits: &mut Bits<'_>, block: &mut Block) -> Result<(), Fault> {
        let (size, difference) = self.direct.next(bits)?;
        if size > MOST_DIRECT_BITS {
            return Err(Fault::OutOfRange);
        }
        self.before += difference;
        let (step, largest) = self.limits[0];
        if self.before.abs() > largest {
            return Err(Fault::OutOfRange);
        }
        block.clear(self.before * step);
        let mut k = 1;
        while k < 64 {
            let (code, value) = self.others.next(bits)?;
            if value == 0 {
                if code >> 4 != 15 {
                    return Ok(());
                }
                k += 16;
                continue;
            }
            k += usize::from(code >> 4);
            let (step, largest) = self.limits[k % 128];
            if value.abs() > largest {
                return Err(if k < 64 { Fault::OutOfRange } else { Fault::TooMany });
            }
            block.push(k, value * step);
            k += 1;
        }
        if k > 64 { Err(Fault::TooMany) } else { Ok(()) }
    }
}
