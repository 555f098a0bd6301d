//! What receivers get through real sockets. The decoders are written from the protocols' documents
//! and share no code with the program. The tests check the table of docs/protocols.md cell by cell,
//! and a program that is stopped and continued.

mod clocks;
mod decoders;
mod otp;
mod places;
mod stopped;
mod table;
