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

/// An optional whole number from 0.
pub(crate) fn optional_whole(message: &DynamicMessage, field: &str) -> Option<u64> {
    optional_number(message, field).and_then(|n| u64::try_from(n).ok())
}

/// A whole number from 0; 0 when absent.
pub(crate) fn whole(message: &DynamicMessage, field: &str) -> u64 {
    number(message, field).and_then(|n| u64::try_from(n).ok()).unwrap_or(0)
}

/// A floating-point number; one that is not finite stands for a value that was not measured.
pub(crate) fn float(message: &DynamicMessage, field: &str) -> Option<f64> {
    message.get_field_by_name(field)?.as_f64().filter(|value| value.is_finite())
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

/// The word of a nested status, unless absent.
pub(crate) fn word(message: &DynamicMessage, field: &str) -> Option<String> {
    text(&inner(message, field)?, "word")
}

/// Repeated numbers.
pub(crate) fn floats(message: &DynamicMessage, field: &str) -> Vec<f64> {
    let values = message.get_field_by_name(field);
    values.as_deref().and_then(Value::as_list).unwrap_or(&[]).iter().filter_map(Value::as_f64).collect()
}

/// Repeated messages.
pub(crate) fn list(message: &DynamicMessage, field: &str) -> Vec<DynamicMessage> {
    let values = message.get_field_by_name(field);
    values.as_deref().and_then(Value::as_list).unwrap_or(&[]).iter().filter_map(Value::as_message).cloned().collect()
}
