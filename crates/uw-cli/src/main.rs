//! The `uwscan` command.
fn main() {}
