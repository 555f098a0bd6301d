//! The outputs: every `[[output]]` with its addresses, bodies and rates checked, and `[safety]`.

use std::net::SocketAddr;
use std::time::Duration;

use toml::Spanned;

use super::as_typed;
use super::origin::Origin;
use super::rotation::Turned;
use super::typed_values::{Number, Texts};
use super::values::Section;
use super::{ConfigError, Problem};
use crate::protocols::otp;
use crate::publish::{
    Axes, BlendRates, BodyChoice, FixedRate, Interface, MountSettings, OnLoss, OutputSettings, Placement, Protocol, Rate, SafetySettings,
    TickPhase, UdpSettings, needs_interface,
};

/// The section's name in messages.
pub(super) const OUTPUT: &str = "[[output]]";
/// Default lag of ticks, seconds: two frames at 30 per second plus the tracker's time, so that
/// poses are interpolated. Raised, outputs lag more; lowered, ticks are predictions more often.
const USUAL_DELAY_S: f64 = 0.08;

/// Reads the outputs of one config.
pub(super) struct OutputReader<'a> {
    pub origin: &'a Origin<'a>,
    /// The objects' names, in their order.
    pub objects: Vec<String>,
    /// The mount, if there is one.
    pub mount: Option<&'a MountSettings>,
    /// Whether there is an `[other_tracker]`.
    pub has_other_tracker: bool,
}

