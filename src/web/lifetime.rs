//! When a client is let go, and when the server ends.

use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use tokio::sync::watch;
use tokio::time::timeout;

/// A client that takes nothing for this long is let go. Chosen: longer than a network's hiccup. Raised, dead clients hold their places for
/// longer.
pub(super) const TAKES_WITHIN: Duration = Duration::from_secs(2);

/// What a last message may take. Chosen: a client that listens takes it at once. Raised, the daemon's end waits for those that do not.
const LAST_WORD: Duration = Duration::from_millis(100);

/// Ends a WebSocket in form.
pub(super) async fn close(mut socket: WebSocket) {
    // Who does not listen is cut off.
    let _ = timeout(LAST_WORD, socket.send(Message::Close(None))).await;
}

/// Waits for the end of the server.
pub(super) async fn ended(stopped: &mut watch::Receiver<bool>) {
    // An error says that the server is gone, which is the end too.
    drop(stopped.wait_for(|stop| *stop).await);
}
