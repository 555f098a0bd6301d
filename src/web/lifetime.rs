//! When a client is let go, and when the server ends.

use std::time::Duration;

use tokio::sync::watch;

/// A client that takes nothing for this long is let go. Chosen: longer than a network's hiccup. Raised, dead clients hold their places for
/// longer.
pub(super) const TAKES_WITHIN: Duration = Duration::from_secs(2);

/// Waits for the end of the server.
pub(super) async fn ended(stopped: &mut watch::Receiver<bool>) {
    // An error says that the server is gone, which is the end too.
    drop(stopped.wait_for(|stop| *stop).await);
}
