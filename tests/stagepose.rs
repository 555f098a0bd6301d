//! The program from outside - its commands, its files, its exit codes, what it makes of whole clips - and the tracker as a
//! library, on rendered frames; live cameras that fail.

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
