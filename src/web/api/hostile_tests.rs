//! Malformed requests of every known kind: each must be answered with a sentence and do no harm.

use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::{Value, json};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::gltf::tests::glb;
use super::guarded_tests::{Listed, NOT_YET, listed};
use super::recordings::tests::recording;
use super::tests::{Answer, exchange, supervised, whole_server};

/// Number of requests. Raised, the test takes longer and finds more.
const REQUESTS: usize = 2000;
/// A text that must never appear in an answer.
const SECRET: &str = "not-for-strangers-7c1f";

/// Path components that lead out of a folder, end early, or are too long.
const NAMES: [&str; 18] = [
    "..",
    "%2e%2e",
    "..%2f..%2foutside.txt",
    "%2e%2e%2f%2e%2e%2foutside.txt",
    "..%5coutside.txt",
    "%2fetc%2fpasswd",
    "%00",
    "door.glb%00.png",
    "%ff%fe",
    "%F0%9F%92%A5.glb",
    "-1",
    "1e9",
    "18446744073709551616",
    ".hidden",
    "stage.toml",
    "con.glb.glb",
    "root",
    "%25%32%65%25%32%65",
];
/// Queries, valid or not.
const QUERIES: [&str; 14] = [
    "",
    "?points=0",
    "?points=-1",
    "?points=1e9",
    "?points=99999999999999999999",
    "?from=4294967296&count=5001",
    "?count=NaN",
    "?lines=",
    "?pictures=../..",
    "?pictures=601",
    "?points&from=&=&&&===",
    "?%00=%ff",
    "?try=1",
    "?try=2&try=1",
];
/// Content types, right or wrong.
const TYPES: [&str; 6] = ["application/json", "text/html", "multipart/form-data; boundary=x", "application/zip", "image/png", ";;=,"];
/// Values in place of a number, a text or a list, as JSON.
const VALUES: [&str; 16] = [
    "null",
    "true",
    "-1",
    "1e308",
    "1e999",
    "-0.0",
    "18446744073709551616",
    "\"\"",
    "\"\\u0000\"",
    "\"\\ud800\"",
    "\"../../outside.txt\"",
    "[]",
    "{}",
    "[[[[[[[[]]]]]]]]",
    "{\"a\":{\"a\":{\"a\":1}}}",
    "NaN",
];
/// Such values in TOML, for a config.
const TOML_VALUES: [&str; 14] = [
    "1e300",
    "-1",
    "nan",
    "inf",
    "9223372036854775807",
    "\"\"",
    "\"../outside.txt\"",
    "\"/dev/zero\"",
    "\"/proc/self/mem\"",
    "[]",
    "[1e308, 1e308]",
    "[[1]]",
    "{ a = 1 }",
    "1979-05-27",
];

struct Requests {
    random: Pcg64,
    config: Vec<u8>,
}

/// One request.
#[derive(Debug)]
struct Wrong {
    method: String,
    path: String,
    headers: String,
    content: Vec<u8>,
}

impl Requests {
    fn below(&mut self, n: usize) -> usize {
        self.random.random_range(0..n)
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }

    fn next(&mut self, routes: &[Listed]) -> Wrong {
        let route = &routes[self.below(routes.len())];
        let method =
            if self.below(10) == 0 { self.of(&["GET", "PUT", "POST", "DELETE", "HEAD", "OPTIONS", "TRACE"]) } else { &route.method };
        let (method, path) = (method.to_owned(), self.path(&route.path));
        let mut headers = "Host: localhost\r\n".to_owned();
        if self.below(2) == 0 {
            headers += &format!("If-Match: {}\r\n", self.of(&["*", "\"0\"", "", "\"\"\"", "W/*"]));
        }
        if self.below(2) == 0 {
            headers += &format!("Content-Type: {}\r\n", self.of(&TYPES));
        }
        if self.below(8) == 0 {
            headers += &format!("Cookie: stagepose={}; stagepose\r\n", "0".repeat(self.below(4000)));
        }
        let content = self.content(&route.path);
        Wrong { method, path, headers, content }
    }

    /// Returns the route's path with a valid or an invalid value for each field.
    fn path(&mut self, path: &str) -> String {
        let good = [("{id}", "clip-1"), ("{row}", "1"), ("{name}", "door.glb"), ("{number}", "1")];
        let mut filled = path.to_owned();
        for (field, value) in good {
            let long = "a".repeat(300);
            let value = match self.below(4) {
                0 => self.of(&NAMES),
                1 if self.below(8) == 0 => &long,
                _ => value,
            };
            filled = filled.replace(field, value);
        }
        if self.below(3) == 0 { filled + self.of(&QUERIES) } else { filled }
    }

