//! Every parser of bytes and text on inputs that are nearly right: no panic, no hang, no memory beyond its bound.
//!
//! A seeded mutator that knows a little of structure changes good files. Each parser gets them in this process, where a
//! counting allocator judges memory; a part of them goes through the program itself, whose exit code and words are judged.
//! `STAGEPOSE_FUZZ_INPUTS` says how many inputs each parser gets (2,000 without it; `.ci/fuzz` gives 20,000), and
//! `STAGEPOSE_FUZZ_SEED` which ones. What fails is kept below target/fuzz.
//!
//! A new parser gets a good file in `fuzzing/seeds.rs`, and a test of one line in `fuzzing/parsers.rs`; where it has no function of its
//! own that tests can call, a line in `fuzzing/program.rs` with the command that reads the file.

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

/// Inputs for each parser.
fn inputs() -> u64 {
    std::env::var("STAGEPOSE_FUZZ_INPUTS").map_or(2000, |text| text.parse().expect("STAGEPOSE_FUZZ_INPUTS is a number"))
}

/// Which inputs.
fn seed() -> u64 {
    std::env::var("STAGEPOSE_FUZZ_SEED").map_or(1, |text| text.parse().expect("STAGEPOSE_FUZZ_SEED is a number"))
}

/// Keeps an input that failed, and says where.
fn keep(name: &str, number: u64, bytes: &[u8]) -> String {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/target/fuzz");
    let file = format!("{folder}/{name}-{number}");
    std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&file, bytes)).expect("target/fuzz can be written");
    file
}
