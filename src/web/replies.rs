//! Converts replies to HTTP: the headers common to all, and what every path refuses.

use axum::body::{Body, HttpBody};
use axum::http::{HeaderName, HeaderValue, Method, Request as HttpRequest, Response, StatusCode, header};

use super::reply::Reply;

/// Refuses methods other than GET and HEAD, and content.
pub(super) fn reads(request: &HttpRequest<Body>) -> Option<Response<Body>> {
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        return Some(response(Reply::text(405, "only GET is answered here\n").with("allow", "GET, HEAD")));
    }
    refused_content(request)
}

/// Refuses content.
pub(super) fn refused_content(request: &HttpRequest<Body>) -> Option<Response<Body>> {
    (!request.body().is_end_stream()).then(|| response(Reply::text(413, "a request has no content here\n")))
}

/// Returns the reply with headers that keep other sites' pages from using it. A refused request
/// also ends its connection, which may carry more.
pub(super) fn response(reply: Reply) -> Response<Body> {
    let is_refused = matches!(reply.status, 400 | 401 | 403 | 405 | 408 | 413 | 421 | 423);
    let mut response = Response::new(Body::from(reply.body));
    *response.status_mut() = StatusCode::from_u16(reply.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    let headers = response.headers_mut();
    let fixed = [
        (header::CONTENT_TYPE, reply.content_type),
        (header::CACHE_CONTROL, "no-store"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::CONTENT_SECURITY_POLICY, "default-src 'none'; frame-ancestors 'none'"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ];
    for (name, value) in fixed {
        headers.insert(name, HeaderValue::from_static(value));
    }
    // Replaces them, since a browser enforces both of two policies.
    for (name, value) in reply.headers {
        headers.insert(name, value);
    }
    if is_refused {
        headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    response
}
