//! Outputs, safety, filter and HTTP: what is read, and the message for every wrong value.

use std::net::{TcpListener, UdpSocket};
use std::path::Path;

use super::settings::SendingSettings;
use super::*;
use crate::pose::{FilterKind, FilterSettings};
use crate::publish::{BodyChoice, Interface, OnLoss, Protocol, Rate, SafetySettings, TickPhase};

fn load(text: &str) -> Result<SendingSettings, ConfigError> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("stage.toml");
    std::fs::write(&file, text).unwrap();
    Settings::load_outputs(&file)
}

fn message(text: &str) -> String {
    let said = load(text).map(|_| ()).expect_err(text).to_string();
    said.split_once("stage.toml: ").unwrap().1.to_owned()
}

const FREED: &str = "[[output]]\nkind = \"freed\"\nto = [\"127.0.0.1:40000\"]\n";
const OSC: &str = "[[output]]\nkind = \"osc\"\nto = [\"127.0.0.1:53000\"]\n";
const JSON: &str = "[[output]]\nkind = \"json\"\nfile = \"-\"\n";

#[test]
fn defaults_match_the_documentation() {
    let settings = load(&format!("{FREED}{OSC}{JSON}[[object]]\nname = \"cart\"")).unwrap();
    let [freed, osc, json] = &settings.outputs[..] else { panic!("three outputs") };
    assert_eq!((freed.name.as_str(), osc.name.as_str(), json.name.as_str()), ("freed-1", "osc-4", "json-7"));
    assert!(freed.enabled && freed.is_guarded && freed.placement.is_identity());
    assert_eq!((freed.on_loss, freed.rate, freed.udp.ttl), (OnLoss::Stop, Rate::Every(1), 1));
    assert_eq!(freed.bodies, [BodyChoice::Camera]);
    assert_eq!(osc.bodies, [BodyChoice::Camera, BodyChoice::Object(0)]);
    assert_eq!((settings.safety, settings.http), (SafetySettings::usual(), None));
    assert_eq!(load("[http]\n").unwrap().http, Some(crate::config::HttpSettings::default()));
    assert_eq!(load("[http]\nenabled = false").unwrap().http, None);
}

