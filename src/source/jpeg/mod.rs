//! Whether a JPEG picture is complete: decoders silently fill in what is missing or damaged.
//!
//! The codes of a sequential picture (ITU-T T.81) are parsed without decoding samples: every code must exist, every
//! block must be possible for 8-bit samples, the mean brightness may not step in the middle of a row, and the data must
//! end with the last block. More than half of all changed bits are detected: after a changed bit the codes are read out
//! of step. What this cannot detect: a changed bit that leaves the codes in step, which changes one coefficient;
//! anything in progressive and arithmetic-coded pictures.

mod codes;
mod quantiser;
mod samples;
mod standard;
mod steps;

use codes::{Bits, Block, BlockCoder, Fault, Table};
pub(crate) use quantiser::Steps;
use quantiser::step_at_edges;
use samples::Samples;
use standard::STANDARD;
use steps::has_step;

const START_OF_IMAGE: [u8; 2] = [0xff, 0xd8];
const HUFFMAN: u8 = 0xc4;
const QUANTIZATION: u8 = 0xdb;
const RESTART_INTERVAL: u8 = 0xdd;
const START_OF_SCAN: u8 = 0xda;
const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];

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
    pub steps: Option<Steps>,
}

/// Examines a JPEG picture; other files give an empty result.
pub(crate) fn examine(bytes: &[u8]) -> Examined {
    Examiner::default().examine(bytes)
}

/// Examines the pictures of a stream.
#[derive(Default)]
pub(crate) struct Examiner {
    /// Whether a picture had codes of its own: those that later pictures leave out may be the same.
    had_codes: bool,
}

impl Examiner {
    pub(crate) fn examine(&mut self, bytes: &[u8]) -> Examined {
        let mut picture = Picture { others_codes: self.had_codes, ..Picture::default() };
        let damage = picture.read(bytes).err();
        self.had_codes |= picture.has_codes;
        Examined { damage, steps: picture.steps() }
    }
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
    /// Whether it defines codes.
    has_codes: bool,
    /// Whether codes that it does not define are those of pictures before it; else they are the standard's.
    others_codes: bool,
    /// Whether to leave its codes alone: of progressive pictures only the steps are told.
    without_codes: bool,
}

#[derive(Clone, Copy)]
struct Component {
    id: u8,
    /// Blocks in an interleaved unit.
    sampling: [usize; 2],
    quantization: usize,
}

/// A component in a scan.
struct Part<'a> {
    /// Blocks in a unit of the scan.
    sampling: [usize; 2],
    coder: BlockCoder<'a>,
    allowed: Samples,
    /// The mean brightness of its blocks in each unit.
    means: Vec<i32>,
}