    fn content(&mut self, path: &str) -> Vec<u8> {
        if self.below(12) == 0 {
            // Content for another route.
            let other = self.of(&["/api/v1/set", "/api/v1/restore", "/api/v1/config", "/api/v1/sets/{name}", "/api/v1/pair"]);
            return self.content(other);
        }
        let mut content = match path {
            "/api/v1/mode" => self.json(json!({"mode": "track"})),
            "/api/v1/pair" => self.json(json!({"code": "12345678", "name": "Anna"})),
            "/api/v1/recordings/mark" => self.json(json!({"text": "cue 12"})),
            "/api/v1/set" => self.json(json!({"objects": [{"kind": "cone", "position_m": [0, 1, 2.5], "size_m": 0.3}]})),
            "/api/v1/config" => self.config(),
            "/api/v1/restore" => self.backup(),
            "/api/v1/sets/{name}" => self.model(),
            _ => self.of(&[&b""[..], b"", b"", b"x", b"{}"]).to_vec(),
        };
        self.damage(&mut content);
        content
    }

    /// Sometimes changes, removes or duplicates some bytes.
    fn damage(&mut self, content: &mut Vec<u8>) {
        for _ in 0..self.below(3) {
            let at = self.below(content.len() + 1);
            match self.below(5) {
                0 if at < content.len() => content[at] ^= 1 << self.below(8),
                1 => content.truncate(at),
                2 => content.insert(at, self.random.random()),
                3 => content.extend_from_within(at..),
                _ => {}
            }
        }
    }

    /// Replaces one of the values by another.
    fn json(&mut self, mut good: Value) -> Vec<u8> {
        // Marks the value to be replaced.
        const HOLE: &str = "hole-in-the-json";
        let (mut at, depth) = (&mut good, self.below(4));
        for _ in 0..depth {
            let n = match at {
                Value::Object(fields) => fields.len(),
                Value::Array(values) => values.len(),
                _ => 0,
            };
            if n == 0 {
                break;
            }
            let k = self.below(n);
            let next = match at {
                Value::Object(fields) => fields.values_mut().nth(k),
                Value::Array(values) => values.get_mut(k),
                _ => None,
            };
            at = next.unwrap();
        }
        *at = HOLE.into();
        let value = match self.below(20) {
            0 => "[".repeat(20_000),
            1 => format!("\"{}\"", "long ".repeat(2000)),
            2 => format!("[{}]", "{\"a\":1},".repeat(3000).trim_end_matches(',')),
            _ => self.of(&VALUES).to_owned(),
        };
        good.to_string().replace(&format!("\"{HOLE}\""), &value).into_bytes()
    }

    /// Returns the config with another value for one key, an additional key, or far more text.
    fn config(&mut self) -> Vec<u8> {
        let text = String::from_utf8_lossy(&self.config).into_owned();
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let (at, value) = (self.below(lines.len()), self.of(&TOML_VALUES));
        match (self.below(6), lines[at].split_once(" = ").map(|(key, _)| key.to_owned())) {
            (0, _) => lines.insert(at, format!("no_such_key = {value}")),
            (1, _) => lines.push("[[object]]\nname = \"a\"".repeat(1 + self.below(50))),
            (2, _) => lines[at] = format!("[{}", lines[at]),
            (3, _) => drop(lines.remove(at)),
            (_, Some(key)) => lines[at] = format!("{key} = {value}"),
            (_, None) => lines.insert(at + 1, format!("fov_deg = {value}")),
        }
        lines.join("\n").into_bytes()
    }

    /// Returns a zip with the config and something that no backup contains.
    fn backup(&mut self) -> Vec<u8> {
        let name = self.of(&[
            "../outside.txt",
            "sets/../../outside.txt",
            "/tmp/stagepose-outside",
            "a/b.png",
            "..\\outside.txt",
            ".bashrc",
            "sets/",
            "sets/door.glb",
            "stage.toml",
            "backdrop.png",
            "C:outside",
            "a\u{0}b",
            "",
        ]);
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        let config = if self.below(2) == 0 { self.config.clone() } else { self.config() };
        zip.start_file("stage.toml", SimpleFileOptions::default()).unwrap();
        zip.write_all(&config).unwrap();
        let content = match self.below(4) {
            // A small file that unpacks to a large one.
            0 => vec![0; 3 << 20],
            1 => self.model(),
            _ => b"{\"objects\":[]}".to_vec(),
        };
        // Names that the library itself refuses are left out.
        let _ = match self.below(5) {
            0 => zip.add_symlink(name, "/etc", SimpleFileOptions::default()),
            _ => zip.start_file(name, SimpleFileOptions::default()).and_then(|()| Ok(zip.write_all(&content)?)),
        };
        zip.finish().map(Cursor::into_inner).unwrap_or_default()
    }

