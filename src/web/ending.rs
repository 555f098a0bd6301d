//! How the server's tasks hear that it ends.

use tokio::sync::watch;

/// Waits for the end of the server.
pub(super) async fn ended(stopped: &mut watch::Receiver<bool>) {
    // An error says that the server is gone, which is the end too.
    drop(stopped.wait_for(|stop| *stop).await);
}
