//! `[[map.point]]`, `[[map.distance]]` and `[map] floor`: points of the set and lengths between
//! them, for `stagepose map`.

use nalgebra::Vector2;
use toml::Spanned;

use super::as_typed;
use super::origin::Origin;
use super::typed_values::{Exactly, Number};
use super::values::Section;
use super::{ConfigError, Problem};
use crate::survey::named_points::{Click, NamedDistance, NamedPoint, NamedPoints};

/// The sections' names in messages.
const MAP: &str = "[map]";
/// See [`MAP`].
const POINT: &str = "[[map.point]]";
/// See [`MAP`].
const DISTANCE: &str = "[[map.distance]]";
/// Default sigma of a measurement, metres: a steel tape in careful hands.
const USUAL_SIGMA_M: f64 = 0.003;
/// Allowed sigmas of a measurement, metres.
const SIGMAS_M: std::ops::RangeInclusive<f64> = 1e-5..=1.0;
/// Allowed lengths on a stage, metres.
const LENGTHS_M: std::ops::RangeInclusive<f64> = 1e-2..=1e3;
/// Maximum column or row of a pixel.
const MAX_PX: f64 = 1e5;

/// Reads all named points and what was measured of them.
pub(super) fn named_points(origin: &Origin<'_>, typed: Option<&as_typed::Map>) -> Result<NamedPoints, ConfigError> {
    let Some(typed) = typed else { return Ok(NamedPoints::default()) };
    let mut points: Vec<NamedPoint> = Vec::with_capacity(typed.point.len());
    for entry in &typed.point {
        let next = point(origin, entry)?;
        if points.iter().any(|point| point.name == next.name) {
            let name = entry.get_ref().name.as_ref().unwrap_or_else(|| unreachable!("a read point has a name"));
            return Err(Section { origin, name: POINT }.conflict("name", name, "another point has this name; give each its own"));
        }
        points.push(next);
    }
    let names: Vec<&str> = points.iter().map(|point| point.name.as_str()).collect();
    let distances = typed.distance.iter().map(|entry| distance(origin, entry, &names)).collect::<Result<_, _>>()?;
    let section = Section { origin, name: MAP };
    let floor = typed.floor.as_ref().map(|floor| {
        let wanted = "the names of three [[map.point]]: the origin, one along x, one beside";
        indices::<3>(&section, "floor", floor, &names, wanted)
    });
    let floor = floor.transpose()?;
    Ok(NamedPoints { points, distances, floor })
}

fn point(origin: &Origin<'_>, typed: &Spanned<as_typed::MapPoint>) -> Result<NamedPoint, ConfigError> {
    let (section, here) = (Section { origin, name: POINT }, || origin.section_at(POINT, &typed.span()));
    let point = typed.get_ref();
    let Some(name) = &point.name else {
        return Err(origin.missing(here(), "name", "the point's name, such as name = \"nail\""));
    };
    if name.get_ref().trim().is_empty() {
        return Err(section.unusable("name", name, "a name that is not empty"));
    }
    let seen = point.seen.iter().map(|click| self::click(origin, click)).collect::<Result<Vec<_>, _>>()?;
    let mut frames: Vec<(&str, u64)> = seen.iter().map(|click| (click.clip.as_str(), click.sequence)).collect();
    frames.sort_unstable();
    let clicked = frames.len();
    frames.dedup();
    if frames.len() < 2 || frames.len() < clicked {
        let sentence = "the point must be clicked in two frames or more, once in each; add frames that show it from other places to `seen`";
        return Err(section.conflict("name", name, sentence));
    }
    let sigma_m = sigma(&section, point.sigma_m.as_ref())?;
    let position_m = match &point.position_m {
        None => None,
        typed => Some((section.position("position_m", typed.as_ref())?, sigma_m)),
    };
    let entry = format!("{} (`{}`)", here().trim_end_matches(','), name.get_ref());
    Ok(NamedPoint { name: name.get_ref().clone(), entry, seen, position_m })
}

fn click(origin: &Origin<'_>, typed: &Spanned<as_typed::MapClick>) -> Result<Click, ConfigError> {
    let (section, here) = (Section { origin, name: POINT }, || origin.section_at("`seen` in [[map.point]]", &typed.span()));
    let click = typed.get_ref();
    let Some(clip) = &click.clip else {
        return Err(origin.missing(here(), "clip", "the clip's file or folder without its path, such as clip = \"walk\""));
    };
    let Some(sequence) = &click.sequence else {
        return Err(origin.missing(here(), "sequence", "the row in the clip, from 0, such as sequence = 12"));
    };
    let Some(px) = &click.px else {
        return Err(origin.missing(here(), "px", "the pixel, column and row, such as px = [640.5, 380.0]"));
    };
    let Exactly([Number(u), Number(v)]) = *px.get_ref();
    // This form also refuses NaN.
    if !(u.abs() < MAX_PX && v.abs() < MAX_PX) {
        let wanted = "a pixel of the frame, column and row";
        return Err(section.refuse("px", &px.span(), Problem::Range { value: format!("[{u}, {v}]"), wanted }));
    }
    Ok(Click { clip: clip.get_ref().clone(), sequence: sequence.get_ref().0, pixel: Vector2::new(u, v) })
}

