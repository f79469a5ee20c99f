//! What the page asks for as a command line: for the program itself, and for a person to put into a script.

use super::places::Places;
use crate::shell;

/// An option of the command and its value; none of one that has none.
pub(super) type Setting = (&'static str, String);

/// Arguments of the command, as a program gives them, with whole paths: the page is not bound to the folder that a
/// shell would be in. No value is ever taken for an option.
pub(super) fn arguments(places: &Places, inputs: &[&str], settings: &[Setting]) -> Vec<String> {
    let one = |(option, value): &Setting| match *option {
        "--rig" | "--out" => format!("{option}={}", places.whole(value)),
        option if value.is_empty() => option.to_owned(),
        option => format!("{option}={value}"),
    };
    let mut all: Vec<String> = settings.iter().map(one).collect();
    all.push("--".to_owned());
    all.extend(inputs.iter().map(|input| places.whole(input)));
    all
}

/// The same command as a person types it into a shell, in the starting folder.
pub(super) fn typed(verb: &str, inputs: &[&str], settings: &[Setting]) -> String {
    // What begins like an option comes behind `--`.
    let plain = inputs.iter().all(|input| !input.starts_with('-'));
    let quoted: String = inputs.iter().map(|input| format!(" {}", shell::quoted(input))).collect();
    let mut line = format!("catoptra {verb}");
    if plain {
        line += &quoted;
    }
    for (option, value) in settings {
        line += &match value.as_str() {
            "" => format!(" \\\n  {option}"),
            value if value.starts_with('-') => format!(" \\\n  {option}={}", shell::quoted(value)),
            value => format!(" \\\n  {option} {}", shell::quoted(value)),
        };
    }
    if !plain {
        line += &format!(" \\\n  --{quoted}");
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_is_typed_in_becomes_an_option_or_a_command() {
        let folder = tempfile::tempdir().unwrap();
        let places = Places::below(folder.path(), &[]).unwrap();
        let settings = [
            ("--tube", "-1mm".to_owned()),
            ("--inside", String::new()),
            ("--pick", "it's; rm -rf $HOME@1,2:3mm".to_owned()),
        ];
        let all = arguments(&places, &["--out=x"], &settings);
        assert_eq!(all[..4], ["--tube=-1mm", "--inside", "--pick=it's; rm -rf $HOME@1,2:3mm", "--"]);
        assert!(all[4].ends_with("/--out=x") && all[4].starts_with('/'));
        let line = typed("calibrate markers", &["--out=x"], &settings);
        let expected = "catoptra calibrate markers \\\n  --tube=-1mm \\\n  --inside \\\n  \
                        --pick 'it'\\''s; rm -rf $HOME@1,2:3mm' \\\n  -- --out=x";
        assert_eq!(line, expected);
    }
}
