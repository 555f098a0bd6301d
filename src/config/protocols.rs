//! The keys that each `kind` of `[[output]]` reads besides the common ones; keys of other kinds are
//! refused.

use std::net::SocketAddr;
use std::ops::Range;

use toml::Spanned;

use super::as_typed;
use super::values::Section;
use super::{ConfigError, Problem};
use crate::protocols::opentrackio::Encoding;
use crate::protocols::opentrackio_lens::PrincipalPoint;
use crate::protocols::otp::{ADVERTISEMENTS, ADVERTISEMENTS_V6, MAX_NAME, OtpAddress, PORT};
use crate::publish::freed::{FreedSettings, Spare};
use crate::publish::opentrackio::OpenTrackIoSettings;
use crate::publish::osc::{AddressTemplate, OscMessageKind, OscSettings, OscValue, Quantity};
use crate::publish::otp::OtpSettings;
use crate::publish::psn::PsnSettings;
use crate::publish::{JsonSettings, Protocol, StreamSettings};

/// Default sensor width, millimetres: a 1/3-inch sensor, common in webcams. It only scales focal
/// lengths in messages; their ratio to the width is correct with any value.
const SENSOR_WIDTH_MM: f64 = 4.8;

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Freed,
    OpenTrackIo,
    Psn,
    Otp,
    Osc,
    Json,
}

/// Reads the protocol of an output whose section starts at `span`.
pub(super) fn protocol(section: &Section<'_>, output: &as_typed::Output, span: &Range<usize>) -> Result<Protocol, ConfigError> {
    let kinds = [
        ("freed", Kind::Freed),
        ("opentrackio", Kind::OpenTrackIo),
        ("psn", Kind::Psn),
        ("otp", Kind::Otp),
        ("osc", Kind::Osc),
        ("json", Kind::Json),
    ];
    let Some(typed) = &output.kind else {
        let hint = "kind = \"freed\", \"opentrackio\", \"psn\", \"otp\", \"osc\" or \"json\"";
        return Err(section.origin.missing(section.origin.section_at(section.name, span), "kind", hint));
    };
    let kind = section.word("kind", Some(typed), Kind::Json, &kinds, "freed, opentrackio, psn, otp, osc or json")?;
    refuse_others_keys(section, output, kind)?;
    Ok(match kind {
        Kind::Freed => Protocol::Freed(freed(section, output)?),
        Kind::OpenTrackIo => Protocol::OpenTrackIo(opentrackio(section, output)?),
        Kind::Psn => Protocol::Psn(psn(section, output)?),
        Kind::Otp => Protocol::Otp(otp(section, output)?),
        Kind::Osc => Protocol::Osc(osc(section, output)?),
        Kind::Json => Protocol::Json(json(section, output)?),
    })
}