    /// Returns a model with links, lists of the wrong type, or a header that does not match.
    fn model(&mut self) -> Vec<u8> {
        let uri = self.of(&["http://evil.example/x.png", "../../outside.txt", "file:///etc/passwd", "data:,", "//x", "\\\\x\\y"]);
        let list = self.of(&["images", "buffers", "extensionsUsed", "meshes"]);
        let mut bytes = match self.below(4) {
            0 => glb(r#"{"asset":{"version":"2.0"}}"#),
            1 => {
                let described = self.json(json!({"asset": {"version": "2.0"}, "images": [{"uri": uri}], "buffers": [{"byteLength": 4}]}));
                glb(&String::from_utf8_lossy(&described))
            }
            _ => glb(&json!({"asset": {"version": "2.0"}, list: [{"uri": uri}, "KHR_draco_mesh_compression"]}).to_string()),
        };
        if self.below(4) == 0 {
            let at = 4 * self.below(5);
            bytes[at..at + 4].copy_from_slice(&self.of(&[0, 1, 0x7FFF_FFFF, u32::MAX]).to_le_bytes());
        }
        bytes
    }
}

/// Whether a refusal says what is wrong, as text or as a config's findings.
fn explains_itself(answer: &Answer) -> bool {
    let text = answer.text();
    let findings = || serde_json::from_str::<Value>(&text).is_ok_and(|said| said["findings"][0]["sentence"].is_string());
    (text.ends_with('\n') && text.trim().len() > 10) || findings()
}

/// Returns all files in a folder and its subfolders by relative path; links are not followed.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let (name, is_folder) = entry.map(|entry| (entry.file_name(), entry.file_type().unwrap().is_dir())).unwrap();
        if is_folder {
            found.extend(files(&folder.join(&name)).into_iter().map(|below| Path::new(&name).join(below)));
        }
        found.push(name.into());
    }
    found
}

#[test]
fn two_thousand_wrong_requests_do_no_harm() {
    let root = tempfile::tempdir().unwrap();
    let stage = root.path().join("stage");
    std::fs::create_dir(&stage).unwrap();
    std::fs::write(root.path().join("outside.txt"), SECRET).unwrap();
    recording(&stage);
    let supervisor = supervised(&stage);
    let server = whole_server(&supervisor, None);
    let routes: Vec<Listed> = listed(&server).into_iter().filter(|route| route.path.starts_with("/api/")).collect();
    let mut requests = Requests { random: Pcg64::seed_from_u64(18), config: std::fs::read(supervisor.file()).unwrap() };
    let (mut taken, mut refused, mut harm) = (0, 0, Vec::new());
    for count in 0..REQUESTS {
        let wrong = requests.next(&routes);
        let answer = exchange(server.address(), &wrong.method, &wrong.path, &wrong.headers, &wrong.content);
        let shown = || {
            format!(
                "request {count}, {} {} {:?}\n{}\n{}",
                wrong.method,
                wrong.path,
                wrong.headers,
                String::from_utf8_lossy(&wrong.content).chars().take(2000).collect::<String>(),
                answer.text()
            )
        };
        let not_yet = answer.status == 503 && NOT_YET.iter().any(|path| wrong.path.starts_with(path.split('{').next().unwrap()));
        let is_answered = (200..500).contains(&answer.status) || not_yet;
        let is_explained = answer.status < 400 || wrong.method == "HEAD" || not_yet || explains_itself(&answer);
        if !is_answered || !is_explained || answer.text().contains(SECRET) {
            harm.push(format!("{} for {}", answer.status, shown()));
        }
        (taken, refused) = (taken + usize::from(answer.status < 400), refused + usize::from(answer.status >= 400));
        // Requests that set the lock are sent too; release it, so that the others are not simply
        // refused.
        if wrong.path.starts_with("/api/v1/lock") {
            exchange(server.address(), "POST", "/api/v1/unlock", "Host: localhost\r\n", b"");
        }
    }
    assert!(harm.is_empty(), "{} of {REQUESTS}:\n{}", harm.len(), harm[..harm.len().min(20)].join("\n\n"));
    println!("{REQUESTS} requests, {taken} taken, {refused} refused");
    assert!(taken > REQUESTS / 10 && refused > REQUESTS / 4, "{taken} taken, {refused} refused");
    assert_eq!(exchange(server.address(), "GET", "/api/v1/session", "Host: localhost\r\n", b"").status, 200);
    let mut beside: Vec<_> = std::fs::read_dir(root.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    beside.sort();
    assert_eq!(
        (beside, std::fs::read_to_string(root.path().join("outside.txt")).unwrap().as_str()),
        (vec!["outside.txt".into(), "stage".into()], SECRET)
    );
    assert!(!Path::new("/tmp/stagepose-outside").exists());
    // While a job runs, its folder is incomplete: wait until another one can start.
    while supervisor.jobs.start("end", String::new(), &supervisor.link.events, |_| Ok(String::new())).is_err() {
        std::thread::yield_now();
    }
    let there = files(&stage);
    let is_hidden = |path: &Path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
    let half_done: Vec<&PathBuf> = there.iter().filter(|path| is_hidden(path)).collect();
    assert!(half_done.is_empty(), "{half_done:?}");
    let links: Vec<&PathBuf> = there.iter().filter(|path| stage.join(path).is_symlink()).collect();
    assert_eq!(links, [Path::new("recordings/root")], "the recordings' own link, which leads out and is not followed");
}
