//! Decides which requests may be answered, before they are routed.
//!
//! There is no password, so a foreign page must not reach this server through a user's browser. The
//! requested host must be one of [`AllowedHosts`] (else a page could point its own name here), and
//! the requesting page must come from this server (`Origin`, and `Sec-Fetch-Site` if the browser
//! sends it). This holds for every path and for WebSockets, to which browsers do not apply the
//! same-origin policy. A request without `Origin` is not from a browser's script and passes.

use std::net::IpAddr;

use axum::http::{HeaderMap, HeaderName, Method, Request, Uri, Version, header};

use super::hosts::{AllowedHosts, HostAndPort};
use super::reply::Reply;

/// Default port of `http` (RFC 9110, 4.2).
const HTTP_PORT: u16 = 80;
/// Default port of `https`.
const HTTPS_PORT: u16 = 443;

/// Judges a request that came in at the address `reached`.
///
/// # Errors
/// Why it is not answered.
pub(super) fn judge<B>(hosts: &AllowedHosts, request: &Request<B>, reached: IpAddr) -> Result<(), Reply> {
    let host = requested_host(request)?;
    if host.as_ref().is_some_and(|host| !hosts.allows(&host.host, reached)) {
        let sentence = "this server does not answer for that host; call it by localhost, by an address or the name of its machine, \
            or add the host to hosts in [http]\n";
        return Err(Reply::text(421, sentence));
    }
    let headers = request.headers();
    if !is_from_here(headers, host.as_ref()) || !is_fetched_from_here(request.method(), headers) {
        let sentence = "this request comes from another site's page, which is not allowed; open the page at this server's own address\n";
        return Err(Reply::text(403, sentence));
    }
    Ok(())
}

/// Returns the requested host; `None` for HTTP/1.0 without a host, which no browser uses.
fn requested_host<B>(request: &Request<B>) -> Result<Option<HostAndPort>, Reply> {
    let bad = |sentence: &str| Reply::text(400, sentence);
    if request.method() == Method::CONNECT {
        return Err(bad("this server is not a proxy\n"));
    }
    let named = only(request.headers(), header::HOST).map_err(|()| bad("a request must have one Host, not more\n"))?;
    let named = named.map(|text| HostAndPort::parse(text).ok_or_else(|| bad("Host is not a host with a port\n"))).transpose()?;
    if named.is_none() && request.version() > Version::HTTP_10 {
        return Err(bad("a request of HTTP/1.1 needs a Host\n"));
    }
    let Some(target) = absolute(request.uri()).map_err(|()| bad("the request's target is not an http address\n"))? else {
        return Ok(named);
    };
    match named {
        Some(named) if !named.is_at(&target, HTTP_PORT) => Err(bad("Host differs from the one in the request's target\n")),
        _ => Ok(Some(target)),
    }
}

/// Returns the host of an absolute target, such as http://localhost:8090/ws.
fn absolute(uri: &Uri) -> Result<Option<HostAndPort>, ()> {
    match (uri.scheme_str(), uri.authority()) {
        (None, None) => Ok(None),
        (Some("http"), Some(authority)) => HostAndPort::parse(authority.as_str()).map(Some).ok_or(()),
        _ => Err(()),
    }
}

/// Returns a header's text, if present; an error if it occurs twice. A value that is not text
/// becomes empty, which nothing allows.
fn only(headers: &HeaderMap, name: HeaderName) -> Result<Option<&str>, ()> {
    let mut values = headers.get_all(name).iter();
    let first = values.next().map(|value| value.to_str().unwrap_or(""));
    if values.next().is_some() { Err(()) } else { Ok(first) }
}

/// Whether the requesting page is from this server: the same host and port. A proxy in front may
/// terminate TLS.
fn is_from_here(headers: &HeaderMap, host: Option<&HostAndPort>) -> bool {
    let origin = match only(headers, header::ORIGIN) {
        Ok(None) => return true,
        Ok(Some(origin)) => origin,
        Err(()) => return false,
    };
    // `null` is the origin of a page that hides where it comes from.
    let place = [("http://", HTTP_PORT), ("https://", HTTPS_PORT)].into_iter().find_map(|(scheme, default_port)| {
        let place = HostAndPort::parse(origin.strip_prefix(scheme)?)?;
        Some((place, default_port))
    });
    matches!((place, host), (Some((place, default_port)), Some(host)) if place.is_at(host, default_port))
}

/// Whether the browser says that the request is from here. Following a link from another site is
/// allowed: only the user sees the answer.
fn is_fetched_from_here(method: &Method, headers: &HeaderMap) -> bool {
    let header = |name: &'static str| only(headers, HeaderName::from_static(name)).unwrap_or(Some(""));
    match header("sec-fetch-site") {
        None | Some("same-origin" | "none") => true,
        Some(_) => {
            matches!(*method, Method::GET | Method::HEAD)
                && header("sec-fetch-mode") == Some("navigate")
                && header("sec-fetch-dest") == Some("document")
        }
    }
}

#[cfg(test)]
#[path = "guard_tests.rs"]
mod tests;
