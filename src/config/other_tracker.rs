//! `[other_tracker]`: where the packets of another tracker arrive, which of them are meant, and the
//! scale of its zoom.

use std::net::SocketAddr;

use toml::Spanned;

use super::origin::Origin;
use super::values::Section;
use super::{ConfigError, Problem, as_typed};
use crate::protocols::camera_packet::Spoken;
use crate::publish::{Interface, needs_interface};

/// The section's name in messages.
pub(super) const OTHER_TRACKER: &str = "[other_tracker]";

/// The `[other_tracker]` section.
#[derive(Debug, Clone, PartialEq)]
pub struct OtherTrackerSettings {
    /// The protocol, and which source.
    pub spoken: Spoken,
    /// Where packets arrive: an address of this machine, or a multicast group.
    pub listen: SocketAddr,
    /// The network of a group.
    pub interface: Option<Interface>,
    /// Raw zoom at the wide and at the long end.
    pub zoom_range: Option<[f64; 2]>,
}

impl OtherTrackerSettings {
    /// Says what it hears: "freed on 0.0.0.0:40000, camera 1".
    pub fn in_words(&self) -> String {
        let source = match &self.spoken {
            Spoken::Freed(Some(id)) => format!("camera {id}"),
            Spoken::OpenTrackIo(Some(id)) => format!("source {id}"),
            Spoken::Freed(None) | Spoken::OpenTrackIo(None) => "the first source that is heard".to_owned(),
        };
        format!("{} on {}, {source}", self.spoken.word(), self.listen)
    }
}

/// Checks the section.
pub(super) fn other_tracker(origin: &Origin<'_>, typed: &Spanned<as_typed::OtherTracker>) -> Result<OtherTrackerSettings, ConfigError> {
    let (section, span) = (Section { origin, name: OTHER_TRACKER }, typed.span());
    let typed = typed.get_ref();
    let missing = |key, hint| origin.missing(origin.section_at(section.name, &span), key, hint);
    let Some(protocol) = &typed.protocol else {
        return Err(missing("protocol", "`protocol = \"freed\"` or `protocol = \"opentrackio\"`"));
    };
    let is_freed =
        section.word("protocol", Some(protocol), false, &[("freed", true), ("opentrackio", false)], "\"freed\" or \"opentrackio\"")?;
    let Some(listen) = &typed.listen else {
        return Err(missing("listen", "the port to which the other tracker sends, such as `listen = \"0.0.0.0:40000\"`"));
    };
    let wanted =
        "an address of this machine and a port, such as \"0.0.0.0:40000\" for any, or a multicast group, such as \"235.135.1.1:55555\"";
    let address = listen.get_ref().parse::<SocketAddr>().ok().filter(|address| address.port() != 0);
    let address = address.ok_or_else(|| section.unusable("listen", listen, wanted))?;
    let interface = interface(&section, typed.interface.as_ref(), listen, address)?;
    Ok(OtherTrackerSettings {
        spoken: spoken(&section, typed, is_freed)?,
        listen: address,
        interface,
        zoom_range: zoom_range(&section, typed)?,
    })
}

fn spoken(section: &Section<'_>, typed: &as_typed::OtherTracker, is_freed: bool) -> Result<Spoken, ConfigError> {
    match (&typed.camera_id, &typed.source_id) {
        (Some(id), _) if !is_freed => Err(section.conflict("camera_id", id, "it belongs to freed; write `source_id`")),
        (_, Some(id)) if is_freed => Err(section.conflict("source_id", id, "it belongs to opentrackio; write `camera_id`")),
        (Some(id), _) => {
            let number = section.count("camera_id", Some(id), 0, 0..=255, "the number that the other tracker sends, 0 to 255")?;
            Ok(Spoken::Freed(u8::try_from(number).ok()))
        }
        (None, Some(id)) => {
            let wanted = "the sourceId that the other tracker sends, such as \"urn:uuid:…\"; `stagepose listen opentrackio PORT` shows it";
            Ok(Spoken::OpenTrackIo(Some(section.text("source_id", id, wanted)?)))
        }
        (None, None) => Ok(if is_freed { Spoken::Freed(None) } else { Spoken::OpenTrackIo(None) }),
    }
}

