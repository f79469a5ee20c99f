//! The tube, and how a picture shows it: centre line, projection, colours, light and blur, and how stored samples come
//! from what the sensor saw.

pub(super) mod appearance;
pub(super) mod channel;
pub(super) mod functions;
pub(super) mod image_model;
pub(super) mod mosaic;
pub(super) mod separation;
pub(super) mod stretch;
pub(super) mod tube_image;
pub(super) mod tube_shape;
