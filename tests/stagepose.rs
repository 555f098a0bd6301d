//! The program from outside - its commands, its files, its exit codes - and the tracker as a library, on rendered frames.

mod cli;
mod pipeline;