impl OutputReader<'_> {
    pub fn outputs(&self, typed: &[Spanned<as_typed::Output>]) -> Result<Vec<OutputSettings>, ConfigError> {
        let mut outputs: Vec<OutputSettings> = Vec::new();
        for typed in typed {
            let output = self.output(typed)?;
            if let Some(name) = typed.get_ref().name.as_ref().filter(|_| outputs.iter().any(|o| o.name == output.name)) {
                let value = format!("`{}`, which another output has,", output.name);
                let problem = Problem::Range { value, wanted: "each output a name of its own" };
                return Err(self.section().refuse("name", &name.span(), problem));
            }
            outputs.push(output);
        }
        Ok(outputs)
    }

    /// Whether `rings` asks for the other tracker's zoom and focus.
    fn passes_rings(&self, section: &Section<'_>, output: &as_typed::Output) -> Result<bool, ConfigError> {
        let words = [("own", false), ("other_tracker", true)];
        let passes = section.word("rings", output.rings.as_ref(), false, &words, "\"other_tracker\", or \"own\" for `zoom` and `focus`")?;
        match &output.rings {
            Some(typed) if passes && !self.has_other_tracker => {
                Err(section.conflict("rings", typed, "there is no [other_tracker] whose zoom and focus could be sent; add it"))
            }
            _ => Ok(passes),
        }
    }

    fn section(&self) -> Section<'_> {
        Section { origin: self.origin, name: OUTPUT }
    }

    fn output(&self, typed: &Spanned<as_typed::Output>) -> Result<OutputSettings, ConfigError> {
        let (section, span, output) = (self.section(), typed.span(), typed.get_ref());
        let protocol = super::protocols::protocol(&section, output, &span)?;
        let line = self.origin.line(&span);
        let name = match &output.name {
            Some(name) => section.text("name", name, "a name for messages, such as \"studio\"")?,
            None => format!("{}-{line}", protocol.word()),
        };
        let udp = self.udp(&section, output, &protocol, &span)?;
        self.has_somewhere_to_go(&protocol, &udp, &span)?;
        let on_loss = on_loss(&section, output, &protocol)?;
        let placement = placement(&section, output, &protocol)?;
        let bodies = self.bodies(&section, output, &protocol)?;
        // A receiver that draws on the filming camera's picture needs everything as of the time
        // that picture was taken.
        let mount_delay = self.mount.filter(|_| bodies.contains(&BodyChoice::Mount)).map_or(Duration::ZERO, |mount| mount.delay);
        Ok(OutputSettings {
            name,
            enabled: output.enabled.as_ref().is_none_or(|e| *e.get_ref()),
            bodies,
            protocol,
            udp,
            rate: rate(&section, output, mount_delay)?,
            delay: mount_delay,
            on_loss,
            placement,
            passes_rings: self.passes_rings(&section, output)?,
            is_guarded: output.safety.as_ref().is_none_or(|e| *e.get_ref()),
        })
    }

    fn has_somewhere_to_go(&self, protocol: &Protocol, udp: &UdpSettings, span: &std::ops::Range<usize>) -> Result<(), ConfigError> {
        let has_stream = match protocol {
            Protocol::Json(json) => json.stream.tcp_listen.is_some() || json.stream.file.is_some(),
            _ => false,
        };
        if has_stream || !udp.to.is_empty() {
            return Ok(());
        }
        let hint = "the receiver's address and port, such as to = [\"192.168.1.20:40000\"] (json: or `tcp_listen`, or `file`)";
        Err(self.origin.missing(self.origin.section_at(OUTPUT, span), "to", hint))
    }

    fn udp(
        &self,
        section: &Section<'_>,
        output: &as_typed::Output,
        protocol: &Protocol,
        span: &std::ops::Range<usize>,
    ) -> Result<UdpSettings, ConfigError> {
        let mut to = Vec::new();
        for typed in output.to.iter().flat_map(Texts::all) {
            let wanted =
                "an IPv4 address and a port from 1 to 65535, such as \"192.168.1.20:40000\", or an IPv6 one, such as \"[fd00::20]:40000\"";
            let address = typed.get_ref().parse::<SocketAddr>().ok().filter(|a| a.port() != 0 && !a.ip().is_unspecified());
            to.push(address.ok_or_else(|| section.unusable("to", &typed, wanted))?);
        }
        let interface = self.interface(section, output, &to)?;
        if let Protocol::Otp(otp) = protocol {
            if to.is_empty() {
                to.push(SocketAddr::from((otp::transforms(otp.system), otp::PORT)));
            }
            if interface.is_none() && to.iter().chain([&otp.listen]).any(needs_interface) {
                let hint = "this machine's IPv4 address on the network of OTP's multicasts, such as interface = \"192.168.1.10\"";
                return Err(self.origin.missing(self.origin.section_at(OUTPUT, span), "interface", hint));
            }
        }
        let needs = |v6: bool| to.iter().any(|a| a.is_ipv6() == v6 && needs_interface(a));
        let problem = match &interface {
            None | Some(Interface::Name(_)) if needs(false) => {
                "a multicast address needs `interface`, this machine's IPv4 address on that network, such as interface = \"192.168.1.10\""
            }
            None | Some(Interface::Address(_)) if needs(true) => {
                "a multicast or link-local IPv6 address needs `interface`, this machine's name for that network, such as interface = \"eth0\""
            }
            _ => "",
        };
        if let (Some(typed), false) = (&output.to, problem.is_empty()) {
            return Err(section.conflict("to", typed, problem));
        }
        let ttl = section.count("ttl", output.ttl.as_ref(), 1, 1..=255, "a number of routers from 1 (this network only) to 255")?;
        Ok(UdpSettings { to, interface, ttl: u8::try_from(ttl).unwrap_or(u8::MAX) })
    }

    fn interface(&self, section: &Section<'_>, output: &as_typed::Output, to: &[SocketAddr]) -> Result<Option<Interface>, ConfigError> {
        let Some(typed) = &output.interface else { return Ok(None) };
        // Only IPv6 uses interface names; for IPv4 such a text is a mistyped address.
        let has_v6 = to.iter().any(SocketAddr::is_ipv6);
        let interface = Interface::parse(typed.get_ref()).filter(|i| has_v6 || matches!(i, Interface::Address(_)));
        let wanted = if has_v6 {
            "this machine's name for that network, such as \"eth0\" (IPv4: its address there)"
        } else {
            "this machine's IPv4 address on that network, such as \"192.168.1.10\""
        };
        interface.map(Some).ok_or_else(|| section.unusable("interface", typed, wanted))
    }

    fn bodies(&self, section: &Section<'_>, output: &as_typed::Output, protocol: &Protocol) -> Result<Vec<BodyChoice>, ConfigError> {
        let takes_one = matches!(protocol, Protocol::Freed(_) | Protocol::OpenTrackIo(_));
        let Some(typed) = &output.bodies else {
            // A protocol with one camera is used to draw on its picture: the filming camera's, if
            // there is one. A protocol with all bodies gets it last, so that the others keep their
            // numbers.
            if takes_one {
                return Ok(vec![self.mount.map_or(BodyChoice::Camera, |_| BodyChoice::Mount)]);
            }
            let objects = (0..self.objects.len()).map(BodyChoice::Object);
            return Ok(std::iter::once(BodyChoice::Camera).chain(objects).chain(self.mount.map(|_| BodyChoice::Mount)).collect());
        };
        let bodies = Texts::all(typed);
        if bodies.is_empty() || takes_one && bodies.len() > 1 {
            let problem = "give one body to freed and opentrackio, one or more to the others; make another [[output]] for the next";
            return Err(section.conflict("bodies", typed, problem));
        }
        bodies.iter().map(|body| self.body(section, body)).collect()
    }

    fn body(&self, section: &Section<'_>, typed: &Spanned<String>) -> Result<BodyChoice, ConfigError> {
        let found = self.objects.iter().position(|name| name == typed.get_ref());
        if found.is_none() && typed.get_ref().eq_ignore_ascii_case("camera") {
            return Ok(BodyChoice::Camera);
        }
        if found.is_none() && self.mount.is_some_and(|mount| mount.name == *typed.get_ref()) {
            return Ok(BodyChoice::Mount);
        }
        let wanted = "\"camera\" or the `name` of an [[object]] or of [mount]";
        found.map(BodyChoice::Object).ok_or_else(|| section.unusable("bodies", typed, wanted))
    }
}

