//! What [`Tracker::warning`](super::Tracker::warning) says of the pictures.

pub(super) const PAIRED_CHROMA: &str = "every two pixels of these pictures have the same chroma: they were made from \
     pictures with subsampled chroma, and what a coder lost there cannot be seen in them; σ assumes what is usual: \
     track the original";
pub(super) const COPIED: &str = "parts of these pictures repeat those of the picture before to the last bit, and then \
     change: they are a copy of a compressed video, or noise was reduced over time; nothing in them tells what was \
     lost, and σ assumes what is usual for H.264 at crf 22: track the original";
pub(super) const VIEWS_DISAGREE: &str = "the views do not agree on where a band is, by far more than noise explains: \
     they do not show the same moment, or camera, mirror or tank have moved; σ is widened by as much";
pub(super) const OUT_OF_FOCUS: &str = "the pictures, or those of one view, are clearly sharper or more blurred than \
     those on which the bands were taught, or blurred more in one direction: focus, distance or processing have \
     changed (scaling, and chroma that was resampled, too), or the mirror is dirty; their blur is measured and used, \
     but the first frames were tracked without it: teach the bands again";
pub(super) const BLENDED: &str = "what moves is blurred by more than any exposure explains: earlier pictures were \
     blended into these (noise reduction over time, conversion of the frame rate), so bands are measured too late; σ \
     is widened by as much: record without it";
pub(super) const DENOISED: &str = "the noise of these pictures lasts from one to the next: it was reduced over time, \
     or they are a copy of a compressed video, so weak edges of what moves are shown late; σ is widened by what is \
     usual of a mean, up to a quarter of a pixel, and not by what a median of pictures does, which shows motion up to \
     a whole frame late: record without noise reduction";
pub(super) const WOVEN: &str = "even and odd rows of the pictures show different moments, although they are not marked \
     as interlaced; such frames are refused from now on, and those before, in which something moves, are not to be \
     trusted: record progressive frames";
pub(super) const FRINGES: &str = "red and blue lie apart in the pictures, by 0.45 pixels or more: the lens shows them \
     at different places (lateral chromatic aberration), or chroma is not stored where the recording says; this is \
     measured and taken out, and σ is widened by what may be left: another lens, or the middle of the picture, is \
     more accurate";
pub(super) const LONG_EXPOSURE: &str = "the rig's exposure (`exposure_ms`) is longer than the time from frame to \
     frame, which no camera's is: moving bands are blurred in the model by more than in the pictures, and are missed \
     or misplaced: correct it, or teach the bands again";
pub(super) const UNLIKE_TAUGHT: &str = "the pictures around a band differ clearly from those on which it was taught, \
     since the first frame: something is in front of it, the light is another, or they are coded otherwise; it is \
     refused, but in a noisier recording only in the first frames, and later σ may be too small: look at the overlay, \
     and teach the bands again";
pub(super) const COLOURS_LAG: &str = "colours lag behind the brightness of what moves: earlier pictures were blended \
     into the chroma of these (noise reduction over time), so bands are measured too late; σ is widened by as much: \
     record without it";
pub(super) const OUT_OF_ORDER: &str = "two of the last ten pictures, or more, are in the wrong order, by the way the \
     bands move: rows there are wrong, and σ does not cover that; only the first such place is named: restore the \
     order, or leave these pictures out";
pub(super) const LOOKS_OTHERWISE: &str = "for the last 30 frames the coil's band has not looked as it did before, and \
     was refused as `poor_fit` or has a larger σ: focus, light or coding have changed, or something is in front of it. \
     If it stays so, track what follows as a recording of its own (--from), with bands taught on it";
/// After the number of the frame.
pub(super) const FOREIGN: &str = " shows the bands where those before and after it do not lead: it is of \
     another time (an old one that a buffer gave once more), or a band is taken for another thing in it; what its row \
     has of them is wrong, σ does not cover that, and the next row may be missing; only the first such frame is \
     named: leave it out";
pub(super) const UNSTEADY: &str = "a band scatters about a smooth motion by more than four times its σ: pictures or \
     their stamps are in the wrong order or unevenly spaced (conversion of the frame rate), or it moves faster than \
     these frames show; σ is widened by as much, but single rows may be worse";
pub(super) const SHAKES: &str = "the base band, which should rest, shakes by more than its σ: camera, mirror, tank or \
     clamp vibrate, or the pictures were processed; σ of all positions is widened by as much, but not that of \
     directions and θ, which hold if the whole picture moves alike (waves in one view do not)";
pub(super) const MOVED: &str = "the base band, which should rest, is not where it was in the first frames: camera, \
     mirror, tank or clamp have moved since, or the band is too far from its clamp; σ of all positions is widened by \
     as much, but not that of directions and θ, which hold if the whole picture moved alike";
pub(super) const SWINGS: &str = "the base band, which should rest, swings with the coil by half a millimetre or more: \
     it is too far from its clamp, which does not harm positions, or the picture moves with the coil (a stand that \
     gives way, a stabiliser), which moves all of them by as much, and σ does not cover that: clamp the tube close to \
     the band, and the camera firmly. If the first band is the one at the free end, base frame and sign of θ are \
     wrong: teach the bands in their order from the clamp";
pub(super) const LAMP_CHANGED: &str = "the lamp's two levels have changed, by the exposure, the light or the camera: \
     they were learned anew, and changes meanwhile may not be counted";
/// After the numbers (diameter.rs).
pub(super) const OTHER_TUBE: &str = "; measure the tube, and teach the bands with its diameter (or the tape around \
     them, or the scale of the calibration, is another)";
/// After the numbers (repeated_pictures.rs).
pub(super) const STALLED: &str = ": bands that moved stood there, and then jumped further than any motion: rows of \
     such frames are wrong, and σ does not cover that; only the first such place is named: leave these frames out, and \
     look at what the camera or the recorder did";
pub(super) const TORN: &str = "a part of the picture is that of an earlier one, to the last bit: it is torn, as when a \
     transfer ends early or a picture is copied while the next is drawn; frames in which bands tell are refused as \
     damaged, and others may be torn where none does: look at the camera's transfer, its buffers and its rate";
