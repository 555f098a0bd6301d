//! What receivers hear, through real sockets, by decoders that are written from the protocols' documents and share no code with the
//! program's: the table of docs/protocols.md, cell by cell, and a program that is stopped and goes on.

mod clocks;
mod decoders;
mod places;
mod stopped;
mod table;