#[test]
fn every_key_reaches_the_settings() {
    let text = "[[object]]\nname = \"cart\"\n[[output]]\nkind = \"psn\"\nname = \"desk\"\nenabled = false\nto = [\"236.10.10.10:56565\"]\n\
        interface = \"127.0.0.1\"\nttl = 4\nbodies = [\"cart\", \"camera\"]\nrate_hz = 59.94\ndelay_s = 0.1\non_loss = \"flag\"\n\
        offset_m = [1, 2, 3]\nrotation_xyzw = [0, 0, 1, 0]\ninvert = [\"x\", \"tilt\"]\nscale = 100\nsafety = false\nfirst_tracker = 12\nsystem = \"s\"\n\
        [safety]\nmax_speed_m_s = 3\nmax_turn_deg_s = 180\npermitted_box_m = [[-1, -2, -3], [1, 2, 3]]\nblend_speed_m_s = 0.5\n\
        blend_turn_deg_s = 90\nstale_after_s = 0.2\n[http]\nlisten = \"0.0.0.0:80\"\n\
        hosts = [\"Stage.example.org\", \"192.0.2.7\", \"[fd00::7]\"]\n";
    let settings = load(text).unwrap();
    let output = &settings.outputs[0];
    assert_eq!((output.name.as_str(), output.enabled, output.is_guarded, output.on_loss), ("desk", false, false, OnLoss::Flag));
    assert_eq!(output.bodies, [BodyChoice::Object(0), BodyChoice::Camera]);
    assert_eq!((output.udp.ttl, output.udp.interface.clone()), (4, Some(Interface::Address(std::net::Ipv4Addr::LOCALHOST))));
    assert!(
        matches!(output.rate, Rate::Fixed { rate, delay, phase: TickPhase::FreeRunning } if rate.ticks == 60_000 && delay.as_millis() == 100)
    );
    let placement = output.placement;
    assert_eq!((placement.scale, placement.position_signs, placement.angle_signs), (100.0, [-1.0, 1.0, 1.0], [1.0, -1.0, 1.0]));
    assert!(matches!(&output.protocol, Protocol::Psn(psn) if psn.first_tracker == 12 && psn.system == "s"));
    assert_eq!(settings.safety.permitted_box_m, Some([[-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]]));
    assert!((settings.safety.blend.unwrap().angular_speed_rad_s - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    let http = settings.http.unwrap();
    assert_eq!(http.listen.to_string(), "0.0.0.0:80");
    assert_eq!(http.hosts.iter().map(ToString::to_string).collect::<Vec<_>>(), ["stage.example.org", "192.0.2.7", "fd00::7"]);
}

#[test]
fn single_values_need_no_brackets_and_words_ignore_case() {
    let text = "[[output]]\nkind = \"OSC\"\nto = \"127.0.0.1:53000\"\non_loss = \"Flag\"\nbodies = \"Camera\"\ninvert = \"Tilt\"\nmessages = \"STATUS\"\n\
        rotation_deg = [180, 0, 0]\n[[output]]\nkind = \"FreeD\"\nto = [\"127.0.0.1:40000\", \"127.0.0.1:40001\"]\nspare = \"Sony\"\n\
        [[output]]\nkind = \"OpenTrackIO\"\nencoding = \"CBOR\"\nto = \"127.0.0.1:55555\"\n";
    let settings = load(text).unwrap();
    let [osc, freed, open] = &settings.outputs[..] else { panic!("three outputs") };
    assert_eq!((osc.udp.to.len(), osc.on_loss, osc.placement.angle_signs), (1, OnLoss::Flag, [1.0, -1.0, 1.0]));
    assert_eq!(osc.bodies, [BodyChoice::Camera]);
    let rotated = osc.placement.rotation * nalgebra::Vector3::x();
    assert!((rotated + nalgebra::Vector3::x()).norm() < 1e-12);
    assert!(matches!(&osc.protocol, Protocol::Osc(osc) if osc.messages.len() == 1));
    assert_eq!((freed.udp.to.len(), freed.protocol.word(), open.protocol.word()), (2, "freed", "opentrackio"));
    // An object of that name takes precedence over the camera.
    let named = load("[[object]]\nname = \"Camera\"\n[[output]]\nkind = \"psn\"\nto = \"127.0.0.1:1\"\nbodies = \"Camera\"\n").unwrap();
    assert_eq!(named.outputs[0].bodies, [BodyChoice::Object(0)]);
}

#[test]
fn every_wrong_value_is_named_with_its_line() {
    let value = |more: &str| format!("{OSC}[[output.value]]\naddress = \"/a\"\nquantity = \"x\"\n{more}");
    let cases = [
        ("[[output]]\nto = [\"127.0.0.1:1\"]".to_owned(), "[[output]], line 1, has no `kind`; add kind = \"freed\""),
        (
            FREED.replace("freed", "vrpn"),
            "`kind` in [[output]], line 2: `vrpn` cannot be used; give freed, opentrackio, psn, otp, osc or json",
        ),
        (FREED.replace("to = [\"127.0.0.1:40000\"]", ""), "[[output]], line 1, has no `to`; add the receiver's address and port"),
        (FREED.replace("127.0.0.1", "desk.local"), "`to` in [[output]], line 3: `desk.local:40000` cannot be used; give an IPv4 address"),
        (FREED.replace("127.0.0.1", "192.168.1.300"), "`to` in [[output]], line 3: `192.168.1.300:40000` cannot be used"),
        (FREED.replace(":40000", ""), "`to` in [[output]], line 3: `127.0.0.1` cannot be used; give an IPv4 address and a port"),
        (FREED.replace("127.0.0.1", "239.1.2.3"), "`to` in [[output]], line 3: a multicast address needs `interface`"),
        (FREED.replace("127.0.0.1", "[ff15::7]"), "`to` in [[output]], line 3: a multicast or link-local IPv6 address needs `interface`"),
        (
            FREED.replace("127.0.0.1", "fd00::7"),
            "`to` in [[output]], line 3: `fd00::7:40000` cannot be used; give an IPv4 address and a port",
        ),
        (format!("{FREED}rate_hz = 25\nrate_divider = 2"), "`rate_divider` in [[output]], line 5: an output has either"),
        (
            FREED.replace("\"freed\"", "\"fred\""),
            "`kind` in [[output]], line 2: `fred` cannot be used; give freed, opentrackio, psn, otp, osc or json; did you mean `freed`?",
        ),
        (
            FREED.replace("[\"127.0.0.1:40000\"]", "\"127.0.0.1\""),
            "`to` in [[output]], line 3: `127.0.0.1` cannot be used; give an IPv4 address and a port",
        ),
        (
            FREED.replace("[\"127.0.0.1:40000\"]", "40000"),
            "`to` in [[output]], line 3: invalid type: integer `40000`, expected a text in quotes, or several in an array",
        ),
        (FREED.replace("[\"127.0.0.1:40000\"]", "[40000]"), "`to` in [[output]], line 3: invalid type: integer `40000`, expected a string"),
        (
            format!("{FREED}rotation_deg = [0, 0, 0]\nrotation_xyzw = [0, 0, 0, 1]"),
            "`rotation_deg` in [[output]], line 4: an output has either `rotation_xyzw` or `rotation_deg`, this one has both; remove one",
        ),
        (format!("{FREED}spare = \"frame\"\non_loss = \"flag\""), "`on_loss` in [[output]], line 5: there is nothing to flag a loss with"),
        (format!("{FREED}encoder = 1"), "unknown key `encoder` in [[output]], line 4; did you mean `encoding`?"),
        (format!("{FREED}name = \"a\"\n{OSC}name = \"a\""), "`name` in [[output]], line 8: `a`, which another output has,"),
        (format!("{OSC}[[output.value]]\nquantity = \"x\""), "[[output.value]], line 4, has no `address`"),
        (value("clamp = [1, 0]"), "`clamp` in [[output.value]], line 7: [1.0, 0.0] cannot be used"),
        (value("every = 0"), "`every` in [[output.value]], line 7: 0 cannot be used"),
        (value("").replace("\"x\"", "\"yaw\""), "`quantity` in [[output.value]], line 6: `yaw` cannot be used"),
        (value("").replace("/a", "/a/{axis}"), "`address` in [[output.value]], line 5: the template's field {axis} is unknown; use {body}"),
        ("[safety]\nmax_speed_m_s = 0".to_owned(), "`max_speed_m_s` in [safety], line 2: 0 cannot be used"),
        ("[safety]\nblend_speed_m_s = 1".to_owned(), "`blend_speed_m_s` in [safety], line 2: a return after a loss needs both"),
        ("[safety]\npermitted_box_m = [[0, 0, 0], [1, 1, 0]]".to_owned(), "`permitted_box_m` in [safety], line 2: [0.0, 0.0, 0.0]"),
        ("[safety]\nstale_after_s = nan".to_owned(), "`stale_after_s` in [safety], line 2: NaN cannot be used"),
        (
            "[http]\nhosts = [\"a\",\n\"b:80\"]".to_owned(),
            "`hosts` in [http], line 3: `b:80` cannot be used; give a host name or an IP address",
        ),
        ("[http]\nhosts = [\"*\"]".to_owned(), "`hosts` in [http], line 2: `*` cannot be used; give a host name"),
        ("[http]\nlisten = \"8090\"".to_owned(), "`listen` in [http], line 2: `8090` cannot be used; give an IP address and a port"),
    ];
    for (text, wanted) in cases {
        let said = message(&text);
        assert!(said.starts_with(wanted), "{text}\n{said}");
    }
}

#[test]
fn every_wrong_key_of_an_output_is_named_with_its_line() {
    let cases = [
        (FREED, "interface = \"eth0\"", "`eth0` cannot be used; give this machine's IPv4"),
        (FREED, "ttl = 0", "0 cannot be used"),
        (FREED, "rate_divider = 0", "0 cannot be used; give a whole number from 1"),
        (FREED, "rate_hz = 0", "0 cannot be used; give 25, 29.97, 30, 50, 59.94 or 60"),
        (FREED, "delay_s = 0.1", "it belongs to `rate_hz`"),
        (FREED, "bodies = [\"cart\"]", "`cart` cannot be used; give \"camera\" or the `name`"),
        (FREED, "bodies = []", "give one body to freed"),
        (FREED, "on_loss = \"guess\"", "`guess` cannot be used; give stop, hold or flag"),
        (FREED, "on_loss = \"holt\"", "`holt` cannot be used; give stop, hold or flag; did you mean `hold`?"),
        (FREED, "rotation_deg = [0, 0, 400]", "[0.0, 0.0, 400.0] cannot be used; give [turn, tilt, roll]"),
        (FREED, "camera_id = 256", "256 cannot be used"),
        (FREED, "invert = [\"w\"]", "`w` cannot be used; give x, y, z, pan, tilt or roll"),
        (FREED, "scale = 0", "0 cannot be used"),
        (FREED, "prefix = \"/a\"", "it belongs to osc; remove it"),
        (OSC, "prefix = \"a b\"", "`a b` cannot be used; give the first part of an OSC address"),
        (OSC, "messages = [\"euler\"]", "`euler` cannot be used; give pose, quat or status"),
        (JSON, "tcp_listen = \"localhost:9\"", "`localhost:9` cannot be used; give an IP"),
    ];
    for (output, added, wanted) in cases {
        let key = added.split(' ').next().unwrap();
        let said = message(&format!("{output}{added}"));
        assert!(said.starts_with(&format!("`{key}` in [[output]], line 4: {wanted}")), "{added}\n{said}");
    }
}

#[test]
fn otp_goes_to_the_standards_groups_unless_told_otherwise() {
    let text = |more: &str| format!("[[output]]\nkind = \"otp\"\n{more}");
    let usual = load(&text("interface = \"127.0.0.1\"\nsystem_number = 7\n")).unwrap().outputs.remove(0);
    assert_eq!(usual.udp.to, ["239.159.1.7:5568".parse().unwrap()]);
    let Protocol::Otp(otp) = &usual.protocol else { panic!("otp") };
    assert_eq!((otp.component.as_str(), otp.group, otp.first_point, otp.priority, otp.reference), ("stagepose", 1, 1, 100, None));
    assert_eq!(otp.listen, "239.159.2.1:5568".parse().unwrap());
    let own = load(&text(
        "to = \"127.0.0.1:9\"\nlisten = \"127.0.0.1:5568\"\nsystem = \"rig\"\ngroup_number = 60000\nfirst_point = 500\npriority = 200\n\
         reference_point = [1, 2, 3]\n",
    ));
    let own = own.unwrap().outputs.remove(0);
    let Protocol::Otp(otp) = &own.protocol else { panic!("otp") };
    assert_eq!((otp.component.as_str(), otp.group, otp.first_point, otp.priority), ("rig", 60_000, 500, 200));
    assert_eq!((own.udp.to.len(), otp.reference.unwrap().point, own.listen()), (1, 3, Some("127.0.0.1:5568".parse().unwrap())));
    let v6 = load(&text("to = \"[ff18::9f:0:1:1]:5568\"\ninterface = \"lo\"")).unwrap().outputs.remove(0);
    assert_eq!(v6.listen(), Some("[ff18::9f:0:2:1]:5568".parse().unwrap()));
    for (more, wanted) in [
        ("", "[[output]], line 1, has no `interface`; add this machine's IPv4 address on the network of OTP's multicasts"),
        ("interface = \"127.0.0.1\"\nsystem_number = 0", "`system_number` in [[output]], line 4: 0 cannot be used; give a whole number"),
        ("interface = \"127.0.0.1\"\npriority = 201", "`priority` in [[output]], line 4: 201 cannot be used"),
        ("interface = \"127.0.0.1\"\nreference_point = [1, 0, 3]", "`reference_point` in [[output]], line 4: [1, 0, 3] cannot be used"),
        ("interface = \"127.0.0.1\"\nlisten = \"5568\"", "`listen` in [[output]], line 4: `5568` cannot be used"),
        ("interface = \"127.0.0.1\"\non_loss = \"flag\"", "`on_loss` in [[output]], line 4: there is nothing to flag a loss with"),
        ("to = \"127.0.0.1:9\"", "[[output]], line 1, has no `interface`"),
    ] {
        let said = message(&text(more));
        assert!(said.starts_with(wanted), "{more}\n{said}");
    }
    assert!(message(&format!("{FREED}priority = 1")).starts_with("`priority` in [[output]], line 4: it belongs to otp; remove it"));
}

#[test]
fn a_stale_limit_below_the_frame_interval_gets_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    super::tests::fill(folder.path());
    let notes = |camera: &str, safety: &str| {
        let stage = "[[stage.surface]]\nimage = \"art.png\"\nsize_m = [4, 3]\n";
        let file = folder.path().join("stage.toml");
        std::fs::write(&file, format!("[camera]\ncalibration = \"camera.toml\"\n{camera}\n{stage}[safety]\n{safety}\n")).unwrap();
        Settings::load(&file).unwrap().notes.into_iter().filter(|note| note.contains("stale_after_s")).collect::<Vec<_>>()
    };
    let [slow] = &notes("fps = 1.5", "")[..] else { panic!("one note") };
    assert!(
        slow.contains("is 0.5 s, but at 1.5000 frames a second a frame comes every 0.667 s") && slow.ends_with("give at least 2.0"),
        "{slow}"
    );
    assert_eq!(notes("fps = 30", "stale_after_s = 0.02").len(), 1);
    assert_eq!(notes("fps = 30", "stale_after_s = 0.05").len() + notes("", "stale_after_s = 0.02").len(), 0);
}

#[test]
fn unavailable_ports_and_files_are_reported_with_their_line() {
    let folder = tempfile::tempdir().unwrap();
    let stage = "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nimage = \"art.png\"\nsize_m = [4, 3]\n";
    super::tests::fill(folder.path());
    let rehearse = |more: &str| {
        let file = folder.path().join("stage.toml");
        std::fs::write(&file, format!("{stage}{more}")).unwrap();
        Settings::load(&file).unwrap().rehearse_outputs().map_err(|e| e.to_string())
    };
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let at = taken.local_addr().unwrap();
    let said = rehearse(&format!("[[output]]\nkind = \"json\"\ntcp_listen = \"{at}\"")).unwrap_err();
    assert!(said.contains(&format!("`tcp_listen` in [[output]], line 8: cannot wait for clients on {at}")), "{said}");
    let said = rehearse(&format!("[http]\nlisten = \"{at}\"")).unwrap_err();
    assert!(said.contains(&format!("`listen` in [http], line 7: cannot listen on {at}")), "{said}");
    let foreign = "[[output]]\nkind = \"freed\"\nto = [\"239.1.2.3:4000\"]\ninterface = \"203.0.113.7\"";
    let said = rehearse(foreign).unwrap_err();
    assert!(said.contains("`interface` in [[output]], line 9: cannot send by UDP"), "{said}");
    // Each of the two finds the port free when tried alone.
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let output = |address: &str| format!("[[output]]\nkind = \"json\"\ntcp_listen = \"{address}\"\n");
    let everywhere = format!("0.0.0.0:{}", free.port());
    let said = rehearse(&format!("{}[http]\nlisten = \"{everywhere}\"", output(&free.to_string()))).unwrap_err();
    let wanted =
        format!("`listen` in [http], line 10: cannot listen on {everywhere} (the output json-6 listens there too); give a free port");
    assert!(said.contains(&wanted), "{said}");
    let said = rehearse(&format!("{}{}", output(&free.to_string()), output(&free.to_string()))).unwrap_err();
    assert!(
        said.contains("`tcp_listen` in [[output]], line 11: cannot listen on ") && said.contains("the output json-6 listens"),
        "{said}"
    );
    let other = if free.port() == u16::MAX { free.port() - 1 } else { free.port() + 1 };
    assert!(
        !rehearse(&format!("{}{}", output(&free.to_string()), output(&format!("127.0.0.1:{other}")))).is_err_and(|e| e.contains("too"))
    );
    // Receivers identify bodies by name.
    let object = |name: &str| format!("[[object]]\nname = \"{name}\"\n[[object.surface]]\nimage = \"art.png\"\nsize_m = [1, 1]\n");
    let osc = |more: &str| format!("[[output]]\nkind = \"osc\"\nto = \"127.0.0.1:{}\"\n{more}", free.port());
    let said = rehearse(&format!("{}{}", object("Camera"), osc(""))).unwrap_err();
    assert!(said.contains("`name` in [[object]], line 7: `Camera` is the outputs' name for the camera itself"), "{said}");
    assert_eq!(rehearse(&format!("{}{}", object("Camera"), osc("bodies = \"Camera\""))), Ok(()));
    assert_eq!(rehearse(&format!("{}{}", object("cart"), osc(""))), Ok(()));
    // A disabled output needs nothing.
    assert_eq!(rehearse(&format!("{foreign}\nenabled = false")), Ok(()));
    let into_nothing = "[[output]]\nkind = \"json\"\nfile = \"logs/sent.jsonl\"";
    let said = rehearse(into_nothing).unwrap_err();
    assert!(said.contains("`file` in [[output]], line 8: ") && said.contains("logs/sent.jsonl: cannot be written (the folder "), "{said}");
    std::fs::create_dir(folder.path().join("logs")).unwrap();
    assert_eq!(rehearse(into_nothing), Ok(()));
    assert!(!folder.path().join("logs/sent.jsonl").exists(), "a rehearsal makes no file");
    // Two outputs to one file, by whatever name, are refused; devices and standard output may be
    // shared.
    let line = |file: &str| format!("[[output]]\nkind = \"json\"\nfile = \"{file}\"\n");
    std::os::unix::fs::symlink("logs", folder.path().join("other")).unwrap();
    for (one, two) in [("a.jsonl", "./a.jsonl"), ("logs/a", "other/a")] {
        let said = rehearse(&format!("{}{}", line(one), line(two))).unwrap_err();
        assert!(said.contains("`file` in [[output]], line 11: ") && said.contains("the output json-6 writes to it too"), "{said}");
        assert_eq!(rehearse(&format!("{}{}enabled = false\n", line(one), line(two))), Ok(()));
    }
    for (one, two) in [("a.jsonl", "b.jsonl"), ("/dev/null", "/dev/null"), ("-", "-")] {
        assert_eq!(rehearse(&format!("{}{}", line(one), line(two))), Ok(()), "{one} {two}");
    }
    // What the running config holds is free for the next one; what others hold is not.
    let listens = format!("[[output]]\nkind = \"json\"\ntcp_listen = \"{at}\"");
    let file = folder.path().join("stage.toml");
    std::fs::write(&file, format!("{stage}{listens}")).unwrap();
    let running = Settings::load(&file).unwrap();
    assert_eq!(running.rehearse_outputs_beside(&running.listens().collect::<Vec<_>>()).map_err(|e| e.to_string()), Ok(()));
    std::fs::write(&file, stage).unwrap();
    let silent = Settings::load(&file).unwrap();
    assert!(running.rehearse_outputs_beside(&silent.listens().collect::<Vec<_>>()).is_err());
    // A destination port may belong to anyone.
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    assert_eq!(rehearse(&format!("[[output]]\nkind = \"freed\"\nto = [\"{receiver}\"]")), Ok(()));
}

#[test]
fn filter_settings_are_read_and_prediction_needs_a_filter() {
    let folder = tempfile::tempdir().unwrap();
    super::tests::fill(folder.path());
    let stage = "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nimage = \"art.png\"\nsize_m = [4, 3]\n";
    let filter = |more: &str| Settings::from_text(&format!("{stage}[filter]\n{more}"), &folder.path().join("stage.toml"));
    assert_eq!(filter("").unwrap().filter, FilterSettings::default());
    let read = filter("kind = \"kalman\"\npredict_s = 0.033\nacceleration_m_s2 = 5\nturn_acceleration_deg_s2 = 180").unwrap().filter;
    let FilterKind::Kalman(kalman) = read.kind else { panic!("{read:?}") };
    assert_eq!((read.predict_s, kalman.acceleration_m_s2), (0.033, 5.0));
    assert!((kalman.angular_acceleration_rad_s2 - std::f64::consts::PI).abs() < 1e-12);
    assert!(
        matches!(filter("kind = \"one-euro\"\nbeta = 1\nmin_cutoff_hz = 2").unwrap().filter.kind, FilterKind::OneEuro(e) if e.beta == 1.0)
    );
    let said = filter("predict_s = 0.03").unwrap_err().to_string();
    assert!(said.contains("`predict_s` in [filter], line 7: a prediction needs the velocity"), "{said}");
    let said = filter("kind = \"median\"").unwrap_err().to_string();
    assert!(said.contains("`kind` in [filter], line 7: `median` cannot be used; give off, one-euro or kalman"), "{said}");
}

#[test]
fn the_examples_for_receivers_are_good() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let mut read = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let file = entry.unwrap().path();
        if file.extension().is_none_or(|e| e != "toml") || file.ends_with("stage.toml") {
            continue;
        }
        let text = std::fs::read_to_string(&file).unwrap();
        // The calibration is the user's own file.
        let text: String = text.lines().filter(|l| !l.starts_with("calibration")).map(|l| format!("{l}\n")).collect();
        let settings = load(&text).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        assert!(!settings.outputs.is_empty() && text.contains(", not run."), "{}", file.display());
        read += 1;
    }
    assert_eq!(read, 7);
}

