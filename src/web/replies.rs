//! Replies as HTTP: the headers that each has, and what is refused on every path.

use axum::body::{Body, HttpBody};
use axum::http::{HeaderName, HeaderValue, Method, Request as HttpRequest, Response, StatusCode, header};

use super::routes::{Effect, Reply};

/// Refuses another method than the route's, and content.
pub(super) fn refusal(request: &HttpRequest<Body>, effect: &Effect) -> Option<Response<Body>> {
    let (is_allowed, allow, sentence) = match effect {
        Effect::Reads => (matches!(*request.method(), Method::GET | Method::HEAD), "GET, HEAD", "only GET is answered here\n"),
        Effect::Changes(_) => (*request.method() == Method::POST, "POST", "this changes something; ask with POST\n"),
    };
    if !is_allowed {
        return Some(with(response(Reply::text(405, sentence)), header::ALLOW, HeaderValue::from_static(allow)));
    }
    (!request.body().is_end_stream()).then(|| response(Reply::text(413, "a request has no content here\n")))
}

/// The response with one more header.
pub(super) fn with(mut response: Response<Body>, name: HeaderName, value: HeaderValue) -> Response<Body> {
    response.headers_mut().insert(name, value);
    response
}

/// The reply with what no page of another site may do with it. What was refused also ends its connection: it may hold more.
pub(super) fn response(reply: Reply) -> Response<Body> {
    let is_refused = matches!(reply.status, 400 | 403 | 405 | 413 | 421);
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
    if is_refused {
        headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    response
}
