//! The command `catoptra`.

fn main() {}