/// Returns the network, which a group needs, as in `[[output]]`.
fn interface(
    section: &Section<'_>,
    typed: Option<&Spanned<String>>,
    listen: &Spanned<String>,
    address: SocketAddr,
) -> Result<Option<Interface>, ConfigError> {
    let is_v6 = address.is_ipv6();
    let Some(typed) = typed else {
        let problem = if is_v6 {
            "a multicast or link-local IPv6 address needs `interface`, this machine's name for that network, such as interface = \"eth0\""
        } else {
            "a multicast address needs `interface`, this machine's IPv4 address on that network, such as interface = \"192.168.1.10\""
        };
        return if needs_interface(&address) { Err(section.conflict("listen", listen, problem)) } else { Ok(None) };
    };
    let interface = Interface::parse(typed.get_ref()).filter(|interface| is_v6 == matches!(interface, Interface::Name(_)));
    let wanted = if is_v6 {
        "this machine's name for that network, such as \"eth0\""
    } else {
        "this machine's IPv4 address on that network, such as \"192.168.1.10\""
    };
    interface.map(Some).ok_or_else(|| section.unusable("interface", typed, wanted))
}

fn zoom_range(section: &Section<'_>, typed: &as_typed::OtherTracker) -> Result<Option<[f64; 2]>, ConfigError> {
    let Some(typed) = &typed.zoom_range else { return Ok(None) };
    let range = typed.get_ref().values();
    if range.iter().all(|v| v.is_finite()) && range[0] != range[1] {
        return Ok(Some(range));
    }
    let wanted = "the raw zoom at the wide and at the long end, such as [0, 65535]";
    Err(section.refuse("zoom_range", &typed.span(), Problem::Range { value: format!("{range:?}"), wanted }))
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;
    use std::path::Path;

    use super::*;

    fn read(keys: &str) -> Result<OtherTrackerSettings, String> {
        let (file, text) = (Path::new("stage.toml"), format!("[other_tracker]\n{keys}\n"));
        let typed = as_typed::Config::parse(&text, file).map_err(|e| e.to_string())?;
        other_tracker(&Origin::new(file, &text), typed.other_tracker.as_ref().unwrap()).map_err(|e| e.to_string())
    }

    #[test]
    fn keys_become_settings() {
        let plain = read("protocol = \"freed\"\nlisten = \"0.0.0.0:40000\"").unwrap();
        assert_eq!((plain.spoken, plain.listen.port(), plain.interface, plain.zoom_range), (Spoken::Freed(None), 40000, None, None));
        let all = read("protocol = \"freed\"\nlisten = \"[::]:40000\"\ncamera_id = 3\nzoom_range = [65535, 0]").unwrap();
        assert_eq!(all.in_words(), "freed on [::]:40000, camera 3");
        assert_eq!((all.spoken, all.zoom_range), (Spoken::Freed(Some(3)), Some([65535.0, 0.0])));
        let group = "protocol = \"opentrackio\"\nlisten = \"235.135.1.1:55555\"\ninterface = \"127.0.0.1\"\nsource_id = \"a\"";
        let group = read(group).unwrap();
        assert_eq!(
            (group.spoken, group.interface),
            (Spoken::OpenTrackIo(Some("a".to_owned())), Some(Interface::Address(Ipv4Addr::LOCALHOST)))
        );
    }

    #[test]
    fn slips_are_refused_with_their_line_and_fix() {
        let freed = "protocol = \"freed\"\nlisten = \"0.0.0.0:40000\"\n";
        for (keys, parts) in [
            (String::new(), ["[other_tracker], line 1,", "protocol = \"freed\""]),
            ("protocol = \"fredd\"".to_owned(), ["`protocol` in [other_tracker], line 2", "did you mean `freed`"]),
            ("protocol = \"freed\"".to_owned(), ["has no `listen`", "0.0.0.0:40000"]),
            ("protocol = \"freed\"\nlisten = \"40000\"".to_owned(), ["`listen` in [other_tracker], line 3", "0.0.0.0:40000"]),
            ("protocol = \"freed\"\nlisten = \"239.1.2.3:40000\"".to_owned(), ["`listen`", "needs `interface`"]),
            ("protocol = \"freed\"\nlisten = \"239.1.2.3:4\"\ninterface = \"eth0\"".to_owned(), ["`interface`", "IPv4 address"]),
            (format!("{freed}camera_id = 256"), ["`camera_id`", "0 to 255"]),
            (format!("{freed}source_id = \"a\""), ["`source_id`", "write `camera_id`"]),
            ("protocol = \"opentrackio\"\nlisten = \"0.0.0.0:4\"\ncamera_id = 1".to_owned(), ["`camera_id`", "write `source_id`"]),
            (format!("{freed}zoom_range = [5, 5]"), ["`zoom_range`", "at the wide and at the long end"]),
            (format!("{freed}zoom = [0, 5]"), ["unknown key `zoom`", "zoom_range"]),
        ] {
            let message = read(&keys).unwrap_err();
            assert!(parts.iter().all(|part| message.contains(part)), "{keys}: {message}");
        }
    }
}
