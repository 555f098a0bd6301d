//! What comes with a request and goes with a reply, piece by piece: a large file is never in memory as a whole.

use std::io::{self, Read};
use std::pin::Pin;
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes, HttpBody};
use tokio::sync::mpsc;
use tokio::time::timeout;

use super::reply::Reply;

/// The next piece of a request's content must come within this time. Chosen: longer than a wireless network's hiccup. Raised, who sends
/// nothing holds a thread for longer.
const ARRIVES_WITHIN: Duration = Duration::from_secs(5);
/// The whole content must come within this time, and a second more for each [`SLOWEST`] bytes of it. Chosen: a bad wireless network is
/// faster. Raised, who sends a byte now and then holds a connection for longer; lowered, slow honest clients are cut off.
const ARRIVES_WHOLE_WITHIN: Duration = Duration::from_secs(20);
/// Bytes a second below which a content is cut off in the end: a telephone line. Raised, honest uploads over bad networks fail.
const SLOWEST: u64 = 8 * 1024;
/// Pieces that may wait between the connection and who reads or writes them. A round figure; raised, more memory.
const PIECES: usize = 4;

/// A request's content, read on another thread than it arrives on.
#[derive(Debug)]
pub(super) struct Upload {
    /// What is still to come.
    pieces: Option<mpsc::Receiver<io::Result<Bytes>>>,
    rest: Bytes,
}

impl Upload {
    /// With what fills it.
    pub fn channel() -> (mpsc::Sender<io::Result<Bytes>>, Self) {
        let (to, pieces) = mpsc::channel(PIECES);
        (to, Self { pieces: Some(pieces), rest: Bytes::new() })
    }

    /// One that is here already.
    pub fn whole(content: Vec<u8>) -> Self {
        Self { pieces: None, rest: content.into() }
    }
}

/// How long a content may take from when it began, by what has come.
struct Deadline {
    begun: Instant,
    bytes: u64,
}

impl Deadline {
    fn begin() -> Self {
        Self { begun: Instant::now(), bytes: 0 }
    }

    /// Time that is left for the next piece; none is zero.
    fn left(&self) -> Duration {
        let whole = ARRIVES_WHOLE_WITHIN + Duration::from_secs(self.bytes / SLOWEST);
        whole.saturating_sub(self.begun.elapsed()).min(ARRIVES_WITHIN)
    }
}

/// The next bytes of a content in time; none at its end.
async fn next_piece(body: &mut Body, deadline: &mut Deadline) -> io::Result<Option<Bytes>> {
    loop {
        let next = std::future::poll_fn(|cx| Pin::new(&mut *body).poll_frame(cx));
        match timeout(deadline.left(), next).await {
            Ok(None) => return Ok(None),
            Ok(Some(Ok(frame))) => {
                // Trailers say nothing here.
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

/// All of a content that is not longer than this; one that is longer is not waited for.
///
/// # Errors
/// The reply where it is longer, broke off, or did not come in time.
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

/// Content beyond its limit.
pub(super) fn too_large(most_bytes: u64) -> Reply {
    if most_bytes == 0 {
        return Reply::text(413, "this request has no content\n");
    }
    let limit = if most_bytes >= 1 << 20 { format!("{} MB", most_bytes >> 20) } else { format!("{most_bytes} bytes") };
    Reply::text(413, format!("the content is larger than {limit}, which is the most that is taken here\n"))
}

/// Content that did not come.
pub(super) fn not_arrived(error: &io::Error) -> Reply {
    match error.kind() {
        io::ErrorKind::TimedOut => Reply::text(408, "the content did not come in time; send it again\n"),
        _ => Reply::text(400, "the content broke off; send it again\n"),
    }
}

/// Brings a request's content to who reads it, until either ends.
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
