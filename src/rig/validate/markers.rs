//! The markers of a rig file, and the tube that they are on.

use super::super::file::{CatheterFile, MarkerFile, ViewColourFile};
use super::super::numbers::millimetres as written_mm;
use super::super::{Catheter, ColourModel, ColourPlane, Marker, RigError, View};
use super::{Check, FARTHEST_MM, unknown_name};
use crate::plural::plural;
use nalgebra::Vector3;

/// A wider tube is a slip of the units; pictures of bands of any width cannot be made.
const WIDEST_TUBE_MM: f64 = 1e3;
/// Part of the last band that may be round: the band has an edge, and ends behind it.
const MOST_ROUND: f64 = 0.9;
/// Longer than the stiff part of any catheter that is steered by a coil on it, metres.
const LONGEST_STIFF_M: f64 = 0.1;
/// Largest weight of 8-bit samples that can be computed with; learned ones are below 1.
const LARGEST_WEIGHT: f64 = 1e3;

impl Check<'_> {
    pub(super) fn marker(&self, raw: MarkerFile, views: &[View]) -> Result<Marker, RigError> {
        let key = |field: &str| format!("marker.{}.{field}", raw.name);
        self.positive(key("length_mm"), raw.length_mm)?;
        if let Some(centre) = raw.centre_mm {
            self.within(key("centre_mm"), &[centre], FARTHEST_MM)?;
            if centre < raw.length_mm / 2.0 {
                let expected = format!("at least {}, half the band's length from the clamp", raw.length_mm / 2.0);
                return Err(self.value(key("centre_mm"), centre, expected));
            }
        }
        for residual in &raw.usual_residuals {
            self.positive(key("usual_residuals"), *residual)?;
        }
        // A file whose views were left out, because the lens changed, keeps what its bands had in them.
        if !raw.usual_residuals.is_empty() && !views.is_empty() && raw.usual_residuals.len() != views.len() {
            let expected = format!("{}, one for each view", plural(views.len(), "number"));
            return Err(self.value(key("usual_residuals"), format_args!("{:?}", raw.usual_residuals), expected));
        }
        if let Some(colour) = &raw.colour {
            self.within(key("colour.discriminant_rgb"), &colour.discriminant_rgb, LARGEST_WEIGHT)?;
            self.within(key("colour.bias"), &[colour.bias], 1e3 * LARGEST_WEIGHT)?;
            self.finite(key("colour.rgb"), &colour.rgb)?;
            if colour.discriminant_rgb == [0.0; 3] {
                return Err(self.value(key("colour.discriminant_rgb"), "[0, 0, 0]", "weights that are not all zero"));
            }
            self.colour_range(key("colour.rgb"), &colour.rgb)?;
        }
        let everywhere =
            raw.colour.map(|c| ColourModel::linear(Vector3::from(c.discriminant_rgb), c.bias, Vector3::from(c.rgb)));
        let colours = match everywhere {
            Some(_) if !raw.colours.is_empty() => {
                return Err(self.key(key("colour"), "here beside `colours`, which says the same: keep one of them"));
            }
            Some(colour) => vec![colour],
            None => self.colours(&key("colours"), &raw.colours, views)?,
        };
        Ok(Marker {
            length_m: raw.length_mm / 1e3,
            centre_m: raw.centre_mm.map(|centre| centre / 1e3),
            colours,
            usual_residuals: raw.usual_residuals,
            name: raw.name,
        })
    }

    /// One colour model for all views, or one for each of them, in their order.
    fn colours(&self, key: &str, raw: &[ViewColourFile], views: &[View]) -> Result<Vec<ColourModel>, RigError> {
        let mut colours = Vec::with_capacity(raw.len());
        for (i, colour) in raw.iter().enumerate() {
            let key = |field: &str| format!("{key}.{i}.{field}");
            if colour.planes.is_empty() {
                return Err(self.value(key("planes"), "[]", "one plane or more"));
            }
            for plane in &colour.planes {
                self.finite(key("planes"), plane)?;
                let &[r, g, b, bias] = plane;
                self.within(key("planes"), &[r, g, b], LARGEST_WEIGHT)?;
                self.within(key("planes"), &[bias], 1e3 * LARGEST_WEIGHT)?;
                if plane[..3] == [0.0; 3] {
                    return Err(self.value(key("planes"), format!("{plane:?}"), "weights that are not all zero"));
                }
            }
            self.finite(key("rgb"), &colour.rgb)?;
            self.colour_range(key("rgb"), &colour.rgb)?;
            let plane = |&[r, g, b, bias]: &[f64; 4]| ColourPlane { weights: Vector3::new(r, g, b), bias };
            colours.push(ColourModel {
                planes: colour.planes.iter().map(plane).collect(),
                rgb: Vector3::from(colour.rgb),
            });
        }
        let named: Vec<&str> = raw.iter().filter_map(|colour| colour.view.as_deref()).collect();
        let all: Vec<&str> = views.iter().map(|view| view.name.as_str()).collect();
        let all_named = named == all && (views.is_empty() || raw.len() == named.len());
        if raw.is_empty() || all_named || (raw.len() == 1 && named.is_empty()) {
            return Ok(colours);
        }
        let expected =
            format!("one entry for each view, in their order ({}), or a single one without `view`", all.join(", "));
        Err(self.value(key, format!("[{}]", named.join(", ")), expected))
    }

    fn colour_range(&self, key: String, rgb: &[f64; 3]) -> Result<(), RigError> {
        match rgb.iter().all(|c| (0.0..=255.0).contains(c)) {
            true => Ok(()),
            false => Err(self.value(key, format!("{rgb:?}"), "0 to 255 each")),
        }
    }

    /// Bands whose place is known are in the file's order along the tube, and do not overlap.
    pub(super) fn bands_apart(&self, markers: &[Marker]) -> Result<(), RigError> {
        let mut before: Option<(&str, f64)> = None;
        for marker in markers {
            let Some(centre_m) = marker.centre_m else { continue };
            if let Some((other, end_m)) = before
                && centre_m - marker.length_m / 2.0 < end_m - 1e-9
            {
                return Err(self.value(
                    format_args!("marker.{}.centre_mm", marker.name),
                    written_mm(centre_m),
                    format_args!(
                        "bands in their order along the tube: `{other}` reaches to {} mm, so a band of {} mm has its \
                         middle at {} or more",
                        written_mm(end_m),
                        written_mm(marker.length_m),
                        written_mm(end_m + marker.length_m / 2.0)
                    ),
                ));
            }
            before = Some((&marker.name, centre_m + marker.length_m / 2.0));
        }
        Ok(())
    }

    pub(super) fn catheter(&self, raw: &CatheterFile, markers: &[Marker]) -> Result<Catheter, RigError> {
        if markers.is_empty() {
            return Err(self.no_marker());
        }
        self.positive("catheter.diameter_mm", raw.diameter_mm)?;
        if raw.diameter_mm > WIDEST_TUBE_MM {
            let expected = format!("at most {WIDEST_TUBE_MM}");
            return Err(self.value("catheter.diameter_mm", raw.diameter_mm, expected));
        }
        let index = |key: &str, name: &str| {
            markers.iter().position(|m| m.name == name).ok_or_else(|| {
                let known = markers.iter().map(|m| m.name.as_str());
                self.value(key, format_args!("{name:?}"), unknown_name("a marker", name, known))
            })
        };
        let coil = index("catheter.coil", &raw.coil)?;
        let end = raw.end.as_deref().map(|name| index("catheter.end", name)).transpose()?;
        if let Some(end) = end
            && let Some(last) = markers.last()
            && end + 1 != markers.len()
        {
            let expected = format!("the last marker along the tube, {:?}", last.name);
            return Err(self.value("catheter.end", format_args!("{:?}", raw.end.as_deref().unwrap_or("")), expected));
        }
        if let Some(rounding) = raw.end_rounding_mm {
            self.positive("catheter.end_rounding_mm", rounding)?;
            let Some(last) = end.and_then(|end| markers.get(end)) else {
                let expected = "`end`, the marker that ends the tube, with it";
                return Err(self.value("catheter.end_rounding_mm", rounding, expected));
            };
            let most_mm = (MOST_ROUND * last.length_m * 1e3).min(raw.diameter_mm);
            if rounding > most_mm {
                let expected = format!(
                    "at most {}: nine tenths of the last band, and no more than the diameter",
                    written_mm(most_mm / 1e3)
                );
                return Err(self.value("catheter.end_rounding_mm", rounding, expected));
            }
        }
        if let Some(rigid) = raw.rigid_mm {
            self.positive("catheter.rigid_mm", rigid)?;
            let most_mm = longest_stiff_m(markers, coil) * 1e3;
            if rigid > most_mm {
                let expected = format!("at most {most_mm:.0}: the stiff part around the middle of the coil");
                return Err(self.value("catheter.rigid_mm", rigid, expected));
            }
            let band_m = markers.get(coil).map_or(0.0, |coil| coil.length_m);
            if rigid < band_m * 1e3 - 1e-9 {
                let expected =
                    format!("at least {}, the length of the coil's band, which is stiff", written_mm(band_m));
                return Err(self.value("catheter.rigid_mm", rigid, expected));
            }
        }
        Ok(Catheter {
            diameter_m: raw.diameter_mm / 1e3,
            coil,
            end,
            end_rounding_m: raw.end_rounding_mm.map(|v| v / 1e3),
            rigid_m: raw.rigid_mm.map(|v| v / 1e3),
        })
    }
}

/// The longest stiff part around the middle of the coil that a tube can have, metres: it does not reach the first band,
/// where the tube is held.
pub(crate) fn longest_stiff_m(markers: &[Marker], coil: usize) -> f64 {
    let centre_m = |marker: usize| markers.get(marker)?.centre_m;
    let held = (coil > 0).then(|| centre_m(0).zip(centre_m(coil))).flatten();
    held.map_or(LONGEST_STIFF_M, |(held_m, coil_m)| LONGEST_STIFF_M.min(2.0 * (coil_m - held_m).abs()))
}
