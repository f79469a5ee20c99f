//! Whether a JPEG picture is complete: decoders silently fill in what is missing or damaged.
//!
//! The codes of a sequential picture (ITU-T T.81) are parsed without decoding samples: every code must exist, every
//! block must be possible for 8-bit samples, the mean brightness may not step in the middle of a row, and the data must
//! end with the last block. More than half of all changed bits are detected: after a changed bit the codes are read out
//! of step. What this cannot detect: a changed bit that leaves the codes in step, which changes one coefficient;
//! anything in progressive and arithmetic-coded pictures.

mod samples;
mod steps;

use samples::Samples;
use steps::has_step;

const START_OF_IMAGE: [u8; 2] = [0xff, 0xd8];
const HUFFMAN: u8 = 0xc4;
const QUANTIZATION: u8 = 0xdb;
const RESTART_INTERVAL: u8 = 0xdd;
const START_OF_SCAN: u8 = 0xda;
const RESTART: std::ops::RangeInclusive<u8> = 0xd0..=0xd7;
const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];
/// Coefficients of 8-bit samples are smaller, apart from rounding.
const LARGEST_COEFFICIENT: i32 = 1200;
const EXCESS_DATA: &str = "there is more coded picture than the picture has blocks";
const OUT_OF_RANGE: &str = "there are samples out of range";

/// Whether it is a JPEG without an end marker. The marker cannot occur by chance in coded data (ITU-T T.81, B.1.1.5),
/// but it can in a thumbnail before it, so segments are skipped.
pub(crate) fn is_cut_off(bytes: &[u8]) -> bool {
    let Some(mut rest) = bytes.strip_prefix(&START_OF_IMAGE) else { return false };
    loop {
        match rest {
            [0xff, START_OF_SCAN, coded @ ..] => return !coded.windows(2).any(|two| two == END_OF_IMAGE),
            // Fill bytes.
            [0xff, next @ ..] if next.first() == Some(&0xff) => rest = next,
            [0xff, _, high, low, ..] => {
                let length = 2 + usize::from(u16::from_be_bytes([*high, *low]));
                let Some(next) = rest.get(length..) else { return true };
                rest = next;
            }
            // Not a segment: too short, or a JPEG that the decoder rejects, with its reason.
            _ => return rest.len() < 4,
        }
    }
}

/// What a JPEG picture's data tell.
pub(crate) struct Examined {
    /// What is wrong with its codes, if that can be told.
    pub damage: Option<&'static str>,
    /// Quantiser step for luma, stored units: RMS over the coefficients that represent bands and edges.
    pub step: Option<f64>,
}

/// Coefficients that count for the step, in stored order: all but the mean, up to four waves per block.
const COUNTED_COEFFICIENTS: std::ops::RangeInclusive<usize> = 1..=14;

/// Examines a JPEG picture; other files give an empty result.
pub(crate) fn examine(bytes: &[u8]) -> Examined {
    let mut picture = Picture::default();
    let damage = picture.read(bytes).err();
    Examined { damage, step: picture.step() }
}

/// Only the quantiser step, without parsing the codes.
#[cfg(target_os = "linux")]
pub(crate) fn step(bytes: &[u8]) -> Option<f64> {
    let scan = bytes.windows(2).position(|two| two == [0xff, START_OF_SCAN])?;
    let mut picture = Picture::default();
    picture.read(bytes.get(..scan)?).ok()?;
    picture.step()
}

/// What the segments before a scan define.
#[derive(Default)]
struct Picture {
    size_px: [usize; 2],
    components: Vec<Component>,
    quantization: [Option<[i32; 64]>; 4],
    direct: [Option<Table>; 4],
    others: [Option<Table>; 4],
    restart_every: usize,
}

#[derive(Clone, Copy)]
struct Component {
    id: u8,
    /// Blocks in an interleaved unit.
    sampling: [usize; 2],
    quantization: usize,
}

impl Picture {
    fn step(&self) -> Option<f64> {
        let luma = self.components.first().map_or(0, |component| component.quantization);
        let table = self.quantization.get(luma).copied().flatten()?;
        let squares: f64 = table[COUNTED_COEFFICIENTS].iter().map(|step| f64::from(*step).powi(2)).sum();
        Some((squares / COUNTED_COEFFICIENTS.count() as f64).sqrt())
    }

