//! `/api/v1/session`, `pair`, `clients`, `lock`, `unlock`: who is connected, and what they may do.

use std::sync::Arc;
use std::time::Instant;

use axum::http::Method;
use serde::Deserialize;
use serde_json::json;

use super::assets;
use super::keys::Keys;
use super::reply::Reply;
use super::routes::{Access, Route};

/// Returns the caller's own description, an object.
pub type About = Box<dyn Fn() -> serde_json::Value + Send + Sync>;

/// Maximum size of a request here, bytes. Raised, a client may take more memory.
const LARGEST: u64 = 4096;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pairing {
    code: String,
    #[serde(default)]
    name: String,
}

/// Returns the routes. `about` adds the daemon's description to the session.
pub(super) fn routes(keys: &Arc<Keys>, about: Option<About>) -> Vec<Route> {
    let of = |keys: &Arc<Keys>| keys.clone();
    let (session, pair, clients, revoke, lock, unlock) = (of(keys), of(keys), of(keys), of(keys), of(keys), of(keys));
    vec![
        Route::slow(Method::GET, "/api/v1/session", Access::Anyone, move |call| {
            let mut session_state = about.as_ref().map_or_else(|| json!({}), |about| about());
            let is_paired = session.is_paired(&call.headers);
            session_state["paired"] = is_paired.into();
            session_state["needs_pairing"] = (!call.is_here() && !is_paired).into();
            session_state["locked"] = session.is_locked().into();
            session_state["version"] = env!("CARGO_PKG_VERSION").into();
            session_state["page"] = assets::version().into();
            Ok(Reply::json(200, session_state.to_string()))
        })
        .probe(),
        Route::slow(Method::POST, "/api/v1/pair", Access::Pair, move |call| {
            let asked: Pairing = call.json(LARGEST)?;
            Ok(Reply::done().with("set-cookie", &pair.pair(&asked.code, &asked.name, call.permission.peer, Instant::now())?))
        })
        .takes(LARGEST),
        Route::slow(Method::GET, "/api/v1/clients", Access::Paired, move |_| Ok(Reply::json(200, json!(clients.clients()).to_string()))),
        Route::slow(Method::DELETE, "/api/v1/clients/{id}", Access::Change, move |call| {
            revoke.revoke(call.name("id")?).map(|()| Reply::done())
        }),
        Route::slow(Method::POST, "/api/v1/lock", Access::Change, move |_| lock.lock(true).map(|()| Reply::done())),
        Route::slow(Method::POST, "/api/v1/unlock", Access::Unlock, move |_| unlock.lock(false).map(|()| Reply::done())),
    ]
}