fn on_loss(section: &Section<'_>, output: &as_typed::Output, protocol: &Protocol) -> Result<OnLoss, ConfigError> {
    let words = [("stop", OnLoss::Stop), ("hold", OnLoss::Hold), ("flag", OnLoss::Flag)];
    let chosen = section.word("on_loss", output.on_loss.as_ref(), OnLoss::Stop, &words, "stop, hold or flag")?;
    let has_no_flag = match protocol {
        Protocol::Otp(_) => true,
        Protocol::Freed(freed) => freed.spare != crate::publish::freed::Spare::Quality,
        Protocol::Osc(osc) => !osc.messages.contains(&crate::publish::osc::OscMessageKind::Status),
        _ => false,
    };
    match &output.on_loss {
        Some(typed) if chosen == OnLoss::Flag && has_no_flag => {
            let problem = "there is nothing to flag a loss with; add spare = \"quality\" (freed) or the message \"status\" (osc), or use stop or hold";
            Err(section.conflict("on_loss", typed, problem))
        }
        _ => Ok(chosen),
    }
}

/// Reads the rate. Ticks lag by `delay_s`, by default the mount's delay, or [`USUAL_DELAY_S`] if
/// there is none.
fn rate(section: &Section<'_>, output: &as_typed::Output, mount_delay: Duration) -> Result<Rate, ConfigError> {
    let every = section.count("rate_divider", output.rate_divider.as_ref(), 1, 1..=1000, "a whole number from 1 to 1000")?;
    let Some(typed) = &output.rate_hz else {
        if let Some(delay) = &output.delay_s {
            return Err(section.conflict("delay_s", delay, "it belongs to `rate_hz`, which is not there; add one or remove it"));
        }
        if let Some(ticks) = &output.ticks {
            return Err(section.conflict("ticks", ticks, "it belongs to `rate_hz`, which is not there; add one or remove it"));
        }
        return Ok(Rate::Every(u32::try_from(every).unwrap_or(1)));
    };
    if let Some(divider) = &output.rate_divider {
        let problem = "an output has either `rate_divider` or `rate_hz`, this one has both; remove one";
        return Err(section.conflict("rate_divider", divider, problem));
    }
    let found = FixedRate::KNOWN.into_iter().find(|(hz, _)| *hz == typed.get_ref().0);
    let problem = || Problem::Range { value: typed.get_ref().0.to_string(), wanted: "25, 29.97, 30, 50, 59.94 or 60" };
    let (_, rate) = found.ok_or_else(|| section.refuse("rate_hz", &typed.span(), problem()))?;
    let default_s = if mount_delay.is_zero() { USUAL_DELAY_S } else { mount_delay.as_secs_f64() };
    let delay = section.number("delay_s", output.delay_s.as_ref(), default_s, |v| (0.0..=0.5).contains(&v), "seconds from 0 to 0.5")?;
    let phases = [("free-running", TickPhase::FreeRunning), ("clock", TickPhase::Clock)];
    let phase = section.word("ticks", output.ticks.as_ref(), TickPhase::FreeRunning, &phases, "free-running or clock")?;
    Ok(Rate::Fixed { rate, delay: Duration::from_secs_f64(delay), phase })
}

/// Returns the named receiver's axes. FreeD, OpenTrackIO, PSN and OTP define their own axes, which
/// every receiver knows, so the name has no effect there. OSC sends bare numbers.
fn receiver_axes(section: &Section<'_>, output: &as_typed::Output, protocol: &Protocol) -> Result<Axes, ConfigError> {
    let receivers =
        [("unreal", Axes::UNREAL), ("disguise", Axes::DISGUISE), ("touchdesigner", Axes::TOUCHDESIGNER), ("lighting", Axes::STAGE)];
    let wanted = "unreal, disguise, touchdesigner or lighting";
    let axes = section.word("receiver", output.receiver.as_ref(), Axes::STAGE, &receivers, wanted)?;
    match (protocol, &output.receiver) {
        (Protocol::Osc(_), _) => Ok(axes),
        (Protocol::Json(_), Some(typed)) => {
            let problem = "json sends the record's own axes, which the receiver converts; remove it, or send osc";
            Err(section.conflict("receiver", typed, problem))
        }
        _ => Ok(Axes::STAGE),
    }
}

