//! The program from outside: its commands, its files, its exit codes, and what it makes of whole clips.

mod cli;
mod clips;
