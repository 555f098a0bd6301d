//! Access control: pairing of browsers on other machines, and the show lock.
//!
//! On this machine everyone may make changes. A browser elsewhere types a code of eight digits
//! once, which `stagepose pair` and the journal show to whoever controls this machine, and stores a
//! random token in a cookie that no script can read. Only the token's hash is stored here, in the
//! state folder.

use std::fs::OpenOptions;
use std::io::{self, Read, Write};
use std::net::IpAddr;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use axum::http::{HeaderMap, Method, header};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::places::network_of;
use super::reply::Reply;
use crate::safe_file;

/// The cookie's name; the daemon's port is appended, as browsers treat all daemons of a machine as
/// one site. Earlier versions used the bare name.
const COOKIE: &str = "stagepose";
/// Lifetime of the cookie, seconds: a year. Raised, a tablet that was given away stays paired
/// longer.
const COOKIE_LASTS_S: u64 = 365 * 24 * 3600;
/// Maximum codes that one peer may try within [`TRIES_WITHIN`]. Raised, the code is guessed sooner;
/// lowered, mistyping means waiting.
const MAX_TRIES: usize = 5;
/// Maximum codes tried by all peers together: eight digits then withstand a year of guessing by any
/// number of peers. Raised, they last less; lowered, fewer guessing peers can lock an honest one
/// out.
const MAX_TRIES_OF_ALL: usize = 100;
/// Period over which tried codes are counted. Raised, guessing takes longer, and so does waiting
/// after mistyping.
const TRIES_WITHIN: Duration = Duration::from_secs(60);
/// Maximum number of paired browsers; the oldest is removed. Chosen: more than a theatre has.
/// Raised, forgotten ones stay longer.
const MAX_CLIENTS: usize = 64;
/// Maximum length of a browser's name, characters. Chosen for the list that shows it. Raised, the
/// list is wider.
const MAX_LABEL: usize = 60;
/// Maximum size of the file of clients, bytes. Raised, a foreign file takes more memory.
const MAX_FILE: u64 = 1 << 20;

/// Who may use a route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Anyone who passes the guard; it changes nothing.
    Anyone,
    /// It changes nothing, but reveals more than the page shows: off loopback only for paired
    /// browsers.
    Paired,
    /// It changes something: off loopback only for paired browsers, and for nobody while the show
    /// lock is on.
    Change,
    /// It changes something even under the lock: it releases the lock.
    Unlock,
    /// Pairing itself.
    Pair,
}

impl Access {
    /// Returns its word in the list of routes.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Anyone => "anyone",
            Self::Paired => "paired",
            Self::Change => "change",
            Self::Unlock => "unlock",
            Self::Pair => "pair",
        }
    }
}

/// A paired browser.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Client {
    id: String,
    name: String,
    since_unix_ms: u64,
    hash: String,
}

/// What is stored on disk.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Kept {
    locked: bool,
    clients: Vec<Client>,
}

#[derive(Debug, Default)]
struct Known {
    kept: Kept,
    code: String,
    /// The codes tried: when, and by whom.
    tries: Vec<(Instant, IpAddr)>,
}

/// Codes, clients and the lock.
#[derive(Debug)]
pub struct Keys {
    /// Where they are stored; `None` in a test.
    folder: Option<PathBuf>,
    /// Distinguishes several daemons on one machine.
    port: u16,
    known: Mutex<Known>,
}

/// Returns the file with the code for a daemon's port, for `stagepose pair`.
pub fn code_file(state: &Path, port: u16) -> PathBuf {
    state.join(format!("pair-code-{port}"))
}

/// Returns this many random bytes as hexadecimal digits.
fn random_hex(bytes: usize) -> io::Result<String> {
    let mut random = vec![0; bytes];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut random)?;
    Ok(hex(&random))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn hash(token: &str) -> String {
    hex(&Sha256::digest(token.as_bytes()))
}

