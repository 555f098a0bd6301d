//! What `check` tries of a config's outputs: whether their ports and folders are available, and
//! whether receivers can tell bodies apart.

use std::ffi::OsString;
use std::net::{SocketAddr, TcpListener};
use std::ops::Range;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use toml::Spanned;

use super::as_typed::{Config, Output};
use super::origin::Origin;
use super::other_tracker::OTHER_TRACKER;
use super::outputs::OUTPUT;
use super::{ConfigError, Problem, Settings};
use crate::publish::{BodyChoice, Protocol, Publisher, TransportError, udp_listener};

impl Settings {
    /// Opens every output and the HTTP server's port and closes them again.
    ///
    /// # Errors
    /// The first one that is not available or conflicts with another, with its place in the config.
    pub fn rehearse_outputs(&self) -> Result<(), ConfigError> {
        self.rehearse_outputs_beside(&[])
    }

    /// As [`rehearse_outputs`](Self::rehearse_outputs), ignoring what this process listens on, as
    /// that will be free for the new config.
    ///
    /// # Errors
    /// As [`rehearse_outputs`](Self::rehearse_outputs).
    pub(crate) fn rehearse_outputs_beside(&self, held: &[SocketAddr]) -> Result<(), ConfigError> {
        let is_held = |address: SocketAddr| held.iter().any(|other| collide(*other, address));
        let text = &self.source.text;
        let (typed, origin) = (Config::parse(text, &self.file)?, Origin::new(&self.file, text));
        self.names_differ(&typed, &origin)?;
        self.ports_differ(&typed, &origin)?;
        self.files_differ(&typed, &origin)?;
        if let Err((index, reason)) = Publisher::rehearse(&self.outputs, &is_held) {
            let output = typed.output.get(index).map(|o| (o.get_ref(), o.span()));
            let (key, span) = output.map_or(("to", 0..0), |(o, span)| place_of(&reason, o, span));
            return Err(origin.value(OUTPUT, key, &span, Problem::Transport(reason)));
        }
        self.rehearse_other_tracker(&typed, &origin, &is_held)?;
        let Some(http) = self.http.as_ref().filter(|http| !is_held(http.listen)) else { return Ok(()) };
        let reason = match TcpListener::bind(http.listen) {
            Ok(_) => return Ok(()),
            Err(error) => error.to_string(),
        };
        Err(origin.value("[http]", "listen", &http_place(&typed), Problem::Listen { address: http.listen, reason }))
    }

    /// Opens the other tracker's port and closes it again.
    fn rehearse_other_tracker(&self, typed: &Config, origin: &Origin<'_>, is_held: &dyn Fn(SocketAddr) -> bool) -> Result<(), ConfigError> {
        let Some(other) = self.other_tracker.as_ref().filter(|other| !is_held(other.listen)) else { return Ok(()) };
        let Err(error) = udp_listener(other.listen, other.interface.as_ref()) else { return Ok(()) };
        let place = typed.other_tracker.as_ref().and_then(|other| other.get_ref().listen.as_ref()).map_or(0..0, Spanned::span);
        let problem = Problem::Listen { address: other.listen, reason: error.to_string() };
        Err(origin.value(OTHER_TRACKER, "listen", &place, problem))
    }

    /// Refuses an object with the camera's output name if an output sends both: receivers cannot
    /// tell them apart.
    fn names_differ(&self, typed: &Config, origin: &Origin<'_>) -> Result<(), ConfigError> {
        let is_camera = |name: &str| name.eq_ignore_ascii_case("camera");
        let Some(index) = self.objects.iter().position(|object| is_camera(&object.name)) else { return Ok(()) };
        let sends_both = |bodies: &[BodyChoice]| bodies.contains(&BodyChoice::Camera) && bodies.contains(&BodyChoice::Object(index));
        let name = typed.object.get(index).and_then(|object| object.get_ref().name.as_ref());
        match name {
            Some(name) if self.outputs.iter().any(|output| output.enabled && sends_both(&output.bodies)) => {
                Err(origin.value("[[object]]", "name", &name.span(), Problem::NamedAsCamera(name.get_ref().clone())))
            }
            _ => Ok(()),
        }
    }

