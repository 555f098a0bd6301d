//! Feeds every parser of bytes and text with inputs that are nearly right: no panic, no hang, no
//! memory beyond its bound.
//!
//! A seeded mutator that knows some of the structure changes good files. Each parser gets them in
//! this process, where a counting allocator checks the memory. Some of them also go through the
//! program itself, where the exit code and the messages are checked. `STAGEPOSE_FUZZ_INPUTS` sets
//! the inputs per parser (default 2,000; `.ci/fuzz` uses 20,000), and `STAGEPOSE_FUZZ_SEED` selects
//! other inputs. Failing inputs are kept below target/fuzz.
//!
//! To add a parser, put a good file into `fuzzing/seeds.rs` and a one-line test into
//! `fuzzing/parsers.rs`. If tests cannot call the parser as a function of its own, add a line to
//! `fuzzing/program.rs` with the command that reads the file.

#[path = "fuzzing/memory.rs"]
mod memory;
#[path = "fuzzing/mutator.rs"]
mod mutator;
#[path = "fuzzing/parsers.rs"]
mod parsers;
#[path = "fuzzing/program.rs"]
mod program;
#[path = "fuzzing/seeds.rs"]
mod seeds;

/// Returns the number of inputs per parser.
fn inputs() -> u64 {
    std::env::var("STAGEPOSE_FUZZ_INPUTS").map_or(2000, |text| text.parse().expect("STAGEPOSE_FUZZ_INPUTS is a number"))
}

/// Returns the seed of the inputs.
fn seed() -> u64 {
    std::env::var("STAGEPOSE_FUZZ_SEED").map_or(1, |text| text.parse().expect("STAGEPOSE_FUZZ_SEED is a number"))
}

/// Keeps a failing input and returns its path.
fn keep(name: &str, number: u64, bytes: &[u8]) -> String {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/target/fuzz");
    let file = format!("{folder}/{name}-{number}");
    std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&file, bytes)).expect("target/fuzz can be written");
    file
}