    /// Parses all scans; also `Ok` when nothing can be told.
    fn read(&mut self, bytes: &[u8]) -> Result<(), &'static str> {
        let Some(mut rest) = bytes.strip_prefix(&START_OF_IMAGE) else { return Ok(()) };
        loop {
            match rest {
                [0xff, next @ ..] if next.first() == Some(&0xff) => rest = next,
                [0xff, 0xd9, ..] => return Ok(()),
                [0xff, code, high, low, ..] => {
                    let length = 2 + usize::from(u16::from_be_bytes([*high, *low]));
                    let body = rest.get(4..length).ok_or("a segment is cut off")?;
                    rest = rest.get(length..).unwrap_or_default();
                    match *code {
                        HUFFMAN => self.huffman(body).ok_or("a table of codes is damaged")?,
                        QUANTIZATION => self.quantization(body).ok_or("a table of quantization is damaged")?,
                        0xc0 | 0xc1 => self.frame(body).ok_or("the head of the picture is damaged")?,
                        // Progressive, lossless, arithmetic: not examined.
                        0xc2..=0xcf if *code != 0xc8 && *code != 0xcc => return Ok(()),
                        RESTART_INTERVAL => {
                            let every = body.first_chunk().ok_or("a segment is cut off")?;
                            self.restart_every = u16::from_be_bytes(*every).into();
                        }
                        START_OF_SCAN => match self.scan(body, rest)? {
                            Some(next) => rest = next,
                            None => return Ok(()),
                        },
                        _ => {}
                    }
                }
                _ => return Ok(()),
            }
        }
    }

    fn huffman(&mut self, mut body: &[u8]) -> Option<()> {
        while let [class, rest @ ..] = body {
            let counts: &[u8; 16] = rest.first_chunk()?;
            let total: usize = counts.iter().map(|n| usize::from(*n)).sum();
            let values = rest.get(16..16 + total)?;
            let tables = if class >> 4 == 0 { &mut self.direct } else { &mut self.others };
            *tables.get_mut(usize::from(class & 15))? = Some(Table::new(counts, values)?);
            body = rest.get(16 + total..)?;
        }
        Some(())
    }

    fn quantization(&mut self, mut body: &[u8]) -> Option<()> {
        while let [kind, rest @ ..] = body {
            let wide = kind >> 4 != 0;
            let size = if wide { 128 } else { 64 };
            let values = rest.get(..size)?;
            let mut table = [0; 64];
            for (k, value) in table.iter_mut().enumerate() {
                *value = if wide {
                    i32::from(u16::from_be_bytes([*values.get(2 * k)?, *values.get(2 * k + 1)?]))
                } else {
                    i32::from(*values.get(k)?)
                };
            }
            *self.quantization.get_mut(usize::from(kind & 15))? = Some(table);
            body = rest.get(size..)?;
        }
        Some(())
    }

    fn frame(&mut self, body: &[u8]) -> Option<()> {
        let [_, h1, h0, w1, w0, count, rest @ ..] = body else { return None };
        let side = |high: &u8, low: &u8| usize::from(u16::from_be_bytes([*high, *low]));
        self.size_px = [side(w1, w0), side(h1, h0)];
        self.components.clear();
        for three in rest.chunks_exact(3).take(usize::from(*count)) {
            let [id, sampling, quantization] = three else { return None };
            let sampling = [usize::from(sampling >> 4), usize::from(sampling & 15)];
            if !sampling.iter().all(|n| (1..=4).contains(n)) {
                return None;
            }
            self.components.push(Component { id: *id, sampling, quantization: usize::from(*quantization) });
        }
        (self.components.len() == usize::from(*count) && self.size_px.iter().all(|n| *n > 0)).then_some(())
    }

    /// Parses the codes of a scan; returns what follows it, or `None` when nothing can be told.
    fn scan<'a>(&self, head: &[u8], coded: &'a [u8]) -> Result<Option<&'a [u8]>, &'static str> {
        const HEAD: &str = "the head of a scan is damaged";
        let (count, rest) = head.split_first().ok_or(HEAD)?;
        let mut parts = Vec::new();
        for two in rest.chunks_exact(2).take(usize::from(*count)) {
            let [id, tables] = two else { return Err(HEAD) };
            let component = self.components.iter().find(|c| c.id == *id).ok_or(HEAD)?;
            let table = |tables: &'_ [Option<Table>; 4], at: u8| tables.get(usize::from(at)).cloned().flatten();
            let (direct, others) = (table(&self.direct, tables >> 4), table(&self.others, tables & 15));
            let quantization = self.quantization.get(component.quantization).copied().flatten();
            // Motion JPEG may omit the standard tables.
            let (Some(direct), Some(others), Some(quantization)) = (direct, others, quantization) else {
                return Ok(None);
            };
            parts.push((*component, direct, others, quantization));
        }
        if parts.is_empty() || parts.len() != usize::from(*count) {
            return Err(HEAD);
        }
        let most = |axis: usize| self.components.iter().map(|c| c.sampling[axis]).max().unwrap_or(1);
        let most = [most(0), most(1)];
        let alone = parts.len() == 1;
        let units: usize = match parts.first() {
            // Blocks of a single component are not padded to whole units.
            Some((component, ..)) if alone => {
                (0..2).map(|i| (self.size_px[i] * component.sampling[i]).div_ceil(most[i]).div_ceil(8)).product()
            }
            _ => (0..2).map(|i| self.size_px[i].div_ceil(8 * most[i])).product(),
        };
        let width = match parts.first() {
            Some((component, ..)) if alone => (self.size_px[0] * component.sampling[0]).div_ceil(most[0]).div_ceil(8),
            _ => self.size_px[0].div_ceil(8 * most[0]),
        };
        let allowed: Vec<Samples> = parts.iter().map(|(.., quantization)| Samples::new(quantization)).collect();
        let mut bits = Bits::new(coded);
        let mut direct_before = vec![0; parts.len()];
        let mut means = vec![Vec::new(); parts.len()];
        for unit in 0..units {
            if self.restart_every > 0 && unit > 0 && unit % self.restart_every == 0 {
                bits.restart(unit / self.restart_every - 1)?;
                direct_before.fill(0);
            }
            let of_parts = parts.iter().zip(&allowed).zip(&mut direct_before).zip(&mut means);
            for ((((component, direct, others, quantization), allowed), before), means) in of_parts {
                let blocks = if alone { 1 } else { component.sampling[0] * component.sampling[1] };
                let mut sum = 0;
                for _ in 0..blocks {
                    let coefficients = block(&mut bits, direct, others, quantization, before)?;
                    if !allowed.allow(&coefficients) {
                        return Err(OUT_OF_RANGE);
                    }
                    sum += coefficients[0];
                }
                means.push(sum / blocks as i32);
            }
        }
        let rest = bits.end()?;
        if means.iter().any(|means| has_step(means, width)) {
            return Err("the brightness of all that follows a block is off");
        }
        Ok(Some(rest))
    }
}

