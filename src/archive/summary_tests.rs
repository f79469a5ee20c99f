//! The file, written and read, and its schema.

use super::summary::*;
use serde_json::Value;
use std::path::Path;

#[test]
fn what_was_written_is_read_and_what_another_program_wrote_is_refused() {
    let place = tempfile::tempdir().unwrap();
    assert!(RunSummary::read(place.path()).unwrap().is_none());
    assert!(RunSummary::read(&place.path().join("none")).unwrap().is_none());
    let summary = RunSummary::example();
    summary.write(place.path()).unwrap();
    assert_eq!(RunSummary::read(place.path()).unwrap().unwrap(), summary);
    let path = place.path().join(SUMMARY);
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("\"schema\": 1", "\"schema\": 2")).unwrap();
    let refused = RunSummary::read(place.path()).unwrap_err().to_string();
    assert!(refused.contains("its format version is 2; this program reads version 1"), "{refused}");
    std::fs::write(&path, text.get(..text.len() / 2).unwrap()).unwrap();
    assert!(matches!(RunSummary::read(place.path()), Err(SummaryError::Form { .. })));
}

/// Where a value violates the schema; supports only the parts of JSON Schema that ours uses.
fn against(schema: &Value, root: &Value, value: &Value, at: &str, wrong: &mut Vec<String>) {
    let known = [
        "$schema",
        "$defs",
        "$ref",
        "title",
        "description",
        "type",
        "const",
        "enum",
        "required",
        "properties",
        "additionalProperties",
        "items",
    ];
    for key in schema.as_object().unwrap().keys() {
        assert!(known.contains(&key.as_str()), "{at}: {key} is not checked");
    }
    if let Some(name) = schema.get("$ref") {
        let name = name.as_str().unwrap().strip_prefix("#/$defs/").unwrap();
        return against(&root["$defs"][name], root, value, at, wrong);
    }
    let is = |kind: &Value| match kind.as_str().unwrap() {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "null" => value.is_null(),
        "number" => value.is_number(),
        "integer" => value.is_i64() || value.is_u64(),
        other => panic!("{other}"),
    };
    let kinds = schema.get("type").map(|kind| kind.as_array().cloned().unwrap_or_else(|| vec![kind.clone()]));
    if kinds.is_some_and(|kinds| !kinds.iter().any(is)) {
        wrong.push(format!("{at} is {value}"));
    }
    let allowed = schema.get("enum").map(|all| all.as_array().unwrap().clone());
    let allowed = allowed.or_else(|| Some(vec![schema.get("const")?.clone()]));
    if allowed.is_some_and(|allowed| !allowed.contains(value)) {
        wrong.push(format!("{at} is {value}"));
    }
    for (k, item) in value.as_array().into_iter().flatten().enumerate() {
        if let Some(items) = schema.get("items") {
            against(items, root, item, &format!("{at}[{k}]"), wrong);
        }
    }
    let Some(object) = value.as_object() else { return };
    for name in schema.get("required").and_then(Value::as_array).into_iter().flatten() {
        if !object.contains_key(name.as_str().unwrap()) {
            wrong.push(format!("{at}.{name} is missing"));
        }
    }
    for (name, value) in object {
        let own = schema.get("properties").and_then(|all| all.get(name));
        match own.or(schema.get("additionalProperties").filter(|more| more.is_object())) {
            Some(schema) => against(schema, root, value, &format!("{at}.{name}"), wrong),
            None => wrong.push(format!("{at}.{name} is not known")),
        }
    }
}

/// Counts the places for values, so that the schema has no more than a summary.
fn places(value: &Value) -> usize {
    match value {
        Value::Object(all) => all.values().map(|value| 1 + places(value)).sum(),
        Value::Array(all) => all.first().map_or(0, places),
        _ => 0,
    }
}

#[test]
fn the_schema_in_the_documentation_is_that_of_the_file() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/summary.schema.json");
    let schema: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let mut full = RunSummary::example();
    let alarm = Alarm { kind: "base_moved".into(), at_ns: 3, over_ns: Some(5), size_mm: 1.0, message: "moved".into() };
    full.measured.as_mut().unwrap().drift_alarms.push(alarm);
    let failed = Failed { message: "disk full".into(), retryable: true };
    let empty = RunSummary { measured: None, failure: Some(failed), outcome: Outcome::Failed, ..full.clone() };
    for summary in [&full, &empty] {
        let mut wrong = Vec::new();
        against(&schema, &schema, &serde_json::to_value(summary).unwrap(), "summary", &mut wrong);
        assert_eq!(wrong, Vec::<String>::new());
    }
    // Everything that the schema requires is in the file, and everything in the file is in the schema.
    let mut value = serde_json::to_value(&full).unwrap();
    assert!(places(&value) > 60);
    value["measured"]["frames"] = "many".into();
    value["measured"].as_object_mut().unwrap().remove("lost");
    value["outcome"] = "fine".into();
    value["colour"] = 3.into();
    let mut wrong = Vec::new();
    against(&schema, &schema, &value, "summary", &mut wrong);
    wrong.sort();
    assert_eq!(
        wrong,
        [
            "summary.colour is not known",
            "summary.measured.\"lost\" is missing",
            "summary.measured.frames is \"many\"",
            "summary.outcome is \"fine\"",
        ]
    );
}
