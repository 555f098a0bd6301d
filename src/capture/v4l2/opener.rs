//! Opens a V4L2 camera as configured: finds it by its persistent name, sets the best mode, and sets
//! its controls.

use std::collections::BTreeMap;
use std::io;
use std::sync::Mutex;

use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC};

use super::controls::{self, Held};
use super::ioctl::contained;
use super::nodes::{Known, Node, find_node, programs_that_hold};
use super::{camera, listing};
use crate::capture::camera::{Camera, CameraMode, CameraOpener, OpenFault};
use crate::capture::choice::{Offer, Wanted, choose};

/// Opens one camera as often as needed.
pub struct V4l2Opener {
    device: String,
    wanted: Wanted,
    controls: BTreeMap<String, i64>,
    /// Which camera the name meant before, and which sentences were already logged.
    memory: Mutex<Memory>,
}

#[derive(Default)]
struct Memory {
    node: Option<Node>,
    reported: Vec<String>,
}

/// Returns a warning if `device` now means another camera than before, or the same one on another
/// port.
fn change(device: &str, before: &Node, now: &Node) -> Option<String> {
    if before.identity != now.identity {
        return Some(format!("{device} is now another camera than before: {}; check that it is the calibrated one", now.title()));
    }
    (before.bus != now.bus).then(|| format!("the camera {} is now on another port: {}", now.title(), now.bus))
}

impl V4l2Opener {
    /// Creates an opener; `device` is a by-id or by-path link, a node, a number, a part of the
    /// camera's name, or `first`.
    pub fn new(device: String, wanted: Wanted, controls: BTreeMap<String, i64>) -> Self {
        Self { device, wanted, controls, memory: Mutex::default() }
    }

    /// Logs a sentence once, not at every reopening.
    fn say_once(&self, sentence: String, warn: bool) {
        let mut memory = self.memory.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if memory.reported.contains(&sentence) {
            return;
        }
        if warn {
            tracing::warn!("{sentence}");
        } else {
            tracing::info!("{sentence}");
        }
        memory.reported.push(sentence);
    }

    fn find(&self) -> Result<Node, OpenFault> {
        let known = self.memory.lock().unwrap_or_else(std::sync::PoisonError::into_inner).node.clone();
        find_node(&self.device, known.as_ref().map(|node| Known { identity: &node.identity, bus: &node.bus }))
    }

    /// Remembers the camera, and warns if it or its port has changed.
    fn remember(&self, node: &Node) {
        let mut memory = self.memory.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(change) = memory.node.as_ref().and_then(|before| change(&self.device, before, node)) {
            tracing::warn!("{change}");
        }
        memory.node = Some(node.clone());
    }

    /// Sets mode and controls through a separate handle, which is closed again.
    fn prepare(&self, node: &Node) -> Result<(Offer, Held, Vec<String>), OpenFault> {
        let fault = |e: io::Error| OpenFault(opening_fault(node, &e));
        let device = Device::with_path(node.path()).map_err(fault)?;
        let offers = listing::offers(&device);
        let (offer, why) = choose(&offers, &self.wanted).map_err(|reason| OpenFault(format!("{}: {reason}", node.title())))?;
        let fourcc = offer.layout.fourcc().as_bytes();
        let fourcc = FourCC::new(&[fourcc[0], fourcc[1], fourcc[2], fourcc[3]]);
        let set = contained(|| {
            device.set_format(&Format::new(offer.width, offer.height, fourcc))?;
            device.set_params(&Parameters::with_fps(offer.fps)).map(|_| ())
        });
        set.unwrap_or_else(|| Err(io::Error::other("the V4L library failed"))).map_err(fault)?;
        let mode = format!("{} {}x{} at {}/s", offer.layout.fourcc(), offer.width, offer.height, offer.fps);
        let mut notes = vec![format!("taking {mode}: {why}")];
        self.say_once(format!("{}: {}", node.title(), notes[0]), false);
        let held = controls::hold(device.handle().fd(), &self.controls);
        for warning in &held.warnings {
            self.say_once(format!("{}: {warning}", node.title()), true);
        }
        for (name, value) in &held.values {
            tracing::info!("{}: control {name} reads back {value}", node.title());
        }
        notes.extend(held.warnings.iter().cloned());
        Ok((offer, held, notes))
    }
}

impl CameraOpener for V4l2Opener {
    fn open(&self) -> Result<Box<dyn Camera>, OpenFault> {
        let node = self.find()?;
        let (offer, held, notes) = self.prepare(&node)?;
        let mode = CameraMode {
            name: node.title(),
            size: (offer.width, offer.height),
            layout: offer.layout,
            fps: offer.fps.into(),
            exposure_s: held.exposure_s,
            controls: held.values,
            notes,
        };
        let opened = contained(|| camera::open(node.number, &offer, mode));
        let camera = match opened {
            Some(Ok(camera)) => camera,
            Some(Err(reason)) if reason.contains("busy") || reason.contains("os error 16") => return Err(OpenFault(busy(&node))),
            Some(Err(reason)) => {
                return Err(OpenFault(format!("{} cannot be opened: {reason}; unplug it and plug it in again", node.title())));
            }
            None => {
                return Err(OpenFault(format!(
                    "{} cannot be opened: the V4L library failed; unplug it and plug it in again",
                    node.title()
                )));
            }
        };
        self.remember(&node);
        Ok(Box::new(camera))
    }
}

fn opening_fault(node: &Node, error: &io::Error) -> String {
    match error.raw_os_error() {
        Some(nix::libc::EBUSY) => busy(node),
        Some(nix::libc::EACCES) => {
            format!(
                "{} may not be opened by this user; add the user to the group video: sudo usermod -aG video $USER, then log in again",
                node.title()
            )
        }
        _ => format!("{} cannot be opened: {error}; unplug it and plug it in again", node.title()),
    }
}

fn busy(node: &Node) -> String {
    let holders = programs_that_hold(&node.path());
    let by = if holders.is_empty() { "another program".to_owned() } else { holders.join(", ") };
    format!("{} is in use by {by}; end that program", node.title())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_changed_camera_or_port_is_reported() {
        let camera = |identity: &str, bus: &str| Node {
            number: 4,
            card: "Cam".into(),
            driver: "uvcvideo".into(),
            bus: bus.into(),
            by_id: vec![],
            by_path: vec![],
            identity: identity.into(),
        };
        let reported = |now: Node| change("/dev/v4l/by-path/p", &camera("a", "usb-1"), &now);
        assert_eq!(reported(camera("a", "usb-1")), None);
        assert!(reported(camera("a", "usb-2")).unwrap().ends_with("Cam (/dev/video4) is now on another port: usb-2"));
        assert!(
            reported(camera("b", "usb-1")).unwrap().starts_with("/dev/v4l/by-path/p is now another camera than before: Cam (/dev/video4)")
        );
    }
}
