//! Content of replies that is generated while it is sent, in pieces: a large file is never in
//! memory as a whole.

use std::io::{self, Write};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use hyper::body::Frame;
use tokio::sync::mpsc;

/// Maximum pieces queued between the writer and the connection. A round figure; raised, more
/// memory.
const PIECES: usize = 4;
/// Size of a download's pieces, bytes. Chosen: few system calls, little memory. Raised, more memory
/// per download.
const PIECE_BYTES: usize = 64 * 1024;

/// Counts the lasting transfers on a connection: while there are any, it is not closed for its age.
#[derive(Debug, Clone, Default)]
pub(super) struct Transfers(Arc<AtomicUsize>);

impl Transfers {
    /// Counts a transfer until it is dropped.
    pub fn begin(&self) -> Transfer {
        self.0.fetch_add(1, Ordering::Relaxed);
        Transfer(self.0.clone())
    }

    /// Whether there are any.
    pub fn any(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 0
    }
}

/// A counted transfer.
#[derive(Debug)]
pub(super) struct Transfer(Arc<AtomicUsize>);

impl Drop for Transfer {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Content of a reply that is generated on its own thread while it is sent, as fast as the client
/// reads.
#[derive(Debug)]
pub struct Download {
    pieces: mpsc::Receiver<io::Result<Bytes>>,
    transfer: Option<Transfer>,
}

impl Download {
    /// Starts `make`, which writes the content. If it fails, the connection breaks off, so that
    /// half a file is not taken for a whole one.
    ///
    /// # Errors
    /// When the system provides no thread.
    pub fn start(make: impl FnOnce(&mut dyn Write) -> io::Result<()> + Send + 'static) -> io::Result<Self> {
        let (to, pieces) = mpsc::channel(PIECES);
        let work = move || {
            crate::daemon::stand_back();
            let mut sink = Sink { to: to.clone(), buffer: Vec::new() };
            if let Err(error) = make(&mut sink).and_then(|()| sink.flush()) {
                let _ = to.blocking_send(Err(error));
            }
        };
        std::thread::Builder::new().name("download".to_owned()).spawn(work)?;
        Ok(Self { pieces, transfer: None })
    }

    /// Returns it as a response's body, which counts among the connection's transfers.
    pub(super) fn into_body(mut self, transfers: Option<&Transfers>) -> Body {
        self.transfer = transfers.map(Transfers::begin);
        Body::new(self)
    }
}

impl HttpBody for Download {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        self.pieces.poll_recv(cx).map(|piece| piece.map(|piece| piece.map(Frame::data)))
    }
}

/// Where a download is written to.
struct Sink {
    to: mpsc::Sender<io::Result<Bytes>>,
    buffer: Vec<u8>,
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.buffer.extend_from_slice(bytes);
        if self.buffer.len() >= PIECE_BYTES {
            self.flush()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        let piece = Bytes::from(std::mem::take(&mut self.buffer));
        // The client is gone.
        self.to.blocking_send(Ok(piece)).map_err(|_| io::ErrorKind::BrokenPipe.into())
    }
}
