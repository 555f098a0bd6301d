//! Damaged datagrams for the real `listen`: each one becomes one line that is safe on a terminal.

use std::io::{BufRead, BufReader, Read};
use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use stagepose::diagnostics::printable::stands_for_itself;

use super::mutator::Mutator;
use super::packets::{PROTOCOLS, good, repaired};
use super::{inputs, peak_memory_kb};

/// Maximum peak memory of a listener, kB. It needs 10 MB; trusting a length in a datagram takes
/// much more.
const MAX_MEMORY_KB: u64 = 64_000;

struct Listener {
    program: Child,
    lines: Receiver<String>,
    socket: UdpSocket,
}

impl Listener {
    fn start(protocol: &str) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        // This port is free now; the datagrams below check that the program has bound it.
        let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut program = Command::new(env!("CARGO_BIN_EXE_stagepose"))
            .args(["listen", protocol, &port.to_string()])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut out = BufReader::new(program.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            let mut bytes = Vec::new();
            while out.read_until(b'\n', &mut bytes).is_ok_and(|n| n > 0) {
                let line = String::from_utf8(std::mem::take(&mut bytes)).expect("what is printed is UTF-8");
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        socket.connect(("127.0.0.1", port)).unwrap();
        let listener = Self { program, lines, socket };
        let begun = Instant::now();
        // Sent until it is received: the program may not have bound its port yet, and refusals come
        // back as errors.
        while listener.socket.send(b"hello").is_err() || listener.lines.recv_timeout(Duration::from_millis(200)).is_err() {
            assert!(begun.elapsed() < Duration::from_secs(60), "it does not listen");
        }
        while listener.lines.recv_timeout(Duration::from_millis(300)).is_ok() {}
        listener
    }

    /// Returns the line that a datagram becomes.
    fn line(&mut self, datagram: &[u8]) -> String {
        self.socket.send(datagram).unwrap();
        match self.lines.recv_timeout(Duration::from_secs(60)) {
            Ok(line) => line,
            Err(_) => {
                let mut said = String::new();
                let _ = self.program.kill();
                let _ = self.program.stderr.take().unwrap().read_to_string(&mut said);
                panic!("nothing is printed for {datagram:02x?}: {said}");
            }
        }
    }

    fn end(mut self) {
        let memory = peak_memory_kb(self.program.id());
        let pid = nix::unistd::Pid::from_raw(self.program.id() as i32);
        nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGTERM).unwrap();
        let status = self.program.wait().unwrap();
        let mut said = String::new();
        self.program.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        assert_eq!((status.code(), said.as_str()), (Some(0), ""));
        assert!(memory < MAX_MEMORY_KB, "{memory} kB");
    }
}

impl Drop for Listener {
    /// A failing test leaves no program behind.
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

#[test]
fn every_datagram_is_one_printable_line() {
    for protocol in PROTOCOLS {
        let (good, mut mutator, mut listener) = (good(protocol), Mutator::new(13), Listener::start(protocol));
        let (mut understood, begun, mut longest) = (0, Instant::now(), Duration::ZERO);
        for _ in 0..inputs() {
            let damaged = mutator.input(&good);
            let datagram = if mutator.below(4) > 0 { repaired(protocol, damaged) } else { damaged };
            let sent = Instant::now();
            let line = listener.line(&datagram);
            longest = longest.max(sent.elapsed());
            let text = line.strip_suffix('\n').expect("a whole line");
            assert!(text.starts_with("127.0.0.1:") && text.chars().all(stands_for_itself), "{text:?} of {datagram:02x?}");
            understood += u64::from(!text.contains(&format!(" {} bytes: ", datagram.len())));
        }
        // The damage reaches the code behind the first checks, and also triggers the checks.
        assert!(understood > inputs() / 20 && understood < inputs(), "{protocol}: {understood} of {} understood", inputs());
        let memory = peak_memory_kb(listener.program.id());
        listener.end();
        println!(
            "listen {protocol}: {} datagrams, {understood} understood, {:.1} s, longest {:.0} ms, {memory} kB",
            inputs(),
            begun.elapsed().as_secs_f64(),
            longest.as_secs_f64() * 1e3
        );
    }
}

#[test]
fn datagrams_found_by_hand_are_one_printable_line() {
    let mut osc = Listener::start("osc");
    let immediately = b"/a\0\0,t\0\0\0\0\0\0\0\0\0\x01";
    assert!(osc.line(immediately).ends_with(" /a (t) immediately\n"));
    let title = b"/\x1b]0;owned\x07\0,s\0\0a\nb\xc2\x9b\0\0\0";
    let line = osc.line(title);
    assert!(line.ends_with(" /\\u001b]0;owned\\u0007 a\\nb\\u009b\n"), "{line:?}");
    let arrays = [b"/a\0\0,".as_slice(), &b"[".repeat(28_000), &b"]".repeat(28_000), b"\0\0\0"].concat();
    assert!(osc.line(&arrays).contains("deep"));
    assert!(osc.line(b"").contains(" 0 bytes: "));
    osc.end();
}
