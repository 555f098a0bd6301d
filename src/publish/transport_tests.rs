use std::io::Read;
use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

use super::*;

fn udp_to(to: Vec<SocketAddr>) -> UdpSettings {
    UdpSettings { to, ..UdpSettings::default() }
}

fn receiver() -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    socket
}

#[test]
fn a_closed_port_changes_nothing_for_the_others() {
    let (open, closed) = (receiver(), receiver().local_addr().unwrap());
    let mut transport = Transport::open("desk", &udp_to(vec![closed, open.local_addr().unwrap()]), None, None).unwrap();
    let mut buffer = [0; 64];
    for k in 0..20_u8 {
        transport.send(&[k; 5]);
        assert_eq!(open.recv(&mut buffer).unwrap(), 5);
        assert_eq!(buffer[0], k);
    }
}

#[test]
fn a_multicast_reaches_a_member_on_the_interface() {
    let group = Ipv4Addr::new(239, 135, 1, 77);
    let member = UdpSocket::bind("0.0.0.0:0").unwrap();
    member.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    member.join_multicast_v4(&group, &Ipv4Addr::LOCALHOST).unwrap();
    let to = SocketAddr::from((group, member.local_addr().unwrap().port()));
    let udp = UdpSettings { to: vec![to], interface: Some(Interface::Address(Ipv4Addr::LOCALHOST)), ttl: 1 };
    let mut transport = Transport::open("desk", &udp, None, None).unwrap();
    assert_eq!(transport.send(b"hello"), (1, 0));
    let mut buffer = [0; 64];
    assert_eq!(member.recv(&mut buffer).unwrap(), 5);
}

#[test]
fn ipv4_and_ipv6_are_sent_and_a_missing_network_reported() {
    // Skip if this machine has no IPv6.
    let Ok(v6) = UdpSocket::bind("[::1]:0") else { return };
    let v4 = receiver();
    v6.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let to = vec![v4.local_addr().unwrap(), v6.local_addr().unwrap()];
    let mut transport = Transport::open("desk", &udp_to(to), None, None).unwrap();
    assert_eq!(transport.send(b"hello"), (2, 0));
    let mut buffer = [0; 64];
    assert_eq!((v4.recv(&mut buffer).unwrap(), v6.recv(&mut buffer).unwrap()), (5, 5));

    let to = vec!["[ff12::77]:40000".parse().unwrap()];
    let missing = UdpSettings { to, interface: Some(Interface::Name("nonet7".to_owned())), ttl: 1 };
    let said = Transport::open("desk", &missing, None, None).map(drop).unwrap_err().to_string();
    assert!(said.contains("this machine has no network nonet7"), "{said}");
}

fn lines_on(address: &str) -> StreamSettings {
    StreamSettings { tcp_listen: Some(address.parse().unwrap()), file: None }
}

fn address(transport: &Transport) -> SocketAddr {
    transport.clients.as_ref().unwrap().listener.local_addr().unwrap()
}

fn wait_for_clients(transport: &mut Transport, count: usize) {
    let begun = Instant::now();
    while transport.clients.as_ref().unwrap().clients.len() < count {
        assert!(begun.elapsed() < Duration::from_secs(10), "no client came");
        transport.attend();
    }
}

#[test]
fn a_client_that_does_not_read_is_dropped_without_delay() {
    let mut transport = Transport::open("desk", &UdpSettings::default(), Some(&lines_on("127.0.0.1:0")), None).unwrap();
    let sleeper = TcpStream::connect(address(&transport)).unwrap();
    wait_for_clients(&mut transport, 1);
    let mut reader = TcpStream::connect(address(&transport)).unwrap();
    wait_for_clients(&mut transport, 2);
    let line = [b'x'; 4096];
    let mut buffer = [0; 4096];
    let mut sent = 0;
    while transport.clients.as_ref().unwrap().clients.len() == 2 {
        transport.send(&line);
        reader.read_exact(&mut buffer).unwrap();
        sent += 1;
        assert!(sent < 100_000, "the sleeper is never disconnected");
    }
    transport.send(b"more");
    reader.read_exact(&mut buffer[..4]).unwrap();
    assert_eq!(&buffer[..4], b"more");
    drop(sleeper);
}

#[test]
fn a_client_that_leaves_is_forgotten() {
    let mut transport = Transport::open("desk", &UdpSettings::default(), Some(&lines_on("127.0.0.1:0")), None).unwrap();
    drop(TcpStream::connect(address(&transport)).unwrap());
    wait_for_clients(&mut transport, 1);
    let begun = Instant::now();
    while !transport.clients.as_ref().unwrap().clients.is_empty() {
        assert!(begun.elapsed() < Duration::from_secs(10));
        transport.send(b"line\n");
    }
    assert_eq!(transport.send(b"line\n"), (0, 0));
}

#[test]
fn a_port_in_use_and_a_bad_file_are_refused_with_their_names() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = taken.local_addr().unwrap().to_string();
    let refusal = Transport::open("desk", &UdpSettings::default(), Some(&lines_on(&at)), None).err().unwrap().to_string();
    assert!(refusal.contains(&at) && refusal.contains("free port"), "{refusal}");
    let stream = StreamSettings { tcp_listen: None, file: Some("no-such-folder/poses.jsonl".into()) };
    let refusal = Transport::open("desk", &UdpSettings::default(), Some(&stream), None).err().unwrap().to_string();
    assert!(refusal.contains("no-such-folder/poses.jsonl"), "{refusal}");
}
