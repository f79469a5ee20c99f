//! Colours that people with any colour vision can distinguish: Okabe and Ito, "Color Universal Design" (2008).
//! Vermilion is reserved for misses. Markers also have labels: no meaning depends on colour alone.

/// One colour, R, G, B.
pub(crate) type Rgb = [u8; 3];

/// Colours by meaning.
pub(crate) struct Palette {
    markers: [Rgb; 6],
    /// A miss.
    pub miss: Rgb,
    /// Lost frames.
    pub gap: Rgb,
}

impl Palette {
    /// On a dark background and over pictures.
    pub(crate) const ON_DARK: Self = Self {
        markers: [[240, 185, 40], [0, 200, 150], [86, 180, 233], [230, 150, 195], [240, 228, 66], [200, 200, 255]],
        miss: [255, 120, 40],
        gap: [150, 150, 150],
    };

    /// On white paper, with a contrast of 3:1 at least (WCAG 2.2, 1.4.11): yellow and light blue are darker.
    pub(crate) const ON_WHITE: Self = Self {
        markers: [[184, 120, 0], [0, 158, 115], [0, 114, 178], [180, 95, 145], [110, 90, 0], [58, 127, 176]],
        miss: [213, 94, 0],
        gap: [95, 99, 104],
    };

    /// Colour of marker `i`, in the rig's order.
    pub(crate) fn marker(&self, i: usize) -> Rgb {
        let [first, ..] = self.markers;
        self.markers.get(i % self.markers.len()).copied().unwrap_or(first)
    }
}