    /// Returns the addresses it listens on.
    pub(crate) fn listens(&self) -> impl Iterator<Item = SocketAddr> + '_ {
        let of_outputs = self.outputs.iter().filter(|output| output.enabled).flat_map(|output| {
            let tcp = output.stream().and_then(|stream| stream.tcp_listen);
            tcp.into_iter().chain(output.listen())
        });
        let of_other_tracker = self.other_tracker.as_ref().map(|other| other.listen);
        of_outputs.chain(of_other_tracker).chain(self.http.as_ref().map(|http| http.listen))
    }

    /// Refuses two outputs to one file, by whatever name: their lines would mix.
    fn files_differ(&self, typed: &Config, origin: &Origin<'_>) -> Result<(), ConfigError> {
        let mut taken: Vec<(FilePlace, &str)> = Vec::new();
        for (output, typed) in self.outputs.iter().zip(&typed.output).filter(|(output, _)| output.enabled) {
            let Some(file) = output.stream().and_then(|stream| stream.file.as_ref()) else { continue };
            let Some(place) = FilePlace::of(file) else { continue };
            if let Some((_, other)) = taken.iter().find(|(other, _)| *other == place) {
                let span = typed.get_ref().file.as_ref().map_or(typed.span(), Spanned::span);
                let reason = format!("the output {other} writes to it too");
                return Err(origin.value(OUTPUT, "file", &span, Problem::OutputFile { file: file.clone(), reason }));
            }
            taken.push((place, &output.name));
        }
        Ok(())
    }

    /// Refuses two listeners on one port of this machine: each would find it free when tried alone.
    fn ports_differ(&self, typed: &Config, origin: &Origin<'_>) -> Result<(), ConfigError> {
        let mut taken: Vec<(SocketAddr, String)> = Vec::new();
        let of_outputs = self.outputs.iter().zip(&typed.output).filter(|(output, _)| output.enabled).filter_map(|(output, typed)| {
            let Protocol::Json(json) = &output.protocol else { return None };
            Some((json.stream.tcp_listen?, OUTPUT, "tcp_listen", output_place(typed), format!("the output {}", output.name)))
        });
        let of_http = self.http.iter().map(|http| (http.listen, "[http]", "listen", http_place(typed), "the HTTP server".to_owned()));
        for (address, section, key, place, who) in of_outputs.chain(of_http) {
            if let Some((_, other)) = taken.iter().find(|(other, _)| collide(*other, address)) {
                let reason = format!("{other} listens there too");
                return Err(origin.value(section, key, &place, Problem::Listen { address, reason }));
            }
            taken.push((address, who));
        }
        Ok(())
    }
}

/// A file's identity: device and inode, or, if it does not exist yet, its folder's device and inode
/// and its name.
#[derive(Debug, PartialEq)]
struct FilePlace(u64, u64, Option<OsString>);

impl FilePlace {
    /// Returns the identity; `None` for what several outputs may share: standard output, and
    /// devices, which store nothing.
    fn of(file: &Path) -> Option<Self> {
        if file == Path::new("-") {
            return None;
        }
        if let Ok(about) = std::fs::metadata(file) {
            return about.is_file().then(|| Self(about.dev(), about.ino(), None));
        }
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let about = std::fs::metadata(folder).ok()?;
        Some(Self(about.dev(), about.ino(), file.file_name().map(ToOwned::to_owned)))
    }
}

/// Whether two addresses cannot both be listened on. An unspecified address takes the port on every
/// address; port 0 is any free one.
fn collide(a: SocketAddr, b: SocketAddr) -> bool {
    let (a_ip, b_ip) = (a.ip().to_canonical(), b.ip().to_canonical());
    a.port() != 0 && a.port() == b.port() && (a_ip == b_ip || a_ip.is_unspecified() || b_ip.is_unspecified())
}

/// Returns the key that requested the unavailable resource, and its place.
fn place_of(error: &TransportError, output: &Output, section: Range<usize>) -> (&'static str, Range<usize>) {
    let (key, span) = match error {
        TransportError::Udp(_) => ("interface", output.interface.as_ref().map(Spanned::span)),
        TransportError::Listen { .. } => ("tcp_listen", output.tcp_listen.as_ref().map(Spanned::span)),
        TransportError::Hear { .. } => ("listen", output.listen.as_ref().map(Spanned::span)),
        TransportError::File { .. } => ("file", output.file.as_ref().map(Spanned::span)),
    };
    (key, span.unwrap_or(section))
}

fn http_place(typed: &Config) -> Range<usize> {
    typed.http.as_ref().and_then(|http| http.listen.as_ref()).map_or(0..0, Spanned::span)
}

fn output_place(typed: &Spanned<Output>) -> Range<usize> {
    typed.get_ref().tcp_listen.as_ref().map_or(typed.span(), Spanned::span)
}
