//! What libav says of a decoder's packets, of a container's end, and of what else is asked.
//!
//! A decoder that conceals damage marks the picture, and one that gives up a packet returns an error. With several
//! threads the mark is lost when another thread gives the picture out (H.264 with B pictures, FFmpeg 5 and 6), and an
//! error when it comes among the last packets. The messages that libav logs at that moment are not lost. Each packet
//! has a key, which libav hands to the thread that decodes it, and with the thread's messages back to us.

use ffmpeg_the_third as av;
use parking_lot::{Mutex, MutexGuard};
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, VecDeque};
use std::ffi::{CStr, c_char, c_int, c_void};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// What a message says of a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Said {
    /// An error: the packet may give no picture.
    Error,
    /// Its number (H.264's `frame_num`) is not the next one. Some coders skip numbers and say so beforehand.
    SkipsNumbers,
    /// Its picture has holes, which were filled, or pictures that it is predicted from are missing.
    Concealed,
}

/// What messages begin with that tell of concealed damage, and of missing pictures (H.264 and H.265), and what each
/// means.
const TELLING: [(&[u8], Said); 5] = [
    (b"concealing ", Said::Concealed),
    (b"Missing reference picture", Said::Concealed),
    (b"reference picture missing", Said::Concealed),
    (b"Could not find ref", Said::Concealed),
    (b"Frame num gap", Said::SkipsNumbers),
];
/// What is said of a container while it is read. libav goes on where it can, or reports a normal end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum OfContainer {
    /// Nothing.
    Sound,
    /// An error: what comes next is where libav found the container's structure again.
    Damaged,
    /// It ends where it declares more.
    CutOff,
}

/// What a message of a Matroska container begins with that is cut off.
const CUT_OFF: &[u8] = b"File ended prematurely";
/// Packets remembered: more than there can be threads.
const REMEMBERED: usize = 256;

/// Longer lines are cut off.
const LONGEST_LINE: usize = 256;

/// The next packet's key; 0 is none.
static NEXT: AtomicUsize = AtomicUsize::new(1);
/// What was said of packets, by key, and no decoder has asked for yet.
static HEARD: Mutex<BTreeMap<usize, Said>> = Mutex::new(BTreeMap::new());

thread_local! {
    /// What is logged on this thread, as long as [`logged`] listens.
    static LOGGED: RefCell<Option<Vec<String>>> = const { RefCell::new(None) };
    /// What was said on this thread of a container.
    static OF_CONTAINER: Cell<OfContainer> = const { Cell::new(OfContainer::Sound) };
}

/// The lines that libav logs on this thread while something is done; they go nowhere else.
pub(super) fn logged(done: impl FnOnce()) -> Vec<String> {
    LOGGED.set(Some(Vec::new()));
    done();
    LOGGED.take().unwrap_or_default()
}

/// What is read from a container, and what libav says of it meanwhile.
pub(super) fn hearing_of_container<T>(read: impl FnOnce() -> T) -> (T, OfContainer) {
    OF_CONTAINER.set(OfContainer::Sound);
    let read = read();
    (read, OF_CONTAINER.get())
}

/// Keys of a decoder's latest packets, and their numbers.
#[derive(Debug, Default)]
pub(super) struct Messages {
    packets: VecDeque<(usize, u64)>,
}

impl Messages {
    /// The next packet that `decoder` is given has this number.
    #[allow(unsafe_code, reason = "the binding does not offer this field")]
    pub(super) fn packet(&mut self, decoder: &mut av::decoder::Video, number: u64) {
        if self.packets.len() == REMEMBERED {
            self.packets.pop_front().and_then(|(key, _)| heard().remove(&key));
        }
        let key = NEXT.fetch_add(1, Relaxed);
        self.packets.push_back((key, number));
        // SAFETY: the decoder owns a valid context; the field is the user's, and libav only copies it.
        unsafe { (*decoder.as_mut_ptr()).opaque = std::ptr::without_provenance_mut(key) };
    }

    /// What was said since the last time, with the packets' numbers.
    pub(super) fn take(&mut self) -> Vec<(u64, Said)> {
        let mut heard = heard();
        if heard.is_empty() {
            return Vec::new();
        }
        self.packets.iter().filter_map(|(key, number)| Some((*number, heard.remove(key)?))).collect()
    }
}

impl Drop for Messages {
    fn drop(&mut self) {
        self.take();
    }
}

fn heard() -> MutexGuard<'static, BTreeMap<usize, Said>> {
    HEARD.lock()
}

/// Begins to listen to libav.
#[allow(unsafe_code, reason = "a callback for a C library")]
pub(super) fn listen() {
    // SAFETY: the callback is thread-safe, does not unwind, and lives as long as the program.
    unsafe { av::ffi::av_log_set_callback(Some(hear)) };
}

#[cfg(all(unix, target_arch = "x86_64"))]
type Arguments = *mut av::ffi::__va_list_tag;
#[cfg(not(all(unix, target_arch = "x86_64")))]
type Arguments = av::ffi::va_list;

/// Notes what matters, and passes every message on to libav's own callback.
///
/// # Safety
/// As for that one: `context` is null or points to a struct that begins with a pointer to its class, and `format` is a
/// C string.
#[allow(unsafe_code, reason = "a callback of a C library")]
#[allow(improper_ctypes_definitions, reason = "on some platforms the binding takes the list of arguments for an array")]
unsafe extern "C" fn hear(context: *mut c_void, level: c_int, format: *const c_char, arguments: Arguments) {
    // SAFETY: see above. The list of arguments is used once.
    unsafe {
        if LOGGED.with_borrow(Option::is_some) {
            let mut line = [0; LONGEST_LINE];
            let mut prefix = 0;
            av::ffi::av_log_format_line2(
                std::ptr::null_mut(),
                level,
                format,
                arguments,
                line.as_mut_ptr(),
                LONGEST_LINE as c_int,
                &raw mut prefix,
            );
            let line = CStr::from_ptr(line.as_ptr()).to_string_lossy().into_owned();
            LOGGED.with_borrow_mut(|logged| logged.as_mut().map(|logged| logged.push(line)));
            return;
        }
        let begin = CStr::from_ptr(format).to_bytes();
        let is_error = level <= av::ffi::AV_LOG_ERROR as c_int;
        let class = if context.is_null() { std::ptr::null() } else { *context.cast::<*const av::ffi::AVClass>() };
        if begin.starts_with(CUT_OFF) {
            OF_CONTAINER.set(OfContainer::CutOff);
        } else if is_error && class == av::ffi::avformat_get_class() {
            OF_CONTAINER.set(OF_CONTAINER.get().max(OfContainer::Damaged));
        }
        let told = TELLING.iter().find(|(how, _)| begin.starts_with(how));
        let said = told.map(|(_, said)| *said).or(is_error.then_some(Said::Error));
        // Contexts of this class are those of coders.
        if let Some(said) = said
            && class == av::ffi::avcodec_get_class()
        {
            let key = (*context.cast::<av::ffi::AVCodecContext>()).opaque.addr();
            // Another library's decoders may keep something else there.
            if (1..NEXT.load(Relaxed)).contains(&key) {
                let mut heard = heard();
                let worst = heard.entry(key).or_insert(said);
                *worst = said.max(*worst);
            }
        }
        av::ffi::av_log_default_callback(context, level, format, arguments);
    }
}
