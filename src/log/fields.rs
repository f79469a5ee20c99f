//! Fields of a decoded message by name. A field that is absent or of an unexpected type is `None`: logs of other
//! versions can be read as far as their names agree.

use prost_reflect::{DynamicMessage, Value};

/// A whole number of any width.
pub(crate) fn number(message: &DynamicMessage, field: &str) -> Option<i64> {
    match message.get_field_by_name(field)?.as_ref() {
        Value::I64(n) => Some(*n),
        Value::U64(n) => i64::try_from(*n).ok(),
        Value::U32(n) => Some(i64::from(*n)),
        Value::I32(n) => Some(i64::from(*n)),
        _ => None,
    }
}

/// An optional whole number.
pub(crate) fn optional_number(message: &DynamicMessage, field: &str) -> Option<i64> {
    message.has_field_by_name(field).then(|| number(message, field)).flatten()
}

/// A floating-point number.
pub(crate) fn float(message: &DynamicMessage, field: &str) -> Option<f64> {
    message.get_field_by_name(field)?.as_f64()
}

/// Text.
pub(crate) fn text(message: &DynamicMessage, field: &str) -> Option<String> {
    message.get_field_by_name(field)?.as_str().map(str::to_owned)
}

/// A nested message, unless absent.
pub(crate) fn inner(message: &DynamicMessage, field: &str) -> Option<DynamicMessage> {
    if !message.has_field_by_name(field) {
        return None;
    }
    message.get_field_by_name(field)?.as_message().cloned()
}

/// `x`, `y` and `z` of a nested message.
pub(crate) fn xyz(message: &DynamicMessage, field: &str) -> Option<[f64; 3]> {
    let inner = inner(message, field)?;
    Some([float(&inner, "x")?, float(&inner, "y")?, float(&inner, "z")?])
}
