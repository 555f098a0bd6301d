//! Replies as HTTP: the headers that each has, and what is refused on every path.

use axum::body::{Body, HttpBody};
use axum::http::{HeaderName, HeaderValue, Method, Request as HttpRequest, Response, StatusCode, header};

use super::reply::Reply;

/// Refuses what is more than a question.
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

/// The reply with what no page of another site may do with it. What was refused also ends its connection: it may hold more.
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
    // In place of those, not beside them: a browser holds a page to both of two policies.
    for (name, value) in reply.headers {
        headers.insert(name, value);
    }
    if is_refused {
        headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    response
}
