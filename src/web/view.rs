//! `/ws/view`: the picture with its record, for clients that ask for a frame.
//!
//! A client sends `n` for each frame that it can take and gets the next one, or `u` to get one with
//! the pixels behind its poses. So it never falls behind, however slow it is. Between frames it
//! gets the state a few times a second, so that silence means that the daemon is gone.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message, WebSocket, close_code};
use serde_json::json;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until, timeout};

use super::assets;
use super::feed::Feed;
use super::hub::{Asking, Hub, Waiting};
use super::lifetime::{TAKES_WITHIN, close, ended};

/// Maximum frames that a client may have asked for and not received. Two keep a picture on its way
/// while one is drawn. Raised, a slow client sees older pictures.
const MAX_PENDING: u32 = 2;
/// Maximum interval between messages to a client. Chosen: a loss of contact is noticed within a
/// second, even if one message is late. Raised, it is noticed later; lowered, hidden pages cost
/// more.
const SPEAKS_EVERY: Duration = Duration::from_millis(250);
/// A client that has asked for nothing for this long gets no used pixels until it asks again.
/// Chosen: longer than the slowest page takes to draw. Raised, the tracker records pixels for
/// nobody.
const LETS_GO_AFTER: Duration = Duration::from_secs(10);

/// Serves one client until it goes.
pub(super) async fn show(mut socket: WebSocket, hub: Arc<Hub>, feed: Arc<Feed>, mut stopped: watch::Receiver<bool>) {
    let mut messages = hub.messages();
    let mut pending = 0;
    let mut waiting: Option<Waiting> = None;
    let mut asking: Option<Asking> = None;
    let (mut speaks_at, mut requested_at) = (Instant::now(), Instant::now());
    let version = assets::version();
    loop {
        let message = tokio::select! {
            changed = messages.changed(), if pending > 0 => {
                if changed.is_err() {
                    break;
                }
                pending -= 1;
                if pending == 0 {
                    waiting = None;
                }
                Message::Binary(messages.borrow_and_update().clone())
            }
            message = socket.recv() => match message {
                Some(Ok(Message::Text(text))) if matches!(text.as_str(), "n" | "u") => {
                    match (text.as_str(), &asking) {
                        ("u", None) => asking = Some(hub.ask_pixels()),
                        ("n", Some(_)) => asking = None,
                        _ => {}
                    }
                    if pending == 0 {
                        // Skip an older frame: the next one is near.
                        messages.mark_unchanged();
                        waiting = Some(hub.wait());
                    }
                    pending = (pending + 1).min(MAX_PENDING);
                    requested_at = Instant::now();
                    continue;
                }
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => continue,
                Some(Ok(Message::Text(_) | Message::Binary(_))) => {
                    let reason = "say n for the next frame, u for one with its used pixels; other messages are not supported".into();
                    let refusal = Message::Close(Some(CloseFrame { code: close_code::POLICY, reason }));
                    let _ = timeout(TAKES_WITHIN, socket.send(refusal)).await;
                    return;
                }
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
            },
            () = sleep_until(speaks_at) => {
                // A hidden or stopped page shows no pixels.
                if pending == 0 && requested_at.elapsed() > LETS_GO_AFTER {
                    asking = None;
                }
                Message::Text(json!({"page": version, "state": feed.known()}).to_string().into())
            }
            () = ended(&mut stopped) => break,
        };
        match timeout(TAKES_WITHIN, socket.send(message)).await {
            Ok(Ok(())) => speaks_at = Instant::now() + SPEAKS_EVERY,
            _ => return,
        }
    }
    drop((waiting, asking));
    close(socket).await;
}
