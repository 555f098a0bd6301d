//! The socket on which receivers ask an output for something (OTP's advertisements).

use std::io;
use std::net::{SocketAddr, UdpSocket};

use super::network::{Interface, udp_listener};

/// Maximum number of datagrams read at a time: a flood cannot hold the output up. Chosen: more than
/// the consumers of a stage send in a tenth of a second. Raised, a flood takes more time.
const MOST_AT_ONCE: usize = 64;
/// Maximum bytes of a datagram that is read whole; longer ones are no advertisements.
const MAX_DATAGRAM: usize = 2048;

/// A socket that never waits.
pub(super) struct Ear {
    socket: UdpSocket,
}

impl Ear {
    /// Opens a socket on a multicast group, which it joins on `interface`, or on an address of this
    /// machine.
    pub fn open(listen: SocketAddr, interface: Option<&Interface>) -> io::Result<Self> {
        let socket = udp_listener(listen, interface)?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket: socket.into() })
    }

    /// Returns what has arrived since the last call, with the senders' addresses.
    pub fn heard(&self) -> Vec<(SocketAddr, Vec<u8>)> {
        let mut buffer = [0; MAX_DATAGRAM];
        // An error with one datagram (a refusal of an answer) is not the end.
        let read = || self.socket.recv_from(&mut buffer).map(|(length, from)| (from, buffer[..length].to_vec()));
        std::iter::repeat_with(read)
            .take(MOST_AT_ONCE)
            .take_while(|read| !matches!(read, Err(e) if e.kind() == io::ErrorKind::WouldBlock))
            .flatten()
            .collect()
    }

    /// Sends an answer; returns whether the system accepted it.
    pub fn answer(&self, to: SocketAddr, packet: &[u8]) -> bool {
        self.socket.send_to(packet, to).is_ok()
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;
    use std::time::{Duration, Instant};

    use socket2::{Domain, Socket, Type};

    use super::*;

    /// Waits for a datagram, which the system may deliver a little later.
    fn heard(ear: &Ear) -> Vec<(SocketAddr, Vec<u8>)> {
        let begun = Instant::now();
        loop {
            let heard = ear.heard();
            if !heard.is_empty() || begun.elapsed() > Duration::from_secs(10) {
                return heard;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn what_is_asked_is_heard_and_answered() {
        let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let ear = Ear::open(free, None).unwrap();
        assert!(ear.heard().is_empty());
        let console = UdpSocket::bind("127.0.0.1:0").unwrap();
        console.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        console.send_to(b"who?", free).unwrap();
        let heard = heard(&ear);
        assert_eq!(heard, [(console.local_addr().unwrap(), b"who?".to_vec())]);
        assert!(ear.answer(heard[0].0, b"me"));
        let mut buffer = [0; 16];
        assert_eq!(console.recv(&mut buffer).unwrap(), 2);
    }

    #[test]
    fn a_group_is_shared_with_other_programs() {
        let group = "239.159.2.1:47568".parse().unwrap();
        let loopback = Interface::Address(Ipv4Addr::LOCALHOST);
        let ears = [(); 2].map(|()| Ear::open(group, Some(&loopback)).unwrap());
        let console = Socket::new(Domain::IPV4, Type::DGRAM, None).unwrap();
        console.set_multicast_if_v4(&Ipv4Addr::LOCALHOST).unwrap();
        console.set_multicast_loop_v4(true).unwrap();
        console.send_to(b"who?", &group.into()).unwrap();
        assert!(ears.iter().all(|ear| heard(ear).len() == 1));
    }
}
