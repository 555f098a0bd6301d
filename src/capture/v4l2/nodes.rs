//! Camera nodes and their names. A node's number changes with every plug; a by-id or by-path name
//! persists.
//!
//! A camera can be named by `/dev/v4l/by-id/…` (this very camera, on any port),
//! `/dev/v4l/by-path/…` (whatever is on that port), `/dev/videoN`, `N`, a part of its by-id name or
//! of the camera's own name, or `first`.

use std::fs;
use std::path::{Path, PathBuf};

use v4l::Device;
use v4l::capability::Flags;

use super::ioctl;
use crate::capture::camera::OpenFault;

/// A node that supports video capture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Node {
    /// N of /dev/videoN.
    pub number: u32,
    /// The camera's own name.
    pub card: String,
    /// The driver's name.
    pub driver: String,
    /// The driver's name of the port.
    pub bus: String,
    /// Names below /dev/v4l/by-id.
    pub by_id: Vec<PathBuf>,
    /// Names below /dev/v4l/by-path.
    pub by_path: Vec<PathBuf>,
    /// Distinguishes this camera from others of its kind: maker, model and serial number if USB
    /// states them, else its place.
    pub identity: String,
}

impl Node {
    /// Returns /dev/videoN.
    pub fn path(&self) -> PathBuf {
        PathBuf::from(format!("/dev/video{}", self.number))
    }

    /// Returns name and node for display.
    pub fn title(&self) -> String {
        format!("{} ({})", self.card, self.path().display())
    }
}

/// Lists all camera nodes by number, without metadata nodes and outputs.
pub fn camera_nodes() -> Vec<Node> {
    let Ok(entries) = fs::read_dir("/dev") else { return Vec::new() };
    let mut numbers: Vec<u32> = entries.flatten().filter_map(|e| number_of(&e.path())).collect();
    numbers.sort_unstable();
    numbers.into_iter().filter_map(node).collect()
}

/// Parses N from a path that ends in `videoN`.
fn number_of(path: &Path) -> Option<u32> {
    path.file_name()?.to_str()?.strip_prefix("video")?.parse().ok()
}

fn node(number: u32) -> Option<Node> {
    let path = PathBuf::from(format!("/dev/video{number}"));
    let caps = Device::with_path(&path).ok().and_then(|device| ioctl::contained(|| device.query_caps())?.ok())?;
    if !caps.capabilities.contains(Flags::VIDEO_CAPTURE) {
        return None;
    }
    let (by_id, by_path) = (links("/dev/v4l/by-id", number), links("/dev/v4l/by-path", number));
    let identity = identity(number).unwrap_or_else(|| format!("{} {}", caps.card, caps.bus));
    Some(Node { number, card: caps.card, driver: caps.driver, bus: caps.bus, by_id, by_path, identity })
}

/// Returns the links in a folder that lead to /dev/videoN.
fn links(folder: &str, number: u32) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    let mut found: Vec<PathBuf> = entries.filter(|p| fs::canonicalize(p).ok().as_deref().and_then(number_of) == Some(number)).collect();
    found.sort();
    found
}

/// Reads the identity from sysfs: maker, model, serial number and index of the node, or the place
/// of a device that is not USB.
fn identity(number: u32) -> Option<String> {
    let class = PathBuf::from(format!("/sys/class/video4linux/video{number}"));
    let read = |path: PathBuf| fs::read_to_string(path).ok().map(|text| text.trim().to_owned());
    let index = read(class.join("index")).unwrap_or_default();
    let interface = fs::canonicalize(class.join("device")).ok()?;
    let usb = interface.ancestors().take(3).find(|folder| folder.join("idVendor").exists());
    Some(match usb {
        Some(usb) => {
            let part = |name: &str| read(usb.join(name)).unwrap_or_default();
            format!("usb {}:{} {} {} index {index}", part("idVendor"), part("idProduct"), part("product"), part("serial"))
        }
        None => format!("{} index {index}", interface.display()),
    })
}

/// The camera that a configured name meant before.
#[derive(Debug, Clone, Copy)]
pub struct Known<'a> {
    /// [`Node::identity`]
    pub identity: &'a str,
    /// [`Node::bus`]
    pub bus: &'a str,
}

