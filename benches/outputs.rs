//! Latency of outputs: eight of them at 240 Hz, alone and beside a TCP client that does not read,
//! an unused port and a full socket.
//!
//! `cargo bench --bench outputs` prints, over all samples, the time from `Publisher::send` to the
//! arrival of the sample's last datagram at a socket of this machine, and how long `send` itself
//! blocks the caller. `cargo bench --bench outputs -- --seconds 20` runs longer.

use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use stagepose::diagnostics::publish::{
    BodyChoice, ClipStart, Context, FreedSettings, JsonSettings, OnLoss, OpenTrackIoSettings, OscMessageKind, OscSettings, OutputSettings,
    Placement, Protocol, PsnSettings, Publisher, Rate, SafetySettings, Spare, Stamps, StreamSettings, UdpSettings,
};
use stagepose::protocols::opentrackio::Encoding;
use stagepose::protocols::opentrackio_lens::PrincipalPoint;
use stagepose::protocols::to_camera_axes;
use stagepose::{CameraModel, Pose, PoseSample, State, Timestamp};

const HZ: f64 = 240.0;

fn main() {
    let seconds = std::env::args().skip_while(|a| a != "--seconds").nth(1).and_then(|s| s.parse().ok()).unwrap_or(5.0);
    let frames = (seconds * HZ) as u64;
    let receivers: Vec<UdpSocket> = (0..8).map(|_| receiver()).collect();
    let ports: Vec<SocketAddr> = receivers.iter().map(address).collect();
    for burdened in [false, true] {
        let (outputs, _trouble) = outputs(&ports, burdened);
        let (sender, arrivals) = mpsc::channel();
        let threads: Vec<_> =
            receivers.iter().map(|r| listen(r.try_clone().expect("a socket can be cloned"), sender.clone(), frames)).collect();
        drop(sender);
        let (sent, held_up) = send(&outputs, frames);
        for thread in threads {
            thread.join().expect("a receiver does not panic");
        }
        // The last datagram of each sample.
        let mut last = vec![Duration::ZERO; sent.len()];
        let mut counted = 0;
        for (index, at) in arrivals {
            if let (Some(slot), Some(begun)) = (last.get_mut(index), sent.get(index)) {
                *slot = (*slot).max(at.saturating_duration_since(*begun));
                counted += 1;
            }
        }
        let what = if burdened { "with a dead TCP client, a closed port and a full buffer" } else { "alone" };
        println!("8 outputs x {HZ} Hz, {frames} samples, {what}: {counted} datagrams of {}", frames * 8);
        print_line("send to last datagram", last);
        print_line("the caller is held up", held_up);
    }
}

fn receiver() -> UdpSocket {
    let socket =
        socket2::SockRef::from(&UdpSocket::bind("127.0.0.1:0").expect("loopback has ports")).try_clone().expect("a socket can be cloned");
    socket.set_recv_buffer_size(4 << 20).expect("a buffer can be asked for");
    socket.set_read_timeout(Some(Duration::from_secs(2))).expect("a time limit can be set");
    socket.into()
}

fn address(socket: &UdpSocket) -> SocketAddr {
    socket.local_addr().expect("a bound socket has an address")
}

/// Records when each datagram arrives; they come in order, one per sample.
fn listen(socket: UdpSocket, arrivals: mpsc::Sender<(usize, Instant)>, frames: u64) -> std::thread::JoinHandle<()> {
    std::thread::spawn(move || {
        let mut buffer = [0; 65_536];
        let mut index = 0;
        while index < frames as usize {
            match socket.recv(&mut buffer) {
                // PSN sends its names once a second in addition to the data.
                Ok(n) if n > 1 && buffer[..2] == [0x56, 0x67] => {}
                Ok(_) => {
                    let _ = arrivals.send((index, Instant::now()));
                    index += 1;
                }
                Err(_) => return,
            }
        }
    })
}

