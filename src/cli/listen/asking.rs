//! Asks OTP's producers for all modules, as every consumer must.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use socket2::Domain;
use uuid::Builder;

use crate::protocols::otp::{OtpError, OtpHeader, OtpMessage, OtpModule};
use crate::publish::{Interface, udp_sender};

/// Interval between questions (table A-2 of ANSI E1.59-2021).
const EVERY: Duration = Duration::from_secs(10);

/// A consumer that asks.
pub(super) struct Asking {
    socket: UdpSocket,
    to: SocketAddr,
    asked: Option<Instant>,
    folio: u32,
}

impl Asking {
    /// Opens a socket that asks at an address, multicast on `interface`.
    pub fn new(to: SocketAddr, interface: Option<&Interface>) -> io::Result<Self> {
        let socket = udp_sender(Domain::for_address(to), interface)?;
        Ok(Self { socket: socket.into(), to, asked: None, folio: 0 })
    }

    /// Asks, if it is time to. A question that cannot be sent is repeated with the next.
    pub fn ask_if_due(&mut self) {
        if self.asked.is_some_and(|asked| asked.elapsed() < EVERY) {
            return;
        }
        self.asked = Some(Instant::now());
        if let Ok(packet) = question(self.folio) {
            let _ = self.socket.send_to(&packet, self.to);
        }
        self.folio = self.folio.wrapping_add(1);
    }
}

/// Returns the packet that asks for all of the standard's modules.
fn question(folio: u32) -> Result<Vec<u8>, OtpError> {
    // One identifier for every program of this kind: producers only need to know what is asked for.
    let cid = Builder::from_random_bytes(*b"stagepose listen").into_uuid().into_bytes();
    let header = OtpHeader { cid, folio, component: "stagepose listen".to_owned(), ..OtpHeader::default() };
    OtpMessage::Modules(OtpModule::STANDARD.to_vec()).encode(&header)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_asks_at_once_and_then_every_ten_seconds() {
        let producer = UdpSocket::bind("127.0.0.1:0").unwrap();
        producer.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let mut asking = Asking::new(producer.local_addr().unwrap(), None).unwrap();
        asking.ask_if_due();
        asking.ask_if_due();
        let mut buffer = [0; 2048];
        let length = producer.recv(&mut buffer).unwrap();
        let (header, message) = OtpMessage::decode(&buffer[..length]).unwrap();
        assert_eq!((header.folio, message), (0, OtpMessage::Modules(OtpModule::STANDARD.to_vec())));
        producer.set_nonblocking(true).unwrap();
        assert!(producer.recv(&mut buffer).is_err());
        asking.asked = Instant::now().checked_sub(EVERY);
        asking.ask_if_due();
        producer.set_nonblocking(false).unwrap();
        assert!(producer.recv(&mut buffer).is_ok());
    }
}