/// Finds the camera that a configured name means now.
///
/// `known` is the camera that the name meant before: a number or `first` then follows that camera
/// to its new number. Of several cameras with the same identity (no serial numbers), the one on the
/// same port is preferred.
///
/// # Errors
/// A sentence that lists the available cameras.
pub fn find_node(name: &str, known: Option<Known<'_>>) -> Result<Node, OpenFault> {
    let nodes = camera_nodes();
    // by-id already means this very camera, and by-path whatever is on the port: neither follows an
    // identity.
    let lasting = name.starts_with("/dev/v4l/");
    if let (Some(known), false) = (known, lasting) {
        let missing = || OpenFault(format!("the camera {name} ({}) is not plugged in; plug it in again", known.identity));
        return same_camera(&nodes, known).cloned().ok_or_else(missing);
    }
    let found = if name == "first" {
        nodes.first()
    } else if let Ok(number) = name.parse::<u32>() {
        nodes.iter().find(|n| n.number == number)
    } else if name.starts_with('/') {
        let number = fs::canonicalize(name).ok().as_deref().and_then(number_of);
        nodes.iter().find(|n| Some(n.number) == number)
    } else {
        let part = name.to_lowercase();
        let names =
            |n: &&Node| n.by_id.iter().any(|p| p.to_string_lossy().to_lowercase().contains(&part)) || n.card.to_lowercase().contains(&part);
        nodes.iter().find(names)
    };
    found.cloned().ok_or_else(|| not_there(name, &nodes))
}

fn same_camera<'a>(nodes: &'a [Node], known: Known<'_>) -> Option<&'a Node> {
    let twins = || nodes.iter().filter(|n| n.identity == known.identity);
    twins().find(|n| n.bus == known.bus).or_else(|| twins().next())
}

fn not_there(name: &str, nodes: &[Node]) -> OpenFault {
    if nodes.is_empty() {
        let locked: Vec<String> = (0..64).map(|n| format!("/dev/video{n}")).filter(|p| is_forbidden(Path::new(p))).collect();
        return OpenFault(match locked.first() {
            Some(path) => format!(
                "{path} may not be opened by this user; add the user to the group video: sudo usermod -aG video $USER, then log in again"
            ),
            None => format!("no camera is plugged in (looked for {name}); plug one in, and see what there is with: stagepose devices"),
        });
    }
    let titles: Vec<String> = nodes.iter().map(Node::title).collect();
    OpenFault(format!("there is no camera {name}; there is {}; set `device` in [camera] to one of them", titles.join(", ")))
}

fn is_forbidden(path: &Path) -> bool {
    fs::OpenOptions::new().read(true).write(true).open(path).is_err_and(|e| e.kind() == std::io::ErrorKind::PermissionDenied)
}

/// Lists other programs that hold a node open, as "name (process 123)", as far as this user may see
/// them.
pub fn programs_that_hold(node: &Path) -> Vec<String> {
    let own = std::process::id().to_string();
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten().map(|e| e.path());
    let holds = |process: &PathBuf| {
        let files = fs::read_dir(process.join("fd")).into_iter().flatten().flatten();
        process.file_name().is_some_and(|n| n != own.as_str())
            && files.into_iter().any(|f| fs::read_link(f.path()).is_ok_and(|l| l == node))
    };
    let title = |process: PathBuf| {
        let id = process.file_name()?.to_str()?.to_owned();
        id.parse::<u32>().ok()?;
        Some(format!("{} (process {id})", fs::read_to_string(process.join("comm")).ok()?.trim()))
    };
    processes.filter(holds).filter_map(title).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_video_nodes_have_numbers() {
        let numbers = ["/dev/video12", "/dev/video", "/dev/videoX", "/dev/v4l-subdev0", "/"].map(|p| number_of(Path::new(p)));
        assert_eq!(numbers, [Some(12), None, None, None, None]);
    }

    fn camera(number: u32, bus: &str) -> Node {
        let (card, driver, bus, identity) = ("Cam".into(), "uvcvideo".into(), bus.into(), "usb 1:2".into());
        Node { number, card, driver, bus, by_id: vec![], by_path: vec![], identity }
    }

    #[test]
    fn between_identical_cameras_the_one_at_the_same_port_wins() {
        let twins = [camera(0, "usb-1"), camera(2, "usb-2")];
        let found = |identity, bus| same_camera(&twins, Known { identity, bus }).map(|n| n.number);
        assert_eq!(found("usb 1:2", "usb-2"), Some(2));
        assert_eq!(found("usb 1:2", "usb-3"), Some(0), "it moved to another port");
        assert_eq!(found("usb 9:9", "usb-1"), None);
    }

    #[test]
    fn a_missing_camera_is_reported_with_those_present() {
        assert!(not_there("front", &[camera(3, "usb-1")]).to_string().contains("there is no camera front; there is Cam (/dev/video3);"));
        assert!(find_node("/dev/v4l/by-id/no-such-camera", None).is_err());
    }

    #[test]
    fn the_process_holding_a_file_is_found() {
        let mut child = std::process::Command::new("sleep").arg("30").stdin(fs::File::open("/dev/zero").unwrap()).spawn().unwrap();
        let holders = programs_that_hold(Path::new("/dev/zero"));
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(holders.iter().any(|h| h.contains(&format!("sleep (process {})", child.id()))), "{holders:?}");
    }
}
