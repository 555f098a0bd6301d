//! The page: the files that a browser loads, embedded in the program.
//!
//! Nothing is loaded from elsewhere: the policy sent with each file allows only this server's
//! scripts, styles and connections, and none inline in the HTML. Files are sent compressed to
//! clients that accept it. A browser revalidates its copies each time, so that a page never mixes
//! two versions.

use std::sync::LazyLock;

use std::path::{Path, PathBuf};

use axum::body::Body;
use axum::http::{HeaderValue, Request, Response, StatusCode, header};

use super::call::is_name;
use super::packing::{packed, unpacks};
use super::replies::{reads, response};
use super::reply::Reply;
use super::routes::Route;
use crate::fingerprint::{self, fnv1a};
use crate::safe_file;

/// A file of the page.
#[derive(Debug)]
struct Asset {
    path: &'static str,
    content_type: &'static str,
    bytes: &'static [u8],
}

/// MIME type of HTML.
const HTML: &str = "text/html; charset=utf-8";
/// MIME type of scripts.
const SCRIPT: &str = "text/javascript; charset=utf-8";
/// MIME type of style sheets.
const STYLE: &str = "text/css; charset=utf-8";
/// MIME type of SVG pictures.
const PICTURE: &str = "image/svg+xml";
/// MIME type of plain text.
const TEXT: &str = "text/plain; charset=utf-8";

/// Makes the [`Asset`] for a file in `page/`, by its path there.
macro_rules! asset {
    ($content_type:expr, $file:literal) => {
        asset!($content_type, $file, concat!("/", $file))
    };
    ($content_type:expr, $file:literal, $path:expr) => {
        Asset { path: $path, content_type: $content_type, bytes: include_bytes!(concat!("page/", $file)) }
    };
}

/// All files of the page.
const ASSETS: &[Asset] = &[
    asset!(HTML, "index.html", "/"),
    asset!(STYLE, "style.css"),
    asset!(STYLE, "setup.css"),
    asset!(STYLE, "views.css"),
    asset!(PICTURE, "icon.svg"),
    asset!(SCRIPT, "access.js"),
    asset!(SCRIPT, "app.js"),
    asset!(SCRIPT, "ask.js"),
    asset!(SCRIPT, "backup.js"),
    asset!(SCRIPT, "clip.js"),
    asset!(SCRIPT, "clock.js"),
    asset!(SCRIPT, "composite.js"),
    asset!(SCRIPT, "daemon.js"),
    asset!(SCRIPT, "drafts.js"),
    asset!(SCRIPT, "events.js"),
    asset!(SCRIPT, "fields.js"),
    asset!(SCRIPT, "gizmo.js"),
    asset!(SCRIPT, "gl/align.js"),
    asset!(SCRIPT, "gl/compose.js"),
    asset!(SCRIPT, "gl/lens.js"),
    asset!(SCRIPT, "gl/set.js"),
    asset!(SCRIPT, "gl/surfaces.js"),
    asset!(SCRIPT, "health.js"),
    asset!(SCRIPT, "keeping.js"),
    asset!(SCRIPT, "lens.js"),
    asset!(SCRIPT, "live.js"),
    asset!(SCRIPT, "minute.js"),
    asset!(SCRIPT, "models.js"),
    asset!(SCRIPT, "orbit.js"),
    asset!(SCRIPT, "pages.js"),
    asset!(SCRIPT, "picture.js"),
    asset!(SCRIPT, "recorded.js"),
    asset!(SCRIPT, "recordings.js"),
    asset!(SCRIPT, "retracked.js"),
    asset!(SCRIPT, "seen.js"),
    asset!(SCRIPT, "setpage.js"),
    asset!(SCRIPT, "setup.js"),
    asset!(SCRIPT, "steps/board.js"),
    asset!(SCRIPT, "steps/boardmarks.js"),
    asset!(SCRIPT, "steps/camera.js"),
    asset!(SCRIPT, "steps/check.js"),
    asset!(SCRIPT, "steps/choosefile.js"),
    asset!(SCRIPT, "steps/config.js"),
    asset!(SCRIPT, "steps/corners.js"),
    asset!(SCRIPT, "steps/draft.js"),
    asset!(SCRIPT, "steps/edges.js"),
    asset!(SCRIPT, "steps/faults.js"),
    asset!(SCRIPT, "steps/force.js"),
    asset!(SCRIPT, "steps/freeze.js"),
    asset!(SCRIPT, "steps/fromconfig.js"),
    asset!(SCRIPT, "steps/ghost.js"),
    asset!(SCRIPT, "steps/jobs.js"),
    asset!(SCRIPT, "steps/judged.js"),
    asset!(SCRIPT, "steps/kept.js"),
    asset!(SCRIPT, "steps/lengths.js"),
    asset!(SCRIPT, "steps/lens.js"),
    asset!(SCRIPT, "steps/locks.js"),
    asset!(SCRIPT, "steps/look.js"),
    asset!(SCRIPT, "steps/origin.js"),
    asset!(SCRIPT, "steps/outputs.js"),
    asset!(SCRIPT, "steps/pan.js"),
    asset!(SCRIPT, "steps/placing.js"),
    asset!(SCRIPT, "steps/poster.js"),
    asset!(SCRIPT, "steps/recording.js"),
    asset!(SCRIPT, "steps/remedies.js"),
    asset!(SCRIPT, "steps/sheet.js"),
    asset!(SCRIPT, "steps/sides.js"),
    asset!(SCRIPT, "steps/sizes.js"),
    asset!(SCRIPT, "steps/stage.js"),
    asset!(SCRIPT, "steps/toml.js"),
    asset!(SCRIPT, "steps/upload.js"),
    asset!(SCRIPT, "steps/walk.js"),
    asset!(SCRIPT, "steps/walked.js"),
    asset!(SCRIPT, "steps/warnings.js"),
    asset!(SCRIPT, "steps/write.js"),
    asset!(SCRIPT, "stage.js"),
    asset!(SCRIPT, "strip.js"),
    asset!(SCRIPT, "theme.js"),
    asset!(SCRIPT, "things.js"),
    asset!(SCRIPT, "timeline.js"),
    asset!(SCRIPT, "ui.js"),
    asset!(SCRIPT, "used.js"),
    asset!(SCRIPT, "zip.js"),
    asset!(SCRIPT, "vendor/preact.js"),
    asset!(SCRIPT, "vendor/hooks.js"),
    asset!(SCRIPT, "vendor/signals-core.js"),
    asset!(SCRIPT, "vendor/signals.js"),
    asset!(SCRIPT, "vendor/htm.js"),
    asset!(SCRIPT, "vendor/three.js"),
    asset!(TEXT, "vendor/LICENSES.txt"),
];

