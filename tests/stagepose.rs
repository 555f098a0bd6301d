//! Tests of the program from outside (commands, files, exit codes, results on whole clips), of the
//! tracker as a library on rendered frames, and of live cameras that fail.

mod calibrate;
mod cli;
mod clips;
mod compare;
mod live;
mod mount;
mod network;
mod outputs;
mod pipeline;
mod structure;
mod survey;
