//! Who may ask: what is looked at before a request is routed.
//!
//! There is no password, so a browser must not lend its reach to a foreign page. The host that is asked for must be one of
//! [`AllowedHosts`] (else a page could point its own name here), and the page that asks must come from this server (`Origin`, and
//! `Sec-Fetch-Site` where a browser sends it), for every path and for WebSockets, to which browsers apply no such rule themselves. What
//! has no `Origin` is no browser's script and passes.

use std::net::IpAddr;

use axum::http::{HeaderMap, HeaderName, Method, Request, Uri, Version, header};

use super::hosts::{AllowedHosts, HostAndPort};
use super::reply::Reply;

/// The ports of `http` and `https` where an address names none (RFC 9110, 4.2).
const HTTP_PORT: u16 = 80;
const HTTPS_PORT: u16 = 443;

/// Judges a request that came in at the address `reached`.
///
/// # Errors
/// Why it is not answered.
pub(super) fn judge<B>(hosts: &AllowedHosts, request: &Request<B>, reached: IpAddr) -> Result<(), Reply> {
    let host = asked_host(request)?;
    if host.as_ref().is_some_and(|host| !hosts.allows(&host.host, reached)) {
        let sentence = "this server does not answer for that host; call it by localhost, by an address or the name of its machine, \
            or add the host to hosts in [http]\n";
        return Err(Reply::text(421, sentence));
    }
    let headers = request.headers();
    if !is_from_here(headers, host.as_ref()) || !is_fetched_from_here(request.method(), headers) {
        let sentence = "this request comes from another site's page, which may not ask here; open the page at this server's own address\n";
        return Err(Reply::text(403, sentence));
    }
    Ok(())
}

/// The host that a request is for; none where it is HTTP/1.0 without one, which no browser speaks.
fn asked_host<B>(request: &Request<B>) -> Result<Option<HostAndPort>, Reply> {
    let bad = |sentence: &str| Reply::text(400, sentence);
    if request.method() == Method::CONNECT {
        return Err(bad("this server is no proxy\n"));
    }
    let named = only(request.headers(), header::HOST).map_err(|()| bad("a request has one Host, not more\n"))?;
    let named = named.map(|text| HostAndPort::parse(text).ok_or_else(|| bad("Host is no host with a port\n"))).transpose()?;
    if named.is_none() && request.version() > Version::HTTP_10 {
        return Err(bad("a request of HTTP/1.1 needs a Host\n"));
    }
    let Some(target) = absolute(request.uri()).map_err(|()| bad("the request's target is no http address\n"))? else { return Ok(named) };
    match named {
        Some(named) if !named.is_at(&target, HTTP_PORT) => Err(bad("Host is another one than in the request's target\n")),
        _ => Ok(Some(target)),
    }
}

/// The host of a target that is a whole address, such as http://localhost:8090/ws.
fn absolute(uri: &Uri) -> Result<Option<HostAndPort>, ()> {
    match (uri.scheme_str(), uri.authority()) {
        (None, None) => Ok(None),
        (Some("http"), Some(authority)) => HostAndPort::parse(authority.as_str()).map(Some).ok_or(()),
        _ => Err(()),
    }
}

/// A header's text, where it is there; an error where it is there twice. What is no text is an empty one, which nothing allows.
fn only(headers: &HeaderMap, name: HeaderName) -> Result<Option<&str>, ()> {
    let mut values = headers.get_all(name).iter();
    let first = values.next().map(|value| value.to_str().unwrap_or(""));
    if values.next().is_some() { Err(()) } else { Ok(first) }
}

/// Whether the page that asks is of this server: the same host and port. TLS may end at a proxy before it.
fn is_from_here(headers: &HeaderMap, host: Option<&HostAndPort>) -> bool {
    let origin = match only(headers, header::ORIGIN) {
        Ok(None) => return true,
        Ok(Some(origin)) => origin,
        Err(()) => return false,
    };
    // `null` is what a page says that hides where it comes from.
    let place = [("http://", HTTP_PORT), ("https://", HTTPS_PORT)].into_iter().find_map(|(scheme, default_port)| {
        let place = HostAndPort::parse(origin.strip_prefix(scheme)?)?;
        Some((place, default_port))
    });
    matches!((place, host), (Some((place, default_port)), Some(host)) if place.is_at(host, default_port))
}

/// What the browser says of the page that asks. A link from another site may be followed: nobody reads what comes but who clicked it.
fn is_fetched_from_here(method: &Method, headers: &HeaderMap) -> bool {
    let says = |name: &'static str| only(headers, HeaderName::from_static(name)).unwrap_or(Some(""));
    match says("sec-fetch-site") {
        None | Some("same-origin" | "none") => true,
        Some(_) => {
            matches!(*method, Method::GET | Method::HEAD)
                && says("sec-fetch-mode") == Some("navigate")
                && says("sec-fetch-dest") == Some("document")
        }
    }
}

#[cfg(test)]
#[path = "guard_tests.rs"]
mod tests;