fn distance(origin: &Origin<'_>, typed: &Spanned<as_typed::MapDistance>, names: &[&str]) -> Result<NamedDistance, ConfigError> {
    let (section, here) = (Section { origin, name: DISTANCE }, || origin.section_at(DISTANCE, &typed.span()));
    let distance = typed.get_ref();
    let Some(between) = &distance.between else {
        return Err(origin.missing(here(), "between", "the names of two points, such as between = [\"nail\", \"tape\"]"));
    };
    let Some(length) = &distance.length_m else {
        return Err(origin.missing(here(), "length_m", "what was measured between them, such as length_m = 3.254"));
    };
    let between = indices::<2>(&section, "between", between, names, "the names of two [[map.point]]")?;
    let wanted = "metres from 0.01 to 1000: 3254 millimetres are 3.254";
    let length_m = section.number("length_m", Some(length), 0.0, |v| LENGTHS_M.contains(&v), wanted)?;
    let entry = here().trim_end_matches(',').to_owned();
    Ok(NamedDistance { entry, between, length_m, sigma_m: sigma(&section, distance.sigma_m.as_ref())? })
}

/// Returns the indices of N different points by their names.
fn indices<const N: usize>(
    section: &Section<'_>,
    key: &str,
    typed: &Spanned<Vec<String>>,
    names: &[&str],
    wanted: &'static str,
) -> Result<[usize; N], ConfigError> {
    let refuse = || section.refuse(key, &typed.span(), Problem::Range { value: format!("{:?}", typed.get_ref()), wanted });
    let found: Vec<usize> = typed.get_ref().iter().filter_map(|name| names.iter().position(|known| known == name)).collect();
    let is_twice = found.iter().enumerate().any(|(k, index)| found[..k].contains(index));
    if is_twice || typed.get_ref().len() != N {
        return Err(refuse());
    }
    found.try_into().map_err(|_| refuse())
}

fn sigma(section: &Section<'_>, typed: Option<&Spanned<Number>>) -> Result<f64, ConfigError> {
    section.number("sigma_m", typed, USUAL_SIGMA_M, |v| SIGMAS_M.contains(&v), "metres from 0.00001 to 1, one sigma")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use nalgebra::Vector3;

    use super::*;
    use crate::config::Settings;

    const POINTS: &str = "[[map.point]]\nname = \"a\"\nseen = [{ clip = \"walk\", sequence = 3, px = [10.5, 20] }, \
                          { clip = \"walk\", sequence = 40, px = [11, 21] }]\nposition_m = [1, 2, 3]\n\
                          [[map.point]]\nname = \"b\"\n[[map.point.seen]]\nclip = \"walk\"\nsequence = 3\npx = [1, 2]\n\
                          [[map.point.seen]]\nclip = \"again\"\nsequence = 3\npx = [3, 4]\n\
                          [[map.distance]]\nbetween = [\"a\", \"b\"]\nlength_m = 3.25\nsigma_m = 0.001\n";

    fn load(map: &str) -> Result<NamedPoints, ConfigError> {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly/stage.toml");
        let text = format!("[camera]\ncalibration = \"camera.toml\"\n{map}");
        Settings::camera_from_text(&text, Path::new(file)).map(|settings| settings.named_points)
    }

    #[test]
    fn points_and_lengths_are_read_in_both_forms() {
        let found = load(POINTS).unwrap();
        assert_eq!(found.points.len(), 2);
        assert_eq!(found.points[0].position_m, Some((Vector3::new(1.0, 2.0, 3.0), USUAL_SIGMA_M)));
        assert_eq!(found.points[0].entry, "[[map.point]], line 3 (`a`)");
        assert_eq!(found.points[1].seen[1], Click { clip: "again".to_owned(), sequence: 3, pixel: Vector2::new(3.0, 4.0) });
        assert_eq!(found.distances[0].between, [0, 1]);
        assert_eq!((found.distances[0].length_m, found.distances[0].sigma_m), (3.25, 0.001));
        assert_eq!(found.distances[0].entry, "[[map.distance]], line 17");
        assert_eq!(load("").unwrap(), NamedPoints::default());
    }

    #[test]
    fn mistakes_are_refused_by_line_and_with_the_fix() {
        let cases: [(&str, &str, [&str; 2]); 9] = [
            ("name = \"b\"", "name = \"a\"", ["line 8", "another point has this name"]),
            ("name = \"b\"\n", "", ["line 7", "add the point's name"]),
            ("sequence = 40", "sequence = 3", ["line 4", "two frames or more"]),
            ("clip = \"walk\"\nsequence = 3", "sequence = 3", ["line 9", "clip"]),
            ("px = [1, 2]", "px = [1, nan]", ["line 12", "column and row"]),
            ("between = [\"a\", \"b\"]", "between = [\"a\", \"c\"]", ["line 18", "two [[map.point]]"]),
            ("between = [\"a\", \"b\"]", "between = [\"a\", \"a\"]", ["line 18", "two [[map.point]]"]),
            ("length_m = 3.25", "length_m = 3250", ["line 19", "3254 millimetres are 3.254"]),
            ("length_m = 3.25", "length = 3.25", ["line 19", "did you mean `length_m`"]),
        ];
        for (from, to, wanted) in cases {
            assert!(POINTS.contains(from), "{from}");
            let error = load(&POINTS.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(wanted.iter().all(|word| error.contains(word)), "{from} -> {to}: {error}");
        }
        let floor = |names: &str| load(&format!("[map]\nfloor = {names}\n{POINTS}"));
        assert!(floor("[\"a\", \"b\"]").unwrap_err().to_string().contains("three"));
    }
}
