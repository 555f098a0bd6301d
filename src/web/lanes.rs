//! Queues for requests that take time: a few are processed at once, in lanes that do not wait for
//! each other.
//!
//! Health and session share a lane of their own, and so do changes, readings and large files. In a
//! lane each peer has a limited share, so that one peer's requests, however many and slow, leave
//! room for others. While it waits, a request holds no thread; it gets no turn before its content
//! has arrived.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

use super::connection::Connection;
use super::places::network_of;
use super::reply::Reply;

/// Maximum wait for a turn. Chosen: longer than any single answer takes. Raised, answers come that
/// nobody waits for any more.
const WAITS_AT_MOST: Duration = Duration::from_secs(30);
/// Maximum wait behind a large file, which takes minutes over a slow network: several set models
/// may be sent at once. Raised, uploads wait longer before they fail.
const WAITS_FOR_FILES: Duration = Duration::from_secs(600);

/// The lane of a route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lane {
    /// Quick status queries.
    Probe,
    /// Changes.
    Change,
    /// Reads, which may take seconds.
    Look,
    /// A large file that is written to the disk as it arrives.
    File,
}

impl Lane {
    /// All lanes.
    const ALL: [Self; 4] = [Self::Probe, Self::Change, Self::Look, Self::File];

    /// Returns the number of concurrent requests, and how many of them one peer may have. Chosen
    /// for the smallest machine: more would only compete. Raised, more memory and threads at once.
    fn limits(self) -> (usize, usize) {
        match self {
            Self::Probe | Self::Change => (2, 1),
            Self::Look => (3, 2),
            Self::File => (2, 1),
        }
    }
}

/// Returns the number of threads that all lanes together may need.
pub(super) fn most_threads() -> usize {
    Lane::ALL.iter().map(|lane| lane.limits().0).sum()
}

/// All lanes.
#[derive(Debug)]
pub(super) struct Lanes(Vec<(Lane, Queue)>);

/// One lane.
#[derive(Debug)]
struct Queue {
    all: Arc<Semaphore>,
    share: usize,
    peers: Arc<Mutex<HashMap<IpAddr, Peer>>>,
}

/// A peer's share of a lane.
#[derive(Debug)]
struct Peer {
    /// Number of its requests that wait or are being processed.
    requests: usize,
    share: Arc<Semaphore>,
}

/// A request's turn, until it is dropped.
#[derive(Debug)]
pub(super) struct Turn {
    _of_all: OwnedSemaphorePermit,
    _of_peer: OwnedSemaphorePermit,
    _counted: Counted,
}

/// Keeps a peer's entry while it has requests.
#[derive(Debug)]
struct Counted {
    peer: IpAddr,
    peers: Arc<Mutex<HashMap<IpAddr, Peer>>>,
}

impl Drop for Counted {
    fn drop(&mut self) {
        let mut peers = self.peers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(peer) = peers.get_mut(&self.peer) {
            peer.requests -= 1;
            if peer.requests == 0 {
                peers.remove(&self.peer);
            }
        }
    }
}

impl Lanes {
    pub fn new() -> Self {
        let queue = |lane: Lane| {
            let (all, share) = lane.limits();
            Queue { all: Arc::new(Semaphore::new(all)), share, peers: Arc::default() }
        };
        Self(Lane::ALL.into_iter().map(|lane| (lane, queue(lane))).collect())
    }

    /// Waits for this peer's turn in a lane.
    ///
    /// # Errors
    /// When it takes too long, or the client has gone meanwhile.
    pub async fn turn(&self, lane: Lane, peer: IpAddr, client: Option<&Connection>) -> Result<Turn, Reply> {
        let busy = || Reply::text(503, "the daemon is busy with other requests; ask again in a moment\n").with("retry-after", "5");
        let queue = self.0.iter().find(|(of, _)| *of == lane).map(|(_, queue)| queue).ok_or_else(busy)?;
        let patience = if lane == Lane::File { WAITS_FOR_FILES } else { WAITS_AT_MOST };
        let gone = async {
            match client {
                Some(client) => client.gone().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            turn = timeout(patience, queue.turn(network_of(peer))) => turn.ok().flatten().ok_or_else(busy),
            // The client is gone, so nobody sees this.
            () = gone => Err(busy()),
        }
    }
}

impl Queue {
    /// Returns this peer's next turn; the semaphores are never closed.
    async fn turn(&self, peer: IpAddr) -> Option<Turn> {
        let (share, counted) = {
            let mut peers = self.peers.lock().unwrap_or_else(PoisonError::into_inner);
            let of_peer = peers.entry(peer).or_insert_with(|| Peer { requests: 0, share: Arc::new(Semaphore::new(self.share)) });
            of_peer.requests += 1;
            (of_peer.share.clone(), Counted { peer, peers: self.peers.clone() })
        };
        let of_peer = share.acquire_owned().await.ok()?;
        let of_all = self.all.clone().acquire_owned().await.ok()?;
        Some(Turn { _of_all: of_all, _of_peer: of_peer, _counted: counted })
    }
}

#[cfg(test)]
mod tests {
    use tokio::time::sleep;

    use super::*;

    fn runtime() -> tokio::runtime::Runtime {
        tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
    }

    #[test]
    fn peers_and_lanes_do_not_block_each_other() {
        let (lanes, [one, other]) = (Lanes::new(), ["192.0.2.1", "192.0.2.2"].map(|peer| peer.parse::<IpAddr>().unwrap()));
        runtime().block_on(async {
            for lane in Lane::ALL {
                let share = lane.limits().1;
                let mut held = Vec::new();
                for _ in 0..share {
                    held.push(lanes.turn(lane, one, None).await.unwrap());
                }
                // It has its share and waits for more; the other peer does not wait.
                let more = lanes.turn(lane, one, None);
                tokio::select! {
                    biased;
                    _ = more => panic!("{lane:?}: more than its share"),
                    turn = lanes.turn(lane, other, None) => drop(turn.unwrap()),
                }
                drop(held.pop());
                drop(lanes.turn(lane, one, None).await.unwrap());
                drop(held);
            }
            assert!(lanes.0.iter().all(|(_, queue)| queue.peers.lock().unwrap().is_empty()), "peers are forgotten");
        });
    }

    #[test]
    fn waiting_for_a_lane_ends_when_the_client_disconnects() {
        let lanes = Lanes::new();
        runtime().block_on(async {
            let (server, client) = Connection::pair().await;
            let peer = "192.0.2.1".parse().unwrap();
            let (_first, _second) = (lanes.turn(Lane::Look, peer, None).await, lanes.turn(Lane::Look, peer, None).await);
            let waiting = lanes.turn(Lane::Look, peer, Some(&server));
            tokio::select! {
                _ = waiting => panic!("the client is there, and waits"),
                () = sleep(Duration::from_millis(600)) => {}
            }
            // A reset, as from a program that was killed while an answer was on its way.
            socket2::SockRef::from(&client).set_linger(Some(Duration::ZERO)).unwrap();
            drop(client);
            assert_eq!(lanes.turn(Lane::Look, peer, Some(&server)).await.unwrap_err().status, 503);
        });
    }
}
