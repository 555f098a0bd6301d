//! The program from outside: its commands, its files, its exit codes.

mod cli;
