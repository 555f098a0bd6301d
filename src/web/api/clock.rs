//! `GET /api/v1/clock`: the time of the daemon's machine, for the clock that the page shows to a
//! camera. The page corrects it by half of the request's round trip.

use std::time::{SystemTime, UNIX_EPOCH};

use crate::web::reply::Reply;
use crate::web::routes::Route;

/// Returns the route. Its answer is UTC as milliseconds since 1970, with microseconds.
pub(super) fn route() -> Route {
    Route::get("/api/v1/clock", || {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Reply::text(200, format!("{:.3}", since.as_secs_f64() * 1e3))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::web::api::tests::respond;

    #[test]
    fn the_clock_is_that_of_the_machine() {
        let ms = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64() * 1e3;
        let before = ms();
        let (status, text) = respond(&[route()], "GET", "/api/v1/clock", b"");
        let said: f64 = String::from_utf8(text).unwrap().parse().unwrap();
        assert!(status == 200 && (before - 0.01..=ms() + 0.01).contains(&said), "{before} {said}");
    }
}