/// A block's coefficients, in the order of the scan, multiplied by their steps.
fn block(
    bits: &mut Bits<'_>,
    direct: &Table,
    others: &Table,
    quantization: &[i32; 64],
    before: &mut i32,
) -> Result<[i32; 64], &'static str> {
    let step = |k: usize| quantization.get(k).copied().unwrap_or(1);
    let fits =
        |value: i32, k: usize| value.saturating_abs().saturating_sub(1).saturating_mul(step(k)) <= LARGEST_COEFFICIENT;
    let size = direct.next(bits)?;
    if size > 11 {
        return Err(OUT_OF_RANGE);
    }
    *before += bits.value(size)?;
    if !fits(*before, 0) {
        return Err(OUT_OF_RANGE);
    }
    let mut coefficients = [0; 64];
    coefficients[0] = before.saturating_mul(step(0));
    let mut k = 1;
    while k < 64 {
        let code = others.next(bits)?;
        let (run, size) = (usize::from(code >> 4), code & 15);
        if size == 0 {
            if run != 15 {
                break;
            }
            k += 16;
            continue;
        }
        k += run;
        if k > 63 {
            return Err("a block has too many coefficients");
        }
        let value = bits.value(size)?;
        if !fits(value, k) {
            return Err(OUT_OF_RANGE);
        }
        coefficients[k] = value.saturating_mul(step(k));
        k += 1;
    }
    if k > 64 { Err("a block has too many coefficients") } else { Ok(coefficients) }
}