fn placement(section: &Section<'_>, output: &as_typed::Output, protocol: &Protocol) -> Result<Placement, ConfigError> {
    let Axes { order, position_signs, angle_signs, scale } = receiver_axes(section, output, protocol)?;
    let mut placement = Placement {
        order,
        position_signs,
        angle_signs,
        offset_m: section.position("offset_m", output.offset_m.as_ref())?,
        rotation: Turned::Output.typed(section, output.rotation_xyzw.as_ref(), output.rotation_deg.as_ref())?,
        scale: section.number("scale", output.scale.as_ref(), scale, |v| v > 0.0 && v <= 1e6, "a factor above 0, at most 1000000")?,
    };
    let axes = [("x", 0), ("y", 1), ("z", 2), ("pan", 3), ("tilt", 4), ("roll", 5)];
    for typed in output.invert.iter().flat_map(Texts::all) {
        match section.word("invert", Some(&typed), 0, &axes, "x, y, z, pan, tilt or roll")? {
            axis @ 0..3 => placement.position_signs[axis] = -position_signs[axis],
            axis => placement.angle_signs[axis - 3] = -angle_signs[axis - 3],
        }
    }
    Ok(placement)
}

/// Reads `[safety]`.
pub(super) fn safety(origin: &Origin<'_>, typed: Option<&as_typed::Safety>) -> Result<SafetySettings, ConfigError> {
    let default = SafetySettings::usual();
    let Some(typed) = typed else { return Ok(default) };
    let section = Section { origin, name: "[safety]" };
    let limit = |key: &'static str, typed: &Option<Spanned<Number>>, most: f64, wanted: &'static str| {
        let value = section.number(key, typed.as_ref(), 0.0, |v| v > 0.0 && v <= most, wanted)?;
        Ok::<_, ConfigError>(typed.as_ref().map(|_| value))
    };
    let (speed, rotation) = ("metres per second, above 0, at most 100", "degrees per second, above 0, at most 10000");
    let blend_speed = limit("blend_speed_m_s", &typed.blend_speed_m_s, 100.0, speed)?;
    let blend_turn = limit("blend_turn_deg_s", &typed.blend_turn_deg_s, 10_000.0, rotation)?;
    let blend = match (blend_speed, blend_turn) {
        (Some(speed_m_s), Some(rotation)) => Some(BlendRates { speed_m_s, angular_speed_rad_s: rotation.to_radians() }),
        (None, None) => None,
        _ => {
            let alone = typed.blend_speed_m_s.as_ref().or(typed.blend_turn_deg_s.as_ref()).map_or(0..0, Spanned::span);
            let problem = Problem::Combination("a return after a loss needs both `blend_speed_m_s` and `blend_turn_deg_s`; add the other");
            return Err(section.refuse(if blend_speed.is_some() { "blend_speed_m_s" } else { "blend_turn_deg_s" }, &alone, problem));
        }
    };
    let stale =
        section.number("stale_after_s", typed.stale_after_s.as_ref(), 0.5, |v| (0.02..=60.0).contains(&v), "seconds from 0.02 to 60")?;
    Ok(SafetySettings {
        max_speed_m_s: limit("max_speed_m_s", &typed.max_speed_m_s, 100.0, speed)?.or(default.max_speed_m_s),
        max_angular_speed_rad_s: limit("max_turn_deg_s", &typed.max_turn_deg_s, 10_000.0, rotation)?
            .map(f64::to_radians)
            .or(default.max_angular_speed_rad_s),
        permitted_box_m: permitted_box(&section, typed)?,
        blend,
        stale_after: Duration::from_secs_f64(stale),
    })
}

fn permitted_box(section: &Section<'_>, typed: &as_typed::Safety) -> Result<Option<[[f64; 3]; 2]>, ConfigError> {
    let Some(typed) = &typed.permitted_box_m else { return Ok(None) };
    let [least, greatest] = typed.get_ref().0.map(|corner| corner.values());
    // A NaN fails the comparison too.
    if least.iter().zip(&greatest).all(|(l, g)| l < g) {
        return Ok(Some([least, greatest]));
    }
    let wanted = "two corners [[x, y, z], [x, y, z]] in metres, the first less than the second in all three";
    Err(section.refuse("permitted_box_m", &typed.span(), Problem::Range { value: format!("{least:?}, {greatest:?}"), wanted }))
}
