//! Limits the number of connections.
//!
//! There is a number of places for lasting connections, and each peer has a limited share of them.
//! A client that finds no free place is still answered, briefly: one request within a moment, then
//! the connection ends. If there are too many brief connections, a new one pushes out the oldest of
//! the peer that has the most. So a health check is answered however many clients are connected,
//! whatever they do.

use std::collections::{HashMap, VecDeque};
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::AbortHandle;

/// Maximum number of lasting connections. Each holds a file and about 50 kB. Chosen: more than the
/// screens of a stage. Raised, more memory and files may be held.
const MAX_CONNECTIONS: usize = 64;
/// Maximum lasting connections of one peer: half, so that another gets in.
const MAX_OF_A_PEER: usize = MAX_CONNECTIONS / 2;
/// Maximum number of brief connections. One is pushed out before its request arrives only if that
/// many newer ones come within that time. Raised, more files are held.
const MAX_BRIEF: usize = 64;

/// The places for lasting connections.
#[derive(Debug)]
pub(super) struct Places {
    free: Arc<Semaphore>,
    taken: Arc<Mutex<HashMap<IpAddr, usize>>>,
}

/// A taken place, until it is dropped.
#[derive(Debug)]
pub(super) struct Place {
    peer: IpAddr,
    taken: Arc<Mutex<HashMap<IpAddr, usize>>>,
    _permit: OwnedSemaphorePermit,
}

impl Places {
    pub fn new() -> Self {
        Self { free: Arc::new(Semaphore::new(MAX_CONNECTIONS)), taken: Arc::default() }
    }

    /// Takes a place for this peer, if there is one.
    pub fn take(&self, peer: IpAddr) -> Option<Place> {
        let peer = network_of(peer);
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        if taken.get(&peer).is_some_and(|count| *count >= MAX_OF_A_PEER) {
            return None;
        }
        let permit = self.free.clone().try_acquire_owned().ok()?;
        *taken.entry(peer).or_default() += 1;
        Some(Place { peer, taken: self.taken.clone(), _permit: permit })
    }

    /// Waits until all places are free.
    pub async fn empty(&self) {
        // The semaphore is never closed, and 64 fits into any integer.
        let _ = self.free.acquire_many(MAX_CONNECTIONS as u32).await;
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = taken.get_mut(&self.peer) {
            *count -= 1;
            if *count == 0 {
                taken.remove(&self.peer);
            }
        }
    }
}

/// Returns what counts as one peer: an IPv4 address, or a 64-bit IPv6 network, of which a host may
/// use any address.
pub(super) fn network_of(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) => IpAddr::V6(Ipv6Addr::from_bits(v6.to_bits() >> 64 << 64)),
        v4 => v4,
    }
}

/// The connections without a place, oldest first.
#[derive(Debug, Default)]
pub(super) struct BriefOnes {
    running: VecDeque<(IpAddr, AbortHandle)>,
}

impl BriefOnes {
    /// Adds a connection. If there are too many, it ends the oldest of the peer that has the most.
    pub fn admit(&mut self, peer: IpAddr, newest: AbortHandle) {
        self.running.retain(|(_, task)| !task.is_finished());
        self.running.push_back((network_of(peer), newest));
        if self.running.len() <= MAX_BRIEF {
            return;
        }
        let count = |of: IpAddr| self.running.iter().filter(|(peer, _)| *peer == of).count();
        let oldest = (0..self.running.len()).rev().max_by_key(|k| count(self.running[*k].0));
        if let Some((_, task)) = oldest.and_then(|k| self.running.remove(k)) {
            task.abort();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_gets_no_more_than_its_share() {
        let places = Places::new();
        let (one, other): (IpAddr, IpAddr) = ("fe80::1:2".parse().unwrap(), "10.0.0.7".parse().unwrap());
        let neighbour = "fe80::7".parse().unwrap();
        let mut held: Vec<Place> = (0..MAX_OF_A_PEER).filter_map(|_| places.take(one)).collect();
        assert_eq!(held.len(), MAX_OF_A_PEER);
        assert!(places.take(one).is_none() && places.take(neighbour).is_none());
        held.extend((0..MAX_OF_A_PEER).filter_map(|_| places.take(other)));
        assert_eq!(held.len(), MAX_CONNECTIONS);
        assert!(places.take("10.0.0.8".parse().unwrap()).is_none());
        held.truncate(1);
        assert!(places.take("::ffff:10.0.0.7".parse().unwrap()).is_some());
        drop(held);
        assert!(places.taken.lock().unwrap().is_empty());
    }

    #[test]
    fn a_new_connection_evicts_the_busiest_peers_oldest() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(async {
            let mut brief = BriefOnes::default();
            let mut admit = |peer: &str| {
                let task = tokio::spawn(std::future::pending::<()>());
                brief.admit(peer.parse().unwrap(), task.abort_handle());
                task
            };
            let first = admit("10.0.0.1");
            let mut many: Vec<_> = (0..MAX_BRIEF + 1).map(|_| admit("10.0.0.2")).collect();
            let later = many.split_off(2);
            for task in many {
                assert!(task.await.unwrap_err().is_cancelled());
            }
            assert!(!first.is_finished() && later.iter().all(|task| !task.is_finished()));
        });
    }
}