/// A table of Huffman codes.
#[derive(Clone)]
struct Table {
    /// For codes of up to 8 bits, by the next 8 bits: length and value.
    short: Box<[(u8, u8); 256]>,
    /// For each length, the first code and the values of all codes.
    long: Vec<(u32, Vec<u8>)>,
}

impl Table {
    fn new(counts: &[u8; 16], values: &[u8]) -> Option<Self> {
        let mut table = Self { short: Box::new([(0, 0); 256]), long: Vec::with_capacity(16) };
        let (mut code, mut values) = (0_u32, values.iter());
        for (length, count) in (1_u32..).zip(counts) {
            let these: Vec<u8> = values.by_ref().take(usize::from(*count)).copied().collect();
            if length <= 8 {
                for (k, value) in (code..).zip(&these) {
                    let from = (k << (8 - length)) as usize;
                    table.short.get_mut(from..from + (1 << (8 - length)))?.fill((length as u8, *value));
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

    fn next(&self, bits: &mut Bits<'_>) -> Result<u8, &'static str> {
        bits.fill();
        let index = if bits.count >= 8 { bits.held >> (bits.count - 8) } else { bits.held << (8 - bits.count) } & 0xff;
        if let Some((length, value)) = self.short.get(index as usize).copied()
            && length > 0
            && u32::from(length) <= bits.count
        {
            bits.count -= u32::from(length);
            return Ok(value);
        }
        let mut code = 0;
        for (first, values) in &self.long {
            code = (code << 1) | bits.bit()?;
            let value = code.checked_sub(*first).and_then(|k| values.get(k as usize));
            if let Some(value) = value {
                return Ok(*value);
            }
        }
        Err("there is a code that no table has")
    }
}

/// The bits of a scan.
struct Bits<'a> {
    rest: &'a [u8],
    held: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    fn new(rest: &'a [u8]) -> Self {
        Self { rest, held: 0, count: 0 }
    }

    /// Reads bytes, up to a marker.
    fn fill(&mut self) {
        while self.count <= 48 {
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
            self.held = (self.held << 8) | u64::from(byte);
            self.count += 8;
        }
    }

    fn bit(&mut self) -> Result<u32, &'static str> {
        self.bits(1).map(|bit| bit as u32)
    }

    fn bits(&mut self, count: u8) -> Result<u64, &'static str> {
        self.fill();
        let left = self.count.checked_sub(count.into()).ok_or("the coded picture ends early")?;
        self.count = left;
        Ok((self.held >> left) & ((1 << count) - 1))
    }

    /// A value of `size` bits; the upper half of the codes is positive.
    fn value(&mut self, size: u8) -> Result<i32, &'static str> {
        if size == 0 {
            return Ok(0);
        }
        let value = self.bits(size)? as i32;
        Ok(if value < 1 << (size - 1) { value - (1 << size) + 1 } else { value })
    }

    /// Skips restart marker number `index`.
    fn restart(&mut self, index: usize) -> Result<(), &'static str> {
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
    fn end(mut self) -> Result<&'a [u8], &'static str> {
        self.fill();
        let padding = |byte: u64| byte == 0 || byte == 0xff;
        // The padding of the last byte is ones (T.81, F.1.2.3), with some encoders zeros.
        let (begun, ones) = (self.count % 8, (1 << (self.count % 8)) - 1);
        let rest = (self.held >> (self.count - begun)) & ones;
        if rest != 0 && rest != ones {
            return Err(EXCESS_DATA);
        }
        self.count -= begun;
        while self.count >= 8 {
            self.count -= 8;
            if !padding((self.held >> self.count) & 0xff) {
                return Err(EXCESS_DATA);
            }
            self.fill();
        }
        Ok(self.rest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jpeg() -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 90);
        // A thumbnail with its own end marker.
        image::ImageEncoder::set_exif_metadata(&mut encoder, vec![0xff, 0xd8, 0xff, 0xd9]).unwrap();
        encoder.encode_image(&image::GrayImage::from_fn(64, 48, |x, y| image::Luma([(x * y) as u8]))).unwrap();
        bytes
    }

    #[test]
    fn a_jpeg_is_whole_up_to_its_end_mark_wherever_it_is_cut() {
        let whole = jpeg();
        assert!(!is_cut_off(&whole));
        assert!(!is_cut_off(&[&whole[..], b"appended by a phone"].concat()));
        for length in 2..whole.len() {
            assert!(is_cut_off(&whole[..length]), "cut at {length} of {}", whole.len());
        }
    }

    #[test]
    fn other_files_are_none_of_its_business() {
        for bytes in [&b""[..], b"\x89PNG\r\n", b"\xff", b"text"] {
            assert!(!is_cut_off(bytes));
        }
    }

    /// Colour and grey pictures with structure, with and without subsampling.
    fn sound() -> Vec<Vec<u8>> {
        let pixel = |x: u32, y: u32| [(x * 3 + y) as u8, (x ^ y) as u8, (y * 2) as u8];
        let colour = image::RgbImage::from_fn(75, 52, |x, y| image::Rgb(pixel(x, y)));
        let grey = image::GrayImage::from_fn(64, 48, |x, y| image::Luma([(x * y / 3) as u8]));
        let encoded = |quality: u8, picture: &image::DynamicImage| {
            let mut bytes = Vec::new();
            image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(picture).unwrap();
            bytes
        };
        let pictures = [colour.into(), grey.into()];
        pictures.iter().flat_map(|picture| [20, 75, 100].map(|quality| encoded(quality, picture))).collect()
    }

    #[test]
    fn sound_pictures_are_sound_and_half_of_the_changed_bits_are_noticed() {
        let (mut changed, mut noticed) = (0, 0);
        for bytes in sound() {
            assert_eq!(examine(&bytes).damage, None);
            let scan = bytes.windows(2).position(|two| two == [0xff, START_OF_SCAN]).unwrap() + 14;
            for at in (scan..bytes.len() - 2).step_by(7) {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1 << (at % 8);
                changed += 1;
                noticed += usize::from(examine(&damaged).damage.is_some());
            }
        }
        println!("{noticed} of {changed} changed bits are noticed");
        assert!(changed > 300 && noticed * 10 > changed * 4, "{noticed} of {changed}");
    }

    /// Part of a real camera picture, around the catheter.
    #[test]
    fn in_a_camera_s_picture_more_is_noticed() {
        use crate::source::{FrameSource as _, VideoFile, VideoOptions};
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/sample_frames/rest.mkv");
        let frame = VideoFile::open(path, VideoOptions::default()).unwrap().next_frame().unwrap().unwrap();
        let luma = frame.picture.plane(0).unwrap();
        let part = image::GrayImage::from_fn(480, 400, |x, y| {
            image::Luma([luma.row(300 + y as usize).unwrap()[200 + x as usize]])
        });
        for (quality, percent) in [(60, 75), (80, 65), (95, 40)] {
            let mut bytes = Vec::new();
            image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(&part).unwrap();
            assert_eq!(examine(&bytes).damage, None);
            let scan = bytes.windows(2).position(|two| two == [0xff, START_OF_SCAN]).unwrap() + 10;
            let pixels = |bytes: &[u8]| Some(image::load_from_memory(bytes).ok()?.to_luma8());
            let sound = pixels(&bytes).unwrap();
            let (mut changed, mut noticed, mut large) = (0, 0, 0);
            for at in (scan..bytes.len() - 2).step_by(bytes.len() / 100) {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1 << (at % 8);
                changed += 1;
                if examine(&damaged).damage.is_some() {
                    noticed += 1;
                } else if let Some(picture) = pixels(&damaged) {
                    let off = picture.iter().zip(sound.iter()).filter(|(a, b)| a.abs_diff(**b) > 8).count();
                    large += usize::from(off > 256);
                }
            }
            println!(
                "quality {quality}: {noticed} of {changed} changed bits are noticed; of the others {large} change more than four blocks"
            );
            assert!(noticed * 100 > changed * percent && large * 20 < changed, "{noticed} and {large} of {changed}");
        }
    }

    #[test]
    fn nothing_that_is_read_makes_it_fail() {
        let mut random = fastrand::Rng::with_seed(7);
        for bytes in sound() {
            for _ in 0..300 {
                let mut damaged = bytes.clone();
                for _ in 0..4 {
                    let at = random.usize(..damaged.len());
                    damaged[at] = random.u8(..);
                }
                damaged.truncate(random.usize(2..=damaged.len()));
                let _ = examine(&damaged).damage;
            }
        }
    }
}
