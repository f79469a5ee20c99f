//! The Rust version that Cargo.toml declares: no dependency needs a newer one, and the installation instructions agree.
//!
//! Clippy checks the code itself (`incompatible_msrv`).

use serde_json::Value;
use std::path::Path;
use std::process::Command;

const DECLARED: &str = env!("CARGO_PKG_RUST_VERSION");

fn cargo(args: &[&str]) -> String {
    let output = Command::new(env!("CARGO")).current_dir(env!("CARGO_MANIFEST_DIR")).args(args).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Major, minor and patch, which may be left out.
fn version(text: &str) -> [u32; 3] {
    let mut parts = text.split('.').map(|part| part.parse().unwrap());
    [(); 3].map(|()| parts.next().unwrap_or(0))
}

#[test]
fn no_dependency_wants_a_newer_rust() {
    let about = cargo(&["-vV"]);
    let host = about.lines().find_map(|line| line.strip_prefix("host: ")).unwrap();
    // What was built with is there without a network.
    let mut features = Vec::new();
    features.extend(cfg!(feature = "genicam").then_some("genicam"));
    features.extend(cfg!(feature = "gstreamer").then_some("gstreamer"));
    let features = features.join(",");
    let args = ["metadata", "--format-version=1", "--locked", "--offline", "--filter-platform", host, "--features"];
    let metadata: Value = serde_json::from_str(&cargo(&[&args[..], &[&features]].concat())).unwrap();
    let used: Vec<&str> =
        metadata["resolve"]["nodes"].as_array().unwrap().iter().map(|node| node["id"].as_str().unwrap()).collect();
    assert!(used.len() > 200, "{} packages", used.len());
    let packages = metadata["packages"].as_array().unwrap().iter();
    let newer = packages.filter(|package| used.contains(&package["id"].as_str().unwrap())).filter_map(|package| {
        let wanted = package["rust_version"].as_str()?;
        (version(wanted) > version(DECLARED)).then(|| format!("{} {wanted}", package["name"]))
    });
    let newer: Vec<String> = newer.collect();
    assert!(newer.is_empty(), "Cargo.toml declares Rust {DECLARED}; newer is wanted by {}", newer.join(", "));
}

#[test]
fn who_installs_is_told_the_same() {
    for file in ["README.md", "scripts/install-deps"] {
        let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
        assert!(text.contains(&format!("Rust {DECLARED} or newer")), "{file} does not name Rust {DECLARED}");
    }
}
