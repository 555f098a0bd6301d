//! A `run` that waits for its camera, with its HTTP server: a real daemon that leaves the processor
//! to its attackers.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use super::peak_memory_kb;
use crate::live::program::{config, stagepose};

/// Maximum peak memory, kB; it needs 30 MB.
const MAX_MEMORY_KB: u64 = 128_000;

pub struct Service {
    program: Child,
    port: u16,
    /// Number of answered health checks, and the longest one.
    checks: (u32, Duration),
    _folder: tempfile::TempDir,
}

impl Service {
    pub fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = config(folder.path());
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let text = std::fs::read_to_string(&file).unwrap().replace("[camera]", "[camera]\ndevice = \"/dev/v4l/by-id/no-such-camera\"");
        std::fs::write(&file, format!("{text}\n[http]\nlisten = \"127.0.0.1:{port}\"\n")).unwrap();
        let program =
            stagepose(folder.path()).args(["run", "--config"]).arg(&file).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let service = Self { program, port, checks: (0, Duration::ZERO), _folder: folder };
        let begun = Instant::now();
        while service.ask(b"GET /healthz HTTP/1.0\r\n\r\n").is_empty() {
            assert!(begun.elapsed() < Duration::from_secs(60), "it does not listen");
            std::thread::sleep(Duration::from_millis(50));
        }
        service
    }

    pub fn port(&self) -> u16 {
        self.port
    }

    /// Sends these bytes and nothing more, and returns the answer. The answer is empty if the
    /// connection is refused or broken off.
    pub fn ask(&self, bytes: &[u8]) -> Vec<u8> {
        let mut answer = Vec::new();
        let Ok(mut stream) = TcpStream::connect(("127.0.0.1", self.port)) else { return answer };
        stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        stream.set_write_timeout(Some(Duration::from_secs(30))).unwrap();
        // The server may stop reading before it has received everything.
        let _ = stream.write_all(bytes);
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let _ = stream.read_to_end(&mut answer);
        answer
    }

    /// Asks for the health as a service manager does; the server must answer.
    pub fn check(&mut self) {
        let begun = Instant::now();
        let answer = self.ask(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
        let (text, took) = (String::from_utf8_lossy(&answer), begun.elapsed());
        assert!(text.starts_with("HTTP/1.1 503 ") && text.contains("\"camera\":\"waiting\""), "after {took:?}: {text}");
        self.checks = (self.checks.0 + 1, self.checks.1.max(took));
    }

    /// Ends the service cleanly. The time of a check is only judged if `STAGEPOSE_HEALTH_WITHIN_MS`
    /// sets a limit, because tests assert no times.
    pub fn end(mut self, what: &str) {
        let memory = peak_memory_kb(self.program.id());
        let pid = nix::unistd::Pid::from_raw(self.program.id() as i32);
        nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGTERM).unwrap();
        assert_eq!(self.program.wait().unwrap().code(), Some(0));
        let (checks, longest) = self.checks;
        println!("{what}: {checks} health checks, the longest {:.0} ms, {memory} kB", longest.as_secs_f64() * 1e3);
        assert!(memory < MAX_MEMORY_KB, "{memory} kB");
        if let Some(most) = std::env::var("STAGEPOSE_HEALTH_WITHIN_MS").ok().and_then(|ms| ms.parse().ok()) {
            assert!(longest <= Duration::from_millis(most), "a health check took {longest:?}");
        }
    }
}

impl Drop for Service {
    /// A failing test leaves no program behind.
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}
