//! Dictionaries of markers: which pattern has which number.
//!
//! A marker is a square of cells, dark or light, within a dark rim one cell wide. Its word has one bit per cell,
//! row-major from the upper left, the first being the highest, light 1. The words are those of OpenCV's predefined
//! dictionaries (`dictionaries.txt`, which names their source and licence).

use std::fmt;
use std::str::FromStr;
use std::sync::LazyLock;

/// Sizes of the dictionaries of a family: each consists of its first words.
const SIZES: [usize; 4] = [50, 100, 250, 1000];

struct Family {
    name: &'static str,
    cells: usize,
    words: Vec<u64>,
}

static FAMILIES: LazyLock<Vec<Family>> = LazyLock::new(|| {
    let mut families: Vec<Family> = Vec::new();
    for line in include_str!("dictionaries.txt").lines().filter(|line| !line.starts_with('#')) {
        let fields: Vec<&'static str> = line.split_whitespace().collect();
        if let ["family", name, cells] = fields[..] {
            families.push(Family { name, cells: cells.parse().unwrap_or(0), words: Vec::new() });
        } else if let Some(family) = families.last_mut() {
            family.words.extend(fields.iter().filter_map(|word| u64::from_str_radix(word, 16).ok()));
        }
    }
    families
});

/// One of OpenCV's predefined dictionaries of markers, such as `DICT_4X4_50`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dictionary {
    /// Index into [`FAMILIES`].
    family: usize,
    size: usize,
}

impl Dictionary {
    /// All dictionaries.
    pub fn all() -> impl Iterator<Item = Self> {
        let whole = |(family, f): (usize, &Family)| Self { family, size: f.words.len() };
        FAMILIES.iter().enumerate().map(whole).flat_map(|whole| {
            let sizes = SIZES.into_iter().filter(move |size| whole.size == SIZES[3] && *size < whole.size);
            sizes.map(move |size| Self { size, ..whole }).chain([whole])
        })
    }

    /// The largest dictionary of each family.
    pub(super) fn families() -> impl Iterator<Item = Self> {
        Self::all().filter(|dictionary| dictionary.size == dictionary.whole().map_or(0, <[u64]>::len))
    }

    /// The smallest of the same family that contains this marker number.
    pub(super) fn with(self, id: usize) -> Self {
        Self::all().find(|other| other.family == self.family && other.size > id).unwrap_or(self)
    }

    /// Whether one dictionary's words are the first words of the other.
    pub(super) fn is_same_family(self, other: Self) -> bool {
        self.family == other.family
    }

    /// Cells along a side of a marker, without its rim.
    pub fn cells(self) -> usize {
        FAMILIES.get(self.family).map_or(0, |family| family.cells)
    }

    /// How many markers it has.
    pub fn size(self) -> usize {
        self.size
    }

    /// The word of each marker.
    pub(super) fn words(self) -> &'static [u64] {
        self.whole().and_then(|words| words.get(..self.size)).unwrap_or_default()
    }

    fn whole(self) -> Option<&'static [u64]> {
        FAMILIES.get(self.family).map(|family| family.words.as_slice())
    }
}

impl fmt::Display for Dictionary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(family) = FAMILIES.get(self.family) else { return Err(fmt::Error) };
        // Families of one dictionary have no number in its name.
        if family.words.len() == SIZES[3] {
            write!(f, "DICT_{}_{}", family.name, self.size)
        } else {
            write!(f, "DICT_{}", family.name)
        }
    }
}

impl FromStr for Dictionary {
    type Err = ();

    /// OpenCV's name, optionally without `DICT_` and in lower case.
    fn from_str(text: &str) -> Result<Self, ()> {
        let bare = |name: &str| {
            let name = name.trim().to_ascii_uppercase();
            name.strip_prefix("DICT_").map(str::to_owned).unwrap_or(name)
        };
        Self::all().find(|dictionary| bare(&dictionary.to_string()) == bare(text)).ok_or(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_of_every_dictionary_is_there_and_different_however_it_is_turned() {
        let families: Vec<_> = Dictionary::families().map(|d| (d.to_string(), d.cells(), d.size())).collect();
        let expected = [
            ("DICT_4X4_1000", 4, 1000),
            ("DICT_5X5_1000", 5, 1000),
            ("DICT_6X6_1000", 6, 1000),
            ("DICT_7X7_1000", 7, 1000),
            ("DICT_ARUCO_ORIGINAL", 5, 1024),
            ("DICT_ARUCO_MIP_36h12", 6, 250),
        ];
        assert_eq!(families, expected.map(|(name, cells, size)| (name.to_owned(), cells, size)));
        for dictionary in Dictionary::families() {
            let words: std::collections::HashSet<u64> = dictionary.words().iter().copied().collect();
            assert_eq!(words.len(), dictionary.size(), "{dictionary}");
            assert!(words.iter().all(|word| *word < 1 << dictionary.cells().pow(2)), "{dictionary}");
        }
        // Marker 0 of DICT_4X4_50: OpenCV's bytes 181, 50.
        assert_eq!("4x4_50".parse::<Dictionary>().unwrap().words()[0], 181 << 8 | 50);
    }

    #[test]
    fn dictionaries_are_called_as_opencv_calls_them() {
        for text in ["DICT_4X4_50", "4x4_50", " dict_4x4_50"] {
            assert_eq!(text.parse::<Dictionary>().unwrap().to_string(), "DICT_4X4_50");
        }
        assert_eq!(Dictionary::all().count(), 4 * 4 + 2);
        for dictionary in Dictionary::all() {
            assert_eq!(dictionary.to_string().parse(), Ok(dictionary));
            assert_eq!(dictionary.words().len(), dictionary.size());
        }
        assert!("DICT_4X4_60".parse::<Dictionary>().is_err());
        assert_eq!("4X4_50".parse::<Dictionary>().unwrap().with(72).to_string(), "DICT_4X4_100");
    }
}
