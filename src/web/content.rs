//! The content of requests, in pieces: a large file is never in memory as a whole.

use std::io::{self, Read};
use std::pin::Pin;
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes, HttpBody};
use tokio::sync::mpsc;
use tokio::time::timeout;

use super::reply::Reply;

/// Maximum time for the next piece of a request's content. Chosen: longer than a wireless network's
/// hiccup. Raised, a silent client holds a thread longer.
const ARRIVES_WITHIN: Duration = Duration::from_secs(5);
/// Maximum time for the whole content, plus a second for each [`SLOWEST`] bytes received. Chosen: a
/// bad wireless network is faster. Raised, a client that trickles bytes holds a connection longer;
/// lowered, slow honest clients are cut off.
const ARRIVES_WHOLE_WITHIN: Duration = Duration::from_secs(20);
/// Bytes per second below which a content is eventually cut off: a telephone line. Raised, honest
/// uploads over bad networks fail.
const SLOWEST: u64 = 8 * 1024;
/// Maximum pieces queued between the connection and the reader. A round figure; raised, more
/// memory.
const PIECES: usize = 4;

/// A request's content, read on another thread than the one it arrives on.
#[derive(Debug)]
pub(super) struct Upload {
    /// Pieces still to come.
    pieces: Option<mpsc::Receiver<io::Result<Bytes>>>,
    rest: Bytes,
}

impl Upload {
    /// Returns an upload and the channel that fills it.
    pub fn channel() -> (mpsc::Sender<io::Result<Bytes>>, Self) {
        let (to, pieces) = mpsc::channel(PIECES);
        (to, Self { pieces: Some(pieces), rest: Bytes::new() })
    }

    /// Returns an upload whose content has already arrived.
    pub fn whole(content: Vec<u8>) -> Self {
        Self { pieces: None, rest: content.into() }
    }
}

/// The deadline of a content, depending on how much has arrived.
struct Deadline {
    begun: Instant,
    bytes: u64,
}

impl Deadline {
    fn begin() -> Self {
        Self { begun: Instant::now(), bytes: 0 }
    }

    /// Returns the time left for the next piece; zero if there is none.
    fn left(&self) -> Duration {
        let whole = ARRIVES_WHOLE_WITHIN + Duration::from_secs(self.bytes / SLOWEST);
        whole.saturating_sub(self.begun.elapsed()).min(ARRIVES_WITHIN)
    }
}

/// Returns the next bytes of a content, if they arrive in time; `None` at its end.
async fn next_piece(body: &mut Body, deadline: &mut Deadline) -> io::Result<Option<Bytes>> {
    loop {
        let next = std::future::poll_fn(|cx| Pin::new(&mut *body).poll_frame(cx));
        match timeout(deadline.left(), next).await {
            Ok(None) => return Ok(None),
            Ok(Some(Ok(frame))) => {
                // Trailers are ignored.
                if let Ok(bytes) = frame.into_data() {
                    deadline.bytes += bytes.len() as u64;
                    return Ok(Some(bytes));
                }
            }
            Ok(Some(Err(error))) => return Err(io::Error::other(error)),
            Err(_) => return Err(io::ErrorKind::TimedOut.into()),
        }
    }
}

/// Reads a whole content of at most this length; a longer one is not read to its end.
///
/// # Errors
/// The reply, if it is longer, broke off, or did not arrive in time.
pub(super) async fn gathered(mut body: Body, most_bytes: u64) -> Result<Vec<u8>, Reply> {
    if body.size_hint().lower() > most_bytes {
        return Err(too_large(most_bytes));
    }
    let (mut whole, mut deadline) = (Vec::new(), Deadline::begin());
    while let Some(piece) = next_piece(&mut body, &mut deadline).await.map_err(|e| not_arrived(&e))? {
        if deadline.bytes > most_bytes {
            return Err(too_large(most_bytes));
        }
        whole.extend_from_slice(&piece);
    }
    Ok(whole)
}

impl Read for Upload {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        while self.rest.is_empty() {
            match self.pieces.as_mut().and_then(mpsc::Receiver::blocking_recv) {
                Some(piece) => self.rest = piece?,
                None => return Ok(0),
            }
        }
        let n = self.rest.len().min(into.len());
        into[..n].copy_from_slice(&self.rest.split_to(n));
        Ok(n)
    }
}

/// Returns the reply for content above its limit.
pub(super) fn too_large(most_bytes: u64) -> Reply {
    if most_bytes == 0 {
        return Reply::text(413, "this request has no content\n");
    }
    let limit = if most_bytes >= 1 << 20 { format!("{} MB", most_bytes >> 20) } else { format!("{most_bytes} bytes") };
    Reply::text(413, format!("the content is larger than the limit of {limit}\n"))
}

/// Returns the reply for content that did not arrive.
pub(super) fn not_arrived(error: &io::Error) -> Reply {
    match error.kind() {
        io::ErrorKind::TimedOut => Reply::text(408, "the content did not come in time; send it again\n"),
        _ => Reply::text(400, "the content broke off; send it again\n"),
    }
}

/// Forwards a request's content to its reader, until either ends.
pub(super) async fn pump(mut body: Body, to: mpsc::Sender<io::Result<Bytes>>) {
    let mut deadline = Deadline::begin();
    loop {
        let piece = match next_piece(&mut body, &mut deadline).await {
            Ok(None) => return,
            Ok(Some(bytes)) => Ok(bytes),
            Err(error) => Err(error),
        };
        let is_over = piece.is_err();
        if to.send(piece).await.is_err() || is_over {
            return;
        }
    }
}
