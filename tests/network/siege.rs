//! Clients that hold connections and give nothing back, all at once, while a service manager checks
//! the health.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use super::service::Service;

const DEAD_READERS: usize = 200;
const PIPELINING: usize = 64;
/// Health checks during the siege, and the pause between two of them.
const CHECKS: u32 = 40;
const PAUSE: Duration = Duration::from_millis(100);

const WEB_SOCKET: &[u8] = b"GET /ws HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
    Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";

/// Returns what a dead reader sends before it falls silent.
fn beginning(k: usize) -> &'static [u8] {
    match k % 4 {
        0 => b"",
        1 => b"GET /healthz HTTP/1.1\r\nHost: localh",
        2 => WEB_SOCKET,
        _ => b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n",
    }
}

fn connected(port: u16) -> Option<TcpStream> {
    let stream = TcpStream::connect(("127.0.0.1", port)).ok()?;
    stream.set_write_timeout(Some(Duration::from_millis(50))).ok()?;
    Some(stream)
}

/// Keeps all dead readers connected, and reconnects those that the server drops.
fn stay_dead(port: u16, is_over: &AtomicBool, let_go: &AtomicU64) {
    let mut readers: Vec<Option<TcpStream>> = (0..DEAD_READERS).map(|_| None).collect();
    while !is_over.load(Ordering::Relaxed) {
        for (k, reader) in readers.iter_mut().enumerate() {
            // Reads a byte to see whether the server is still there; a dead reader does not need
            // it.
            let is_gone = reader.as_mut().is_some_and(|stream| match stream.read(&mut [0]) {
                Ok(0) => true,
                Ok(_) => false,
                Err(e) => e.kind() != ErrorKind::WouldBlock,
            });
            let_go.fetch_add(u64::from(is_gone), Ordering::Relaxed);
            if is_gone || reader.is_none() {
                *reader = connected(port);
                if let Some(stream) = reader {
                    let _ = stream.write_all(beginning(k));
                    let _ = stream.set_nonblocking(true);
                }
            }
        }
        std::thread::sleep(PAUSE);
    }
}

/// Sends requests endlessly and reads nothing; reconnects when dropped.
fn pipeline(port: u16, is_over: &AtomicBool, let_go: &AtomicU64) {
    let requests = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(200);
    while !is_over.load(Ordering::Relaxed) {
        let Some(mut stream) = connected(port) else { continue };
        while !is_over.load(Ordering::Relaxed) {
            match stream.write(&requests) {
                Err(e) if e.kind() == ErrorKind::WouldBlock => {}
                Ok(_) => {}
                Err(_) => break,
            }
        }
        let_go.fetch_add(1, Ordering::Relaxed);
        std::thread::sleep(PAUSE);
    }
}

#[test]
fn health_is_answered_through_a_siege() {
    let mut service = Service::start();
    let (port, is_over) = (service.port(), AtomicBool::new(false));
    let (dead, pipelining) = (AtomicU64::new(0), AtomicU64::new(0));
    let outcome = std::thread::scope(|threads| {
        threads.spawn(|| stay_dead(port, &is_over, &dead));
        (0..PIPELINING).for_each(|_| drop(threads.spawn(|| pipeline(port, &is_over, &pipelining))));
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            for _ in 0..CHECKS {
                std::thread::sleep(PAUSE);
                service.check();
            }
            // Clients that hold connections without reading are dropped in favour of new ones.
            while pipelining.load(Ordering::Relaxed) < PIPELINING as u64 {
                std::thread::sleep(PAUSE);
                service.check();
            }
        }));
        is_over.store(true, Ordering::Relaxed);
        outcome
    });
    outcome.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    let (dead, pipelining) = (dead.into_inner(), pipelining.into_inner());
    service.end(&format!("{DEAD_READERS} dead readers (let go {dead} times), {PIPELINING} pipelining ones ({pipelining} times)"));
}