/// Sends at a steady pace; returns when each sample was sent and how long that took.
fn send(outputs: &[OutputSettings], frames: u64) -> (Vec<Instant>, Vec<Duration>) {
    let context = Context {
        camera: CameraModel::pinhole(1280, 720, 900.0, 900.0, 639.5, 359.5).expect("good intrinsics"),
        objects: Vec::new(),
        mount: None,
        safety: SafetySettings::default(),
        stamps: Stamps::Recorded(ClipStart::default()),
        timecode: None,
        frame_rate: Some(HZ),
        rings: None,
        is_test: false,
    };
    let publisher = Publisher::start(outputs, &context).expect("loopback takes outputs");
    std::thread::sleep(Duration::from_millis(200));
    let begun = Instant::now();
    let (mut sent, mut held_up) = (Vec::new(), Vec::new());
    for k in 0..frames {
        let due = Duration::from_secs_f64(k as f64 / HZ);
        std::thread::sleep(due.saturating_sub(begun.elapsed()));
        let sample = sample(k);
        let at = Instant::now();
        publisher.send(&sample);
        held_up.push(at.elapsed());
        sent.push(at);
    }
    for output in publisher.close() {
        if output.dropped + output.failed > 0 {
            println!("  {}: {} dropped, {} failed", output.name, output.dropped, output.failed);
        }
    }
    (sent, held_up)
}

fn sample(k: u64) -> PoseSample {
    let angle = k as f64 * 1e-3;
    let body = Pose::new(nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, angle.sin()), Vector3::new(angle.sin(), -4.0, 1.6));
    let mut sample = PoseSample::new(k, Timestamp::from_seconds(k as f64 / HZ), State::Tracking);
    sample.pose = Some(to_camera_axes(&body));
    sample
}

/// What must stay open while the outputs run.
type Trouble = Option<UdpSocket>;

fn outputs(ports: &[SocketAddr], burdened: bool) -> (Vec<OutputSettings>, Trouble) {
    let (freed, otrk) =
        (Protocol::Freed(FreedSettings { camera_id: 1, spare: Spare::Quality, zoom: None, sensor_width_mm: 4.8, focus: 0 }), |encoding| {
            Protocol::OpenTrackIo(OpenTrackIoSettings {
                encoding,
                source_number: 1,
                sensor_width_mm: 4.8,
                principal_point: PrincipalPoint::Both,
            })
        });
    let psn = Protocol::Psn(PsnSettings { system: "bench".to_owned(), first_tracker: 1 });
    let osc = |messages: &[OscMessageKind]| {
        Protocol::Osc(OscSettings { prefix: "/bench".to_owned(), messages: messages.to_vec(), values: Vec::new() })
    };
    let all = [OscMessageKind::Pose, OscMessageKind::Quaternion, OscMessageKind::Status];
    let protocols = [
        freed.clone(),
        otrk(Encoding::Json),
        otrk(Encoding::Cbor),
        psn,
        osc(&all),
        osc(&all[..1]),
        Protocol::Json(JsonSettings::default()),
        freed,
    ];
    let mut outputs: Vec<OutputSettings> =
        protocols.into_iter().zip(ports).enumerate().map(|(k, (p, to))| output(k, p, vec![*to])).collect();
    if !burdened {
        return (outputs, None);
    }
    // A client that connects and never reads, an unused port, and a socket whose buffer is full and
    // stays full.
    let listen = TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).expect("loopback has ports");
    let stream = StreamSettings { tcp_listen: Some(listen), file: None };
    outputs.push(output(8, Protocol::Json(JsonSettings { stream }), Vec::new()));
    let full = UdpSocket::bind("127.0.0.1:0").expect("loopback has ports");
    let closed = address(&receiver());
    outputs.push(output(9, Protocol::Json(JsonSettings::default()), vec![closed, address(&full)]));
    // The client connects once the publisher listens, and then sleeps until the bench ends.
    std::thread::spawn(move || {
        let connected = std::iter::repeat_with(|| TcpStream::connect(listen)).find_map(Result::ok);
        std::thread::sleep(Duration::from_secs(3600));
        drop(connected);
    });
    (outputs, Some(full))
}

fn output(k: usize, protocol: Protocol, to: Vec<SocketAddr>) -> OutputSettings {
    OutputSettings {
        name: format!("{}-{k}", protocol.word()),
        enabled: true,
        protocol,
        udp: UdpSettings { to, ..UdpSettings::default() },
        bodies: vec![BodyChoice::Camera],
        rate: Rate::Every(1),
        delay: Duration::ZERO,
        on_loss: OnLoss::Stop,
        placement: Placement::default(),
        is_guarded: true,
        passes_rings: false,
    }
}

fn print_line(what: &str, mut values: Vec<Duration>) {
    values.sort();
    let at = |share: f64| values.get(((values.len() - 1) as f64 * share) as usize).map_or(0.0, |d| d.as_secs_f64() * 1e3);
    println!("  {what}: p50 {:.3} ms, p99 {:.3} ms, max {:.3} ms", at(0.5), at(0.99), at(1.0));
}