/// What the page may load: files and connections of this server only, and pictures from its own
/// memory. Framing is forbidden.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; base-uri 'none'; \
    form-action 'none'; frame-ancestors 'none'";

/// Returns the page's version as one word: if it changes, an open page is outdated.
pub(super) fn version() -> String {
    format!("{:016x}", ASSETS.iter().fold(fingerprint::START, |hashed, asset| fnv1a(hashed, asset.bytes)))
}

/// The files compressed with gzip, in the order of [`ASSETS`]; made on first use, in about 20 ms.
static PACKED: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| ASSETS.iter().map(|asset| packed(asset.bytes)).collect());

/// Maximum size of a file of the page, bytes; a round figure. Raised, a larger file may be served
/// from a folder.
const MAX_FILE: u64 = 16 << 20;

/// Returns the reply for a path without content.
pub(super) fn nothing_here() -> Response<Body> {
    response(Reply::text(404, "there is nothing here; the page is at /\n"))
}

/// Serves a file of a folder as it is now, for developing the page; it is read on another thread.
pub(super) async fn from_folder(request: Request<Body>, folder: PathBuf) -> Response<Body> {
    if let Some(refused) = reads(&request) {
        return refused;
    }
    let path = match request.uri().path() {
        "/" => "index.html",
        path => &path[1..],
    };
    // No component may lead out of the folder.
    if !path.split('/').all(is_name) {
        return nothing_here();
    }
    let file = folder.join(path);
    let content_type = content_type(&file);
    match tokio::task::spawn_blocking(move || safe_file::read(&file, MAX_FILE)).await {
        Ok(Ok(bytes)) => {
            let reply = Reply::new(200, content_type, bytes).with("content-security-policy", POLICY);
            response(reply.with("cache-control", "no-cache").with("referrer-policy", "no-referrer"))
        }
        _ => nothing_here(),
    }
}

/// Returns the MIME type of a file of the page.
fn content_type(file: &Path) -> &'static str {
    match file.extension().and_then(|extension| extension.to_str()) {
        Some("html") => HTML,
        Some("js") => SCRIPT,
        Some("css") => STYLE,
        Some("svg") => PICTURE,
        _ => TEXT,
    }
}

/// Returns the routes for the embedded files.
pub(super) fn routes() -> Vec<Route> {
    let of = |(k, asset): (usize, &'static Asset)| {
        let tag = format!("\"{:016x}\"", fnv1a(fingerprint::START, asset.bytes));
        Route::whole(asset.path, move |request| std::future::ready(answer(&request, asset, k, &tag)))
    };
    ASSETS.iter().enumerate().map(of).collect()
}

fn answer(request: &Request<Body>, asset: &Asset, k: usize, tag: &str) -> Response<Body> {
    let mut response = response(Reply::new(200, asset.content_type, Vec::new()));
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    // Sixteen digits in quotes are a valid header value.
    headers.extend(HeaderValue::from_str(tag).ok().map(|tag| (header::ETAG, tag)));
    headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    if has_it(request, tag) {
        *response.status_mut() = StatusCode::NOT_MODIFIED;
    } else if unpacks(request.headers()) {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        *response.body_mut() = Body::from(PACKED[k].as_slice());
    } else {
        *response.body_mut() = Body::from(asset.bytes);
    }
    response
}

/// Whether the browser has the file already (RFC 9110, 13.1.2).
fn has_it(request: &Request<Body>, tag: &str) -> bool {
    let values = request.headers().get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).map(str::trim).any(|one| one == "*" || one.strip_prefix("W/").unwrap_or(one) == tag)
}

#[cfg(test)]
#[path = "assets_tests.rs"]
mod tests;
