use std::net::UdpSocket;

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::daemon::live::Event;
use crate::protocols::PanTiltRoll;
use crate::protocols::camera_packet::{Ring, Spoken};
use crate::protocols::freed::FreedPacket;

/// A reader on a free port of this machine, and a socket that sends to it.
fn reader(spoken: Spoken) -> (OtherTrackerReader, UdpSocket) {
    let listen = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let reader = OtherTrackerReader::start(OtherTrackerSettings { spoken, listen, interface: None, zoom_range: None }).unwrap();
    let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
    sender.connect(listen).unwrap();
    (reader, sender)
}

/// Looks until the state is this one, sending a packet before each look.
fn wait_for(state: &str, reader: &OtherTrackerReader, link: &LiveLink, mut send: impl FnMut()) {
    let begun = Instant::now();
    loop {
        send();
        std::thread::sleep(LOOK_EVERY);
        reader.look(link);
        let status = link.statistics.other_tracker().unwrap();
        if status.state == state {
            return;
        }
        assert!(begun.elapsed() < Duration::from_secs(20), "{status:?}");
    }
}

#[test]
fn states_are_published_as_they_change() {
    let (link, (reader, sender)) = (LiveLink::default(), reader(Spoken::Freed(Some(2))));
    let events = link.events.listen();
    let packet = |camera_id| FreedPacket { camera_id, ..FreedPacket::default() }.encode().0;
    wait_for("never heard", &reader, &link, || {});
    wait_for("unreadable", &reader, &link, || drop(sender.send(b"hello")));
    wait_for("other source", &reader, &link, || drop(sender.send(&packet(1))));
    wait_for("heard", &reader, &link, || {
        drop(sender.send(&FreedPacket { camera_id: 2, zoom: 7, focus: 8, ..FreedPacket::default() }.encode().0))
    });
    // Foreign packets change no ring.
    let _ = sender.send(&packet(1));
    assert_eq!((reader.rings().get().zoom, reader.rings().get().focus), (Some(Ring::Raw(7.0)), Some(Ring::Raw(8.0))));
    wait_for("stale", &reader, &link, || {});
    let said: Vec<(String, String)> = events
        .try_iter()
        .filter_map(|event| match event.event {
            Event::OtherTracker { state, text, .. } => Some((state.into_owned(), text)),
            _ => None,
        })
        .collect();
    let states: Vec<&str> = said.iter().map(|(state, _)| state.as_str()).collect();
    assert_eq!(states, ["never heard", "unreadable", "other source", "heard", "stale"], "{said:?}");
    assert!(said[2].1.contains("camera_id"), "{}", said[2].1);
}

#[test]
fn a_taken_port_is_named_and_taken_up_when_it_is_free() {
    let held = UdpSocket::bind("127.0.0.1:0").unwrap();
    let settings =
        OtherTrackerSettings { spoken: Spoken::Freed(None), listen: held.local_addr().unwrap(), interface: None, zoom_range: None };
    let (link, reader) = (LiveLink::default(), OtherTrackerReader::start(settings.clone()).unwrap());
    let begun = Instant::now();
    let said = loop {
        std::thread::sleep(LOOK_EVERY);
        reader.look(&link);
        let status = link.statistics.other_tracker().unwrap();
        if status.sentence.contains("cannot listen") || begun.elapsed() > Duration::from_secs(20) {
            break status;
        }
    };
    assert!(said.sentence.contains(&settings.listen.to_string()) && said.hint.unwrap().contains("`listen`"));
    drop(held);
    let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
    let packet = FreedPacket::default().encode().0;
    wait_for("heard", &reader, &link, || drop(sender.send_to(&packet, settings.listen)));
}

#[test]
fn a_comparison_becomes_the_status() {
    let (link, (reader, sender)) = (LiveLink::default(), reader(Spoken::Freed(None)));
    // Both trackers have seen the same motion, and FreeD's axes are the body's.
    let now = monotonic_now();
    {
        let mut known = reader.shared.known();
        for k in 0..300 {
            let t = f64::from(k) / 30.0;
            let at = now.after_s(t - 10.0);
            let rotation = UnitQuaternion::from_euler_angles(0.2 * (1.3 * t).sin(), 0.15 * (2.1 * t).cos(), 0.5 * (0.9 * t).sin());
            let position = Vector3::new(0.8 * (0.7 * t).sin(), -4.0 + 0.4 * (1.1 * t).cos(), 1.6);
            known.beside.add_ours(LoggedPose { at, rotation, position });
            let angles = PanTiltRoll::of_rotation(&rotation, 0.0);
            known.beside.add_others(LoggedPose { at, rotation: angles.rotation(), position });
        }
        let compared = known.beside.compare();
        known.compared = Some(compared);
    }
    wait_for("heard", &reader, &link, || drop(sender.send(&FreedPacket::default().encode().0)));
    let status = link.statistics.other_tracker().unwrap();
    let difference = status.difference.unwrap();
    assert!(difference.verdict == "good" && difference.rms_m < 1e-3 && status.hint.is_none(), "{difference:?}");
    assert!(status.sentence.contains("FreeD camera 0 differs by 0.0 mm"), "{}", status.sentence);
}
