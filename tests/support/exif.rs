//! Orientations in JPEG files, as telephones store them.

/// The same picture, to be shown turned. (`image` writes no EXIF in the version that is used.)
pub(crate) fn with_orientation(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    // TIFF header, little endian, one directory with one entry: orientation (0x112), short, 1 value.
    let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x01\0\0\0\0\0\0\0".to_vec();
    exif[24] = orientation;
    let length = (exif.len() as u16 + 2).to_be_bytes();
    // After the mark of the start and the first segment (JFIF), which says its length.
    let at = 4 + usize::from(u16::from_be_bytes([jpeg[4], jpeg[5]]));
    [&jpeg[..at], &[0xff, 0xe1], &length, &exif, &jpeg[at..]].concat()
}
