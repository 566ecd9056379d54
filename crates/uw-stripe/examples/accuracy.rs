//! Prints how far each method's centres are from the truth, by the Cramér–Rao bound: `cargo run --release -p uw-stripe --example
//! accuracy -- [SEEDS [SCENE…]]`, SEEDS images for each width and camera of a scene, of those whose names begin with SCENE.

#![allow(clippy::print_stdout, reason = "printing is what this example is for")]
#![allow(clippy::unwrap_used, reason = "a scene that cannot be made shall stop it")]

#[path = "../tests/it/optics.rs"]
mod optics;
#[path = "../tests/it/others.rs"]
mod others;
#[path = "../tests/it/suite.rs"]
mod suite;

fn main() {
    let mut words = std::env::args().skip(1);
    let seeds = words.next().and_then(|w| w.parse().ok()).unwrap_or(4);
    let wanted: Vec<String> = words.collect();
    let asked = |name: &str| wanted.is_empty() || wanted.iter().any(|w| name.starts_with(w.as_str()));
    println!("{:<20} {:<30} {}", "scene", "method", suite::HEADS);
    for case in suite::CASES.iter().chain(&others::OTHERS).filter(|c| asked(c.name)) {
        for (contender, score) in suite::CONTENDERS.iter().zip(suite::judge(case, &suite::CONTENDERS, seeds))
        {
            println!("{:<20} {:<30} {}", case.name, contender.name, score.row());
        }
    }
}