/// A key, its place if it is there, the kinds that read it, and what to do elsewhere.
type Owned = (&'static str, Option<Range<usize>>, &'static [Kind], &'static str);

/// Refuses a key that this kind does not read: it would have no effect.
fn refuse_others_keys(section: &Section<'_>, o: &as_typed::Output, kind: Kind) -> Result<(), ConfigError> {
    fn at<T>(typed: &Option<Spanned<T>>) -> Option<Range<usize>> {
        typed.as_ref().map(Spanned::span)
    }
    use Kind::{Freed, Json, OpenTrackIo, Osc, Otp, Psn};
    let keys: [Owned; 21] = [
        ("sensor_width_mm", at(&o.sensor_width_mm), &[Freed, OpenTrackIo], "it belongs to freed and opentrackio; remove it"),
        ("camera_id", at(&o.camera_id), &[Freed], "it belongs to freed; remove it"),
        ("spare", at(&o.spare), &[Freed], "it belongs to freed; remove it"),
        ("zoom", at(&o.zoom), &[Freed], "it belongs to freed; remove it"),
        ("focus", at(&o.focus), &[Freed], "it belongs to freed; remove it"),
        ("rings", at(&o.rings), &[Freed, OpenTrackIo], "it belongs to freed and opentrackio; remove it"),
        ("encoding", at(&o.encoding), &[OpenTrackIo], "it belongs to opentrackio; remove it"),
        ("source_number", at(&o.source_number), &[OpenTrackIo], "it belongs to opentrackio; remove it"),
        ("principal_point", at(&o.principal_point), &[OpenTrackIo], "it belongs to opentrackio; remove it"),
        ("system", at(&o.system), &[Psn, Otp], "it belongs to psn and otp; remove it"),
        ("system_number", at(&o.system_number), &[Otp], "it belongs to otp; remove it"),
        ("group_number", at(&o.group_number), &[Otp], "it belongs to otp; remove it"),
        ("first_point", at(&o.first_point), &[Otp], "it belongs to otp; remove it"),
        ("priority", at(&o.priority), &[Otp], "it belongs to otp; remove it"),
        ("reference_point", at(&o.reference_point), &[Otp], "it belongs to otp; remove it"),
        ("listen", at(&o.listen), &[Otp], "it belongs to otp; remove it"),
        ("first_tracker", at(&o.first_tracker), &[Psn], "it belongs to psn; remove it"),
        ("prefix", at(&o.prefix), &[Osc], "it belongs to osc; remove it"),
        ("messages", at(&o.messages), &[Osc], "it belongs to osc; remove it"),
        ("tcp_listen", at(&o.tcp_listen), &[Json], "it belongs to json; remove it"),
        ("file", at(&o.file), &[Json], "it belongs to json; remove it"),
    ];
    let value = o.value.first().map(|v| ("value", v.span(), "it belongs to osc; remove it"));
    let foreign = keys.into_iter().filter(|(.., kinds, _)| !kinds.contains(&kind)).find_map(|(key, at, _, hint)| Some((key, at?, hint)));
    match foreign.or(value.filter(|_| kind != Osc)) {
        Some((key, span, hint)) => Err(section.refuse(key, &span, Problem::Combination(hint))),
        None => Ok(()),
    }
}

fn sensor_width(section: &Section<'_>, o: &as_typed::Output) -> Result<f64, ConfigError> {
    let wanted = "millimetres from 0.1 to 100";
    section.number("sensor_width_mm", o.sensor_width_mm.as_ref(), SENSOR_WIDTH_MM, |v| (0.1..=100.0).contains(&v), wanted)
}

fn freed(section: &Section<'_>, o: &as_typed::Output) -> Result<FreedSettings, ConfigError> {
    let spares = [("quality", Spare::Quality), ("frame", Spare::Frame), ("sony", Spare::Sony), ("zero", Spare::Zero)];
    let raw = "a whole number from 0 to 16777215 (24 bits)";
    let camera_id = section.count("camera_id", o.camera_id.as_ref(), 1, 0..=255, "a whole number from 0 to 255")?;
    let zoom = section.count("zoom", o.zoom.as_ref(), 0, 0..=0xFF_FFFF, raw)?;
    let focus = section.count("focus", o.focus.as_ref(), 0, 0..=0xFF_FFFF, raw)?;
    Ok(FreedSettings {
        // The ranges above fit the types.
        camera_id: camera_id as u8,
        spare: section.word("spare", o.spare.as_ref(), Spare::Quality, &spares, "quality, frame, sony or zero")?,
        zoom: o.zoom.as_ref().map(|_| zoom as u32),
        focus: focus as u32,
        sensor_width_mm: sensor_width(section, o)?,
    })
}

fn opentrackio(section: &Section<'_>, o: &as_typed::Output) -> Result<OpenTrackIoSettings, ConfigError> {
    let encodings = [("json", Encoding::Json), ("cbor", Encoding::Cbor)];
    let points = [("projection", PrincipalPoint::Projection), ("both", PrincipalPoint::Both)];
    // Unreal reads the principal point from a separate field.
    let is_unreal = o.receiver.as_ref().is_some_and(|receiver| receiver.get_ref().trim().eq_ignore_ascii_case("unreal"));
    let usual = if is_unreal { PrincipalPoint::Both } else { PrincipalPoint::Projection };
    let source = section.count("source_number", o.source_number.as_ref(), 1, 1..=200, "a whole number from 1 to 200")?;
    Ok(OpenTrackIoSettings {
        encoding: section.word("encoding", o.encoding.as_ref(), Encoding::Json, &encodings, "json or cbor")?,
        source_number: source as u8,
        sensor_width_mm: sensor_width(section, o)?,
        principal_point: section.word(
            "principal_point",
            o.principal_point.as_ref(),
            usual,
            &points,
            "projection (as the standard has it) or both (for Unreal)",
        )?,
    })
}

fn psn(section: &Section<'_>, o: &as_typed::Output) -> Result<PsnSettings, ConfigError> {
    let first = section.count("first_tracker", o.first_tracker.as_ref(), 1, 0..=65_000, "a whole number from 0 to 65000")?;
    Ok(PsnSettings { system: system_name(section, o)?, first_tracker: first as u16 })
}

fn system_name(section: &Section<'_>, o: &as_typed::Output) -> Result<String, ConfigError> {
    let system = o.system.as_ref().map(|s| section.text("system", s, "a name of the system, such as \"stagepose\"")).transpose()?;
    Ok(system.unwrap_or_else(|| "stagepose".to_owned()))
}

fn otp(section: &Section<'_>, o: &as_typed::Output) -> Result<OtpSettings, ConfigError> {
    let component = system_name(section, o)?;
    if let Some(typed) = o.system.as_ref().filter(|_| component.len() > MAX_NAME) {
        return Err(section.unusable("system", typed, "a name of at most 32 bytes, such as \"stagepose\""));
    }
    let system = section.count("system_number", o.system_number.as_ref(), 1, 1..=200, "a whole number from 1 to 200")?;
    let group = section.count("group_number", o.group_number.as_ref(), 1, 1..=60_000, "a whole number from 1 to 60000")?;
    let first = section.count("first_point", o.first_point.as_ref(), 1, 1..=3_999_000_000, "a whole number from 1 to 3999000000")?;
    let priority = section.count("priority", o.priority.as_ref(), 100, 0..=200, "a whole number from 0 to 200")?;
    let has_v6 = o.to.iter().flat_map(as_typed::Texts::all).any(|to| to.get_ref().parse().is_ok_and(|to: SocketAddr| to.is_ipv6()));
    let usual: SocketAddr = if has_v6 { (ADVERTISEMENTS_V6, PORT).into() } else { (ADVERTISEMENTS, PORT).into() };
    Ok(OtpSettings {
        component,
        // The ranges above fit the types.
        system: system as u8,
        group: group as u16,
        first_point: first as u32,
        priority: priority as u8,
        reference: o.reference_point.as_ref().map(|typed| reference_point(section, typed)).transpose()?,
        listen: o.listen.as_ref().map_or(Ok(usual), |typed| address(section, "listen", typed))?,
    })
}

fn reference_point(section: &Section<'_>, typed: &Spanned<as_typed::Exactly<as_typed::Count, 3>>) -> Result<OtpAddress, ConfigError> {
    let [system, group, point] = typed.get_ref().0.map(|as_typed::Count(n)| n);
    if (1..=200).contains(&system) && (1..=60_000).contains(&group) && (1..=4_000_000_000).contains(&point) {
        return Ok(OtpAddress { system: system as u8, group: group as u16, point: point as u32 });
    }
    let wanted = "system (1 to 200), group (1 to 60000) and point (1 to 4000000000), such as [1, 1, 5]";
    let value = format!("[{system}, {group}, {point}]");
    Err(section.refuse("reference_point", &typed.span(), Problem::Range { value, wanted }))
}

fn osc(section: &Section<'_>, o: &as_typed::Output) -> Result<OscSettings, ConfigError> {
    let prefix = match &o.prefix {
        None => "/stagepose".to_owned(),
        Some(typed) => match AddressTemplate::parse(typed.get_ref()) {
            Ok(_) if !typed.get_ref().contains('{') && !typed.get_ref().ends_with('/') => typed.get_ref().clone(),
            _ => {
                return Err(section.unusable("prefix", typed, "the first part of an OSC address, such as \"/stagepose\""));
            }
        },
    };
    let kinds = [("pose", OscMessageKind::Pose), ("quat", OscMessageKind::Quaternion), ("status", OscMessageKind::Status)];
    let messages = match &o.messages {
        None => kinds.iter().map(|(_, kind)| *kind).collect(),
        Some(list) => {
            let word =
                |typed: &Spanned<String>| section.word("messages", Some(typed), OscMessageKind::Pose, &kinds, "pose, quat or status");
            as_typed::Texts::all(list).iter().map(word).collect::<Result<_, _>>()?
        }
    };
    let values = o.value.iter().map(|value| osc_value(section, value)).collect::<Result<_, _>>()?;
    Ok(OscSettings { prefix, messages, values })
}

fn osc_value(section: &Section<'_>, typed: &Spanned<as_typed::OutputValue>) -> Result<OscValue, ConfigError> {
    let section = Section { origin: section.origin, name: "[[output.value]]" };
    let (here, value) = (|| section.origin.section_at(section.name, &typed.span()), typed.get_ref());
    let Some(address) = &value.address else {
        return Err(section.origin.missing(here(), "address", "the receiver's OSC address, such as address = \"/cue/2/translationX\""));
    };
    if value.quantity.is_none() {
        return Err(section.origin.missing(here(), "quantity", "quantity = \"x\", \"y\", \"z\", \"pan\", \"tilt\" or \"roll\""));
    }
    let any = |v: f64| v.abs() <= 1e9;
    let clamp = match &value.clamp {
        None => None,
        Some(typed) => match typed.get_ref().values() {
            [least, greatest] if least < greatest => Some([least, greatest]),
            other => {
                let wanted = "a minimum and a maximum, such as [0.0, 1.0]";
                return Err(section.refuse("clamp", &typed.span(), Problem::Range { value: format!("{other:?}"), wanted }));
            }
        },
    };
    let template = AddressTemplate::parse(address.get_ref());
    Ok(OscValue {
        address: template.map_err(|e| section.refuse("address", &address.span(), Problem::Template(e)))?,
        quantity: section.word("quantity", value.quantity.as_ref(), Quantity::X, &Quantity::WORDS, "x, y, z, pan, tilt or roll")?,
        scale: section.number("factor", value.factor.as_ref(), 1.0, any, "a number from -1e9 to 1e9")?,
        offset: section.number("plus", value.plus.as_ref(), 0.0, any, "a number from -1e9 to 1e9")?,
        clamp,
        every: section.count("every", value.every.as_ref(), 1, 1..=1000, "a whole number from 1 to 1000")? as u32,
    })
}

fn json(section: &Section<'_>, o: &as_typed::Output) -> Result<JsonSettings, ConfigError> {
    let tcp_listen = o.tcp_listen.as_ref().map(|typed| address(section, "tcp_listen", typed)).transpose()?;
    let file = o.file.as_ref().map(|typed| {
        let name = section.text("file", typed, "a file name, or \"-\" for standard output")?;
        Ok::<_, ConfigError>(if name == "-" { name.into() } else { section.origin.beside(&name) })
    });
    Ok(JsonSettings { stream: StreamSettings { tcp_listen, file: file.transpose()? } })
}

/// Parses an address of this machine to listen on.
pub(super) fn address(section: &Section<'_>, key: &str, typed: &Spanned<String>) -> Result<SocketAddr, ConfigError> {
    let wanted = "an IP address and a port from 1 to 65535, such as \"127.0.0.1:9000\"";
    let address = typed.get_ref().parse::<SocketAddr>().ok().filter(|a| a.port() != 0);
    address.ok_or_else(|| section.unusable(key, typed, wanted))
}