impl Picture {
    fn steps(&self) -> Option<Steps> {
        let of = |component: &Component| self.quantization.get(component.quantization)?.as_ref().map(step_at_edges);
        let luma = self.components.first()?;
        let [cb, cr] = [1, 2].map(|i| self.components.get(i).unwrap_or(luma));
        let area = |component: &Component| component.sampling.iter().product::<usize>() as f64;
        Some(Steps { channels: [of(luma)?, of(cb)?, of(cr)?], chroma_px: area(luma) / area(cb) })
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
                        START_OF_SCAN if self.without_codes => return Ok(()),
                        HUFFMAN => {
                            self.huffman(body).ok_or("a table of codes is damaged")?;
                            self.has_codes = true;
                        }
                        QUANTIZATION => self.quantization(body).ok_or("a table of quantization is damaged")?,
                        0xc0 | 0xc1 => self.frame(body).ok_or("the head of the picture is damaged")?,
                        0xc2 => {
                            self.frame(body).ok_or("the head of the picture is damaged")?;
                            self.without_codes = true;
                        }
                        // Lossless, arithmetic: not examined.
                        0xc3..=0xcf if *code != 0xc8 && *code != 0xcc => return Ok(()),
                        RESTART_INTERVAL => {
                            let every = body.first_chunk().ok_or("a segment is cut off")?;
                            self.restart_every = u16::from_be_bytes(*every).into();
                        }
                        START_OF_SCAN => {
                            if !self.has_codes && !self.others_codes {
                                self.huffman(&STANDARD).ok_or("a table of codes is damaged")?;
                            }
                            match self.scan(body, rest)? {
                                Some(next) => rest = next,
                                None => return Ok(()),
                            }
                        }
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
            let direct = self.direct.get(usize::from(tables >> 4)).and_then(Option::as_ref);
            let others = self.others.get(usize::from(tables & 15)).and_then(Option::as_ref);
            let steps = self.quantization.get(component.quantization).and_then(Option::as_ref);
            // Defined by pictures before it, which are not known here.
            let (Some(direct), Some(others), Some(steps)) = (direct, others, steps) else { return Ok(None) };
            parts.push(Part {
                sampling: component.sampling,
                coder: BlockCoder::new(direct, others, steps),
                allowed: Samples::new(steps),
                means: Vec::new(),
            });
        }
        let most = |axis: usize| self.components.iter().map(|c| c.sampling[axis]).max().unwrap_or(1);
        let most = [most(0), most(1)];
        let across = |axis: usize, sampling: usize| (self.size_px[axis] * sampling).div_ceil(most[axis]).div_ceil(8);
        // Blocks of a single component are not padded to whole units.
        let [width, height] = match &mut parts[..] {
            [] => return Err(HEAD),
            [alone] => {
                let blocks = [0, 1].map(|axis| across(axis, alone.sampling[axis]));
                alone.sampling = [1, 1];
                blocks
            }
            _ => [0, 1].map(|axis| self.size_px[axis].div_ceil(8 * most[axis])),
        };
        if parts.len() != usize::from(*count) {
            return Err(HEAD);
        }
        let mut bits = Bits::new(coded);
        let mut block = Block::EMPTY;
        for unit in 0..width * height {
            if self.restart_every > 0 && unit > 0 && unit % self.restart_every == 0 {
                bits.restart(unit / self.restart_every - 1)?;
                parts.iter_mut().for_each(|part| part.coder.restart());
            }
            for part in &mut parts {
                let blocks = part.sampling[0] * part.sampling[1];
                let mut sum = 0;
                for _ in 0..blocks {
                    part.coder.read(&mut bits, &mut block)?;
                    if !part.allowed.allow(&block) {
                        return Err(Fault::OutOfRange.into());
                    }
                    sum += block.mean;
                }
                part.means.push(sum / blocks as i32);
            }
        }
        let rest = bits.end()?;
        if parts.iter().any(|part| has_step(&part.means, width)) {
            return Err("the brightness of all that follows a block is off");
        }
        Ok(Some(rest))
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
    fn a_coarser_picture_has_larger_steps_and_a_progressive_one_the_same() {
        let pictures = sound();
        let [coarse, fine] = [0, 1].map(|i| examine(&pictures[i]).steps.unwrap());
        assert!(
            coarse.channels[1] > coarse.channels[0] && coarse.channels[0] > 3.0 * fine.channels[0],
            "{coarse:?} {fine:?}"
        );
        assert!((coarse.chroma_px - 1.0).abs() < 1e-9, "{coarse:?}");
        // A segment before it may contain what begins a scan.
        let mut commented = pictures[0].clone();
        commented.splice(2..2, [0xff, 0xfe, 0, 6, 0xff, START_OF_SCAN, 0, 0]);
        assert_eq!(examine(&commented).steps, Some(coarse));
        // Marked as progressive, and as 4:2:0.
        let mut progressive = pictures[0].clone();
        let head = progressive.windows(2).position(|two| two == [0xff, 0xc0]).unwrap();
        (progressive[head + 1], progressive[head + 11]) = (0xc2, 0x22);
        let Examined { damage, steps } = examine(&progressive);
        assert_eq!((damage, steps), (None, Some(Steps { chroma_px: 4.0, ..coarse })));
    }

    /// Without the segments that define its codes.
    fn without_codes(picture: &[u8]) -> Vec<u8> {
        let mut bytes = picture.to_vec();
        while let Some(at) = bytes.windows(2).position(|two| two == [0xff, HUFFMAN]) {
            let length = 2 + usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]]));
            bytes.drain(at..at + length);
        }
        bytes
    }

    #[test]
    fn a_picture_without_codes_has_the_standard_s_unless_others_before_it_had_their_own() {
        for bytes in sound() {
            let mut damaged = without_codes(&bytes);
            assert_eq!(examine(&damaged).damage, None);
            damaged.truncate(damaged.len() - 9);
            assert!(Examiner::default().examine(&damaged).damage.is_some());
            let mut examiner = Examiner::default();
            assert_eq!([&bytes, &damaged].map(|bytes| examiner.examine(bytes).damage), [None; 2]);
        }
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
                "quality {quality}: {noticed} of {changed} changed bits are noticed; of the others {large} change more \
                 than four blocks"
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
