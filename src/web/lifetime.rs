//! When a client is dropped, and when the server ends.

use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use tokio::sync::watch;
use tokio::time::timeout;

/// A client that takes nothing for this long is dropped. Chosen: longer than a network's hiccup.
/// Raised, dead clients hold their places longer.
pub(super) const TAKES_WITHIN: Duration = Duration::from_secs(2);

/// Maximum time for a last message. Chosen: a client that listens takes it at once. Raised, the
/// daemon's end waits for those that do not.
const LAST_WORD: Duration = Duration::from_millis(100);

/// Closes a WebSocket properly.
pub(super) async fn close(mut socket: WebSocket) {
    // A client that does not listen is cut off.
    let _ = timeout(LAST_WORD, socket.send(Message::Close(None))).await;
}

/// Waits for the end of the server.
pub(super) async fn ended(stopped: &mut watch::Receiver<bool>) {
    // An error means that the server is gone, which is also the end.
    drop(stopped.wait_for(|stop| *stop).await);
}
