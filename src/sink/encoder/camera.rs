//! Messages about the picture: `foxglove.CameraCalibration`, and the bands of each frame as
//! `foxglove.ImageAnnotations`.

use super::convert::{Names, timestamp};
use super::scene::{CAMERA_FRAME, colour};
use crate::estimate::{BandObservation, Estimate};
use crate::rig::{Camera, Rig};
use crate::sink::LoggedImage;
use foxglove::messages::{
    CameraCalibration, CircleAnnotation, Color, CompressedImage, ImageAnnotations, Point2, PointsAnnotation,
    TextAnnotation, Timestamp, points_annotation,
};
use nalgebra::Point2 as Pixel;

/// Foxglove's annotations count from the top-left corner of the top-left pixel, the project from its centre.
const CORNER_TO_CENTRE_PX: f64 = 0.5;
const DOT_PX: f64 = 3.0;
const STROKE_PX: f64 = 1.0;
const FONT_PX: f64 = 14.0;
/// Offset of a label to the right of and above its band.
const LABEL_OFFSET_PX: f64 = 10.0;
const LABEL: Color = Color { r: 1.0, g: 1.0, b: 1.0, a: 1.0 };
const LABEL_BACKGROUND: Color = Color { r: 0.0, g: 0.0, b: 0.0, a: 0.6 };

/// Intrinsics as `plumb_bob`, whose five parameters are the lens's own, or as `rational_polynomial` with eight. As in
/// ROS, the principal point counts from the centre of the top-left pixel.
pub(super) fn calibration(camera: &Camera, stamp_ns: i64) -> CameraCalibration {
    let lens = &camera.lens;
    let [width, height] = camera.size_px;
    CameraCalibration {
        timestamp: Some(timestamp(stamp_ns)),
        frame_id: CAMERA_FRAME.to_owned(),
        width,
        height,
        distortion_model: lens.ros_name().to_owned(),
        d: lens.coefficients(),
        k: lens.matrix().to_vec(),
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: lens.projection_matrix().to_vec(),
    }
}

/// The picture itself: with its frame's time, like the annotations.
pub(super) fn image(image: &LoggedImage) -> CompressedImage {
    CompressedImage {
        timestamp: Some(timestamp(image.stamp_ns)),
        frame_id: CAMERA_FRAME.to_owned(),
        data: image.jpeg.clone().into(),
        format: "jpeg".to_owned(),
    }
}

/// The markers' colours for drawing.
pub(super) fn colours(rig: &Rig) -> Vec<Color> {
    rig.markers.iter().map(colour).collect()
}

/// Outline, centre and label of every band that was measured, in every view.
pub(super) fn annotations(names: &Names, colours: &[Color], estimate: &Estimate) -> ImageAnnotations {
    let at = timestamp(estimate.stamp.ns);
    let mut all = ImageAnnotations { timestamp: Some(at), ..ImageAnnotations::default() };
    for (index, (marker, &color)) in estimate.markers.iter().zip(colours).enumerate() {
        for band in marker.views.iter().flatten() {
            all.points.push(outline(band, color, at));
            all.circles.push(CircleAnnotation {
                timestamp: Some(at),
                position: Some(on_picture(&band.centre_px)),
                diameter: DOT_PX,
                thickness: STROKE_PX,
                fill_color: Some(color),
                outline_color: Some(LABEL),
                metadata: Vec::new(),
            });
            let corner = band.centre_px + nalgebra::Vector2::new(LABEL_OFFSET_PX, -LABEL_OFFSET_PX);
            all.texts.push(TextAnnotation {
                timestamp: Some(at),
                position: Some(on_picture(&corner)),
                text: names.marker(index),
                font_size: FONT_PX,
                text_color: Some(LABEL),
                background_color: Some(LABEL_BACKGROUND),
                metadata: Vec::new(),
            });
        }
    }
    all
}

fn outline(band: &BandObservation, color: Color, at: Timestamp) -> PointsAnnotation {
    PointsAnnotation {
        timestamp: Some(at),
        r#type: points_annotation::Type::LineLoop.into(),
        points: band.outline_px.iter().map(on_picture).collect(),
        outline_color: Some(color),
        thickness: STROKE_PX,
        ..PointsAnnotation::default()
    }
}

fn on_picture(pixel: &Pixel<f64>) -> Point2 {
    Point2 { x: pixel.x + CORNER_TO_CENTRE_PX, y: pixel.y + CORNER_TO_CENTRE_PX }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::Miss;
    use crate::testing::fixture;

    #[test]
    fn intrinsics_are_the_lens_own() {
        let message = calibration(&fixture::rig().camera, 5);
        assert_eq!((message.width, message.height, message.distortion_model.as_str()), (1280, 1024, "plumb_bob"));
        assert_eq!(message.d, [-0.11, 0.14, 0.0006, -0.0004, 0.01]);
        assert_eq!(message.k, [2712.4, 0.0, 643.7, 0.0, 2706.9, 508.2, 0.0, 0.0, 1.0]);
        assert_eq!(message.p, [2712.4, 0.0, 643.7, 0.0, 0.0, 2706.9, 508.2, 0.0, 0.0, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn every_band_seen_has_outline_centre_and_label() {
        let rig = fixture::rig();
        let mut estimate = fixture::complete(0, 5);
        estimate.markers[0].views[0] = Err(Miss::NotSeen { view: 0 });
        let all = annotations(&Names::new(&rig), &colours(&rig), &estimate);
        assert_eq!((all.points.len(), all.circles.len(), all.texts.len()), (5, 5, 5));
        let labels: Vec<&str> = all.texts.iter().map(|t| t.text.as_str()).collect();
        assert_eq!(labels, ["base", "coil", "coil", "tip", "tip"]);
        let centre = estimate.markers[1].views[0].as_ref().unwrap().centre_px;
        assert_eq!(all.circles[1].position, Some(Point2 { x: centre.x + 0.5, y: centre.y + 0.5 }));
        assert_eq!(all.points[1].points.len(), 20);
        assert_eq!(all.points[4].outline_color, Some(Color { r: 0.0, g: 0.2, b: 1.0, a: 1.0 }));
    }
}