/// Returns eight random digits.
fn new_code() -> io::Result<String> {
    let random = random_hex(8)?;
    // Sixteen hexadecimal digits are 64 bits: the distribution is uniform to a few in 10^12.
    let number = u64::from_str_radix(&random, 16).unwrap_or_default();
    Ok(format!("{:08}", number % 100_000_000))
}

impl Keys {
    /// Loads the keys stored in `folder`, with a new code.
    ///
    /// # Errors
    /// When the system provides no random numbers, or the folder cannot be written.
    pub fn open(folder: Option<&Path>, port: u16) -> io::Result<Self> {
        let keys = Self { folder: folder.map(Path::to_owned), port, known: Mutex::default() };
        let kept = keys.file().and_then(|file| safe_file::read(&file, MAX_FILE).ok());
        // If the file is unreadable, no browser is paired and all must pair again.
        let kept: Kept = kept.and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default();
        if let Some(folder) = &keys.folder {
            std::fs::create_dir_all(folder)?;
        }
        let mut known = keys.known();
        known.kept = kept;
        keys.renew(&mut known)?;
        drop(known);
        Ok(keys)
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn file(&self) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("clients-{}.json", self.port)))
    }

    /// Makes a new code, so that each is used once.
    fn renew(&self, known: &mut Known) -> io::Result<()> {
        known.code = new_code()?;
        let Some(folder) = &self.folder else { return Ok(()) };
        let file = code_file(folder, self.port);
        let _ = std::fs::remove_file(&file);
        // Readable by this user and root only.
        OpenOptions::new().write(true).create_new(true).mode(0o600).open(&file)?.write_all(known.code.as_bytes())
    }

    fn keep(&self, known: &Known) -> Result<(), Reply> {
        let Some(file) = self.file() else { return Ok(()) };
        let text = serde_json::to_vec(&known.kept).unwrap_or_default();
        safe_file::write_whole(&file, &text)
            .map_err(|e| Reply::text(500, format!("{}: cannot be written ({e}); make room in the state folder\n", file.display())))
    }

    /// Returns the code to show to people.
    pub fn code(&self) -> String {
        self.known().code.clone()
    }

    /// Whether the request comes from this machine and not through a proxy on it.
    pub(super) fn is_here(peer: IpAddr, headers: &HeaderMap) -> bool {
        peer.to_canonical().is_loopback() && !headers.contains_key("x-forwarded-for") && !headers.contains_key(header::FORWARDED)
    }

    /// Whether the request has a cookie issued here.
    pub(super) fn is_paired(&self, headers: &HeaderMap) -> bool {
        let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok()).flat_map(|value| value.split(';'));
        let own = self.cookie();
        let is_named = |name: &str| name == own || name == COOKIE;
        let mut tokens =
            cookies.filter_map(|cookie| cookie.trim().split_once('=')).filter(|(name, _)| is_named(name)).map(|(_, token)| hash(token));
        let known = self.known();
        // Compare hashes, so that timing reveals nothing about the tokens.
        tokens.any(|hash| known.kept.clients.iter().any(|client| client.hash == hash))
    }

    /// Returns the name of this daemon's cookie.
    fn cookie(&self) -> String {
        format!("{COOKIE}-{}", self.port)
    }

    /// Whether the show lock is on.
    pub(super) fn is_locked(&self) -> bool {
        self.known().kept.locked
    }

    /// Judges a request for a route.
    pub(super) fn judge(&self, access: Access, method: &Method, headers: &HeaderMap, peer: IpAddr) -> Result<(), Reply> {
        let is_browser = headers.contains_key(header::ORIGIN) || headers.contains_key("sec-fetch-site");
        if !matches!(*method, Method::GET | Method::HEAD) && is_browser && !headers.contains_key("x-stagepose") {
            return Err(Reply::text(
                403,
                "a request that changes something needs the header X-Stagepose: 1, which pages of other sites cannot send\n",
            ));
        }
        let is_known = || Self::is_here(peer, headers) || self.is_paired(headers);
        match access {
            Access::Anyone | Access::Pair => Ok(()),
            _ if !is_known() => {
                let sentence = "this browser is not paired; type the code that `stagepose pair` prints on the daemon's machine\n";
                Err(Reply::text(401, sentence))
            }
            Access::Change if self.is_locked() => {
                Err(Reply::text(423, "the show lock is on; hold the lock in the page's top bar for a second to release it\n"))
            }
            Access::Change | Access::Paired | Access::Unlock => Ok(()),
        }
    }

    /// Pairs a browser that knows the code; returns the cookie to set.
    pub(super) fn pair(&self, code: &str, name: &str, peer: IpAddr, now: Instant) -> Result<String, Reply> {
        let (mut known, peer) = (self.known(), network_of(peer));
        known.tries.retain(|(tried, _)| now.duration_since(*tried) < TRIES_WITHIN);
        let of_peer = known.tries.iter().filter(|(_, by)| *by == peer).count();
        if of_peer >= MAX_TRIES || known.tries.len() >= MAX_TRIES_OF_ALL {
            return Err(Reply::text(429, "too many codes were tried; wait a minute\n").with("retry-after", "60"));
        }
        known.tries.push((now, peer));
        let digits: String = code.chars().filter(|c| !c.is_whitespace()).collect();
        if hash(&digits) != hash(&known.code) {
            return Err(Reply::text(401, "this is not the code; `stagepose pair` on the daemon's machine prints it\n"));
        }
        let failed = |e: io::Error| Reply::text(500, format!("no pairing was made: {e}\n"));
        let (token, id) = (random_hex(32).map_err(failed)?, random_hex(4).map_err(failed)?);
        let name = name.chars().filter(|c| crate::printable::stands_for_itself(*c)).take(MAX_LABEL).collect();
        let since_unix_ms = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64);
        if known.kept.clients.len() >= MAX_CLIENTS {
            known.kept.clients.remove(0);
        }
        known.kept.clients.push(Client { id, name, since_unix_ms, hash: hash(&token) });
        self.keep(&known)?;
        self.renew(&mut known).map_err(failed)?;
        Ok(format!("{}={token}; Path=/; Max-Age={COOKIE_LASTS_S}; HttpOnly; SameSite=Strict", self.cookie()))
    }

    /// Returns the paired browsers, without their secrets.
    pub(super) fn clients(&self) -> serde_json::Value {
        let known = self.known();
        known.kept.clients.iter().map(|c| serde_json::json!({"id": c.id, "name": c.name, "since_unix_ms": c.since_unix_ms})).collect()
    }

    /// Removes a paired browser.
    pub(super) fn revoke(&self, id: &str) -> Result<(), Reply> {
        let mut known = self.known();
        let before = known.kept.clients.len();
        known.kept.clients.retain(|client| client.id != id);
        if known.kept.clients.len() == before {
            return Err(Reply::text(404, "no browser of that id is paired; GET /api/v1/clients lists them\n"));
        }
        self.keep(&known)
    }

    /// Switches the show lock.
    pub(super) fn lock(&self, on: bool) -> Result<(), Reply> {
        let mut known = self.known();
        known.kept.locked = on;
        self.keep(&known)
    }
}

/// Who asks for what; it can be judged again while the request is processed.
#[derive(Debug, Clone)]
pub(super) struct Permission {
    pub keys: Arc<Keys>,
    pub access: Access,
    pub method: Method,
    pub headers: HeaderMap,
    pub peer: IpAddr,
}

impl Permission {
    /// Judges it by the current state.
    pub fn judge(&self) -> Result<(), Reply> {
        self.keys.judge(self.access, &self.method, &self.headers, self.peer)
    }

    /// Whether the request comes from this machine.
    pub fn is_here(&self) -> bool {
        Keys::is_here(self.peer, &self.headers)
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        if let Some(folder) = &self.folder {
            let _ = std::fs::remove_file(code_file(folder, self.port));
        }
    }
}

#[cfg(test)]
#[path = "keys_tests.rs"]
mod tests;