#[test]
fn a_receiver_preset_sets_axes_and_units() {
    let placement = |text: &str| load(text).unwrap().outputs[0].placement;
    let unreal = placement(&format!("{OSC}receiver = \"Unreal\"\n"));
    assert_eq!((unreal.order, unreal.scale, unreal.angle_signs), ([1, 0, 2], 100.0, [-1.0, 1.0, 1.0]));
    // Explicit keys apply on top: metres, and a pan that is inverted once more.
    let own = placement(&format!("{OSC}receiver = \"unreal\"\nscale = 1\ninvert = [\"pan\"]\noffset_m = [1, 2, 3]\n"));
    assert_eq!((own.order, own.scale, own.angle_signs, own.offset_m.y), ([1, 0, 2], 1.0, [1.0; 3], 2.0));
    // Protocols with their own axes are converted by the receiver.
    for receiver in ["unreal", "disguise", "touchdesigner", "lighting"] {
        assert!(placement(&format!("{FREED}receiver = \"{receiver}\"\n")).is_identity());
    }
    let said = message(&format!("{JSON}receiver = \"unreal\"\n"));
    assert!(said.starts_with("`receiver` in [[output]], line 4: json sends the record's own axes"), "{said}");
    let said = message(&format!("{OSC}receiver = \"unity\"\n"));
    assert!(said.starts_with("`receiver` in [[output]], line 4: `unity` cannot be used; give unreal, disguise"), "{said}");
}

#[test]
fn rings_need_the_other_tracker() {
    let rings = format!("{FREED}rings = \"other_tracker\"\n");
    let said = load(&rings).unwrap_err().to_string();
    assert!(said.contains("`rings` in [[output]]") && said.contains("no [other_tracker]"), "{said}");
    let other = "[other_tracker]\nprotocol = \"freed\"\nlisten = \"127.0.0.1:40000\"\n";
    assert!(load(&format!("{rings}{other}")).unwrap().outputs[0].passes_rings);
    assert!(!load(&format!("{FREED}{other}")).unwrap().outputs[0].passes_rings);
}
