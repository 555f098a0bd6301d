//! `[[survey.distance]]` and `[[survey.point]]`: measurements on the stage, for `stagepose survey`.

use std::ops::Range;

use nalgebra::Vector2;
use toml::Spanned;

use super::as_typed;
use super::origin::Origin;
use super::stage_origin::{KNOWN_POINTS, NAMED_POINTS};
use super::typed_values::{Count, Exactly, Number, PictureWord};
use super::values::Section;
use super::{ConfigError, Problem};
use crate::camera::Pixel;
use crate::survey::measured::{Constraint, Measured, PicturePoint};
use crate::track::{BodySpec, SurfaceSpec};

/// The section's name in messages.
const DISTANCE: &str = "[[survey.distance]]";
/// See [`DISTANCE`].
const POINT: &str = "[[survey.point]]";
/// Default sigma of a measurement, metres: a steel tape in careful hands. Raised, `size_m` has more
/// weight; lowered, honest tapes contradict each other.
const USUAL_SIGMA_M: f64 = 0.003;
/// Allowed sigmas of a measurement, metres. Paint has no edge sharper than the lower bound; above
/// the upper one, nothing was measured.
const SIGMAS_M: std::ops::RangeInclusive<f64> = 1e-4..=1.0;
/// Allowed lengths on a stage, metres; the maximum is that of a surface's side.
const LENGTHS_M: std::ops::RangeInclusive<f64> = 1e-2..=1e3;

/// Reads all measurements, lengths first.
pub(super) fn measured(origin: &Origin<'_>, typed: Option<&as_typed::Survey>, stage: &BodySpec) -> Result<Vec<Constraint>, ConfigError> {
    let Some(typed) = typed else { return Ok(Vec::new()) };
    let distances = typed.distance.iter().map(|distance| self::distance(origin, distance, stage));
    let points = typed.point.iter().map(|point| self::point(origin, point, stage));
    distances.chain(points).collect()
}

fn distance(origin: &Origin<'_>, typed: &Spanned<as_typed::SurveyDistance>, stage: &BodySpec) -> Result<Constraint, ConfigError> {
    let (section, here) = (Section { origin, name: DISTANCE }, || origin.section_at(DISTANCE, &typed.span()));
    let distance = typed.get_ref();
    let Some(surfaces) = &distance.surfaces else {
        let hint = "the two surfaces by their numbers in the file, such as surfaces = [1, 2] (or [1, 1])";
        return Err(origin.missing(here(), "surfaces", hint));
    };
    let Some(at) = &distance.at else {
        let hint = "where the two points are on their pictures, such as at = [\"top left\", [812.0, 40.5]] (pixels of the picture)";
        return Err(origin.missing(here(), "at", hint));
    };
    let Some(length) = &distance.length_m else {
        return Err(origin.missing(here(), "length_m", "what was measured between them, such as length_m = 3.254"));
    };
    let Exactly([from, to]) = surfaces.get_ref();
    let Exactly([from_at, to_at]) = at.get_ref();
    let place =
        |surface: &Count, at: &PictureWord| picture_point(&section, ("surfaces", surface, surfaces.span()), (at, &distance.at), stage);
    let between = [place(from, from_at)?, place(to, to_at)?];
    if between[0] == between[1] {
        return Err(section.conflict("at", at, "both points are the same; name two"));
    }
    let wanted = "metres from 0.01 to 1000: 3254 millimetres are 3.254";
    let length_m = section.number("length_m", Some(length), 0.0, |v| LENGTHS_M.contains(&v), wanted)?;
    let measured = Measured::Distance { between, length_m };
    Ok(Constraint { name: here().trim_end_matches(',').to_owned(), measured, sigma_m: sigma(&section, distance.sigma_m.as_ref())? })
}

fn point(origin: &Origin<'_>, typed: &Spanned<as_typed::SurveyPoint>, stage: &BodySpec) -> Result<Constraint, ConfigError> {
    let (section, here) = (Section { origin, name: POINT }, || origin.section_at(POINT, &typed.span()));
    let point = typed.get_ref();
    let Some(surface) = &point.surface else {
        return Err(origin.missing(here(), "surface", "the surface by its number in the file, such as surface = 2"));
    };
    let Some(at) = &point.at else {
        let hint = "where the point is on its picture, such as at = \"top left\", or at = [812.0, 40.5] (pixels of the picture)";
        return Err(origin.missing(here(), "at", hint));
    };
    if point.position_m.is_none() {
        return Err(origin.missing(
            here(),
            "position_m",
            "where the point was measured in the stage, such as position_m = [1.5, -0.8, 0.3]",
        ));
    }
    let of = picture_point(&section, ("surface", surface.get_ref(), surface.span()), (at.get_ref(), &point.at), stage)?;
    let measured = Measured::Place { of, position_m: section.position("position_m", point.position_m.as_ref())? };
    Ok(Constraint { name: here().trim_end_matches(',').to_owned(), measured, sigma_m: sigma(&section, point.sigma_m.as_ref())? })
}

fn sigma(section: &Section<'_>, typed: Option<&Spanned<Number>>) -> Result<f64, ConfigError> {
    section.number("sigma_m", typed, USUAL_SIGMA_M, |v| SIGMAS_M.contains(&v), "metres from 0.0001 to 1, one sigma")
}

/// Resolves a point of a surface; `typed_at` has the place of `at` in the file.
fn picture_point<T>(
    section: &Section<'_>,
    (key, Count(number), span): (&str, &Count, Range<usize>),
    (at, typed_at): (&PictureWord, &Option<Spanned<T>>),
    stage: &BodySpec,
) -> Result<PicturePoint, ConfigError> {
    let index = usize::try_from(*number).ok().and_then(|n| n.checked_sub(1));
    let Some((surface, spec)) = index.and_then(|k| Some((k, stage.surfaces.get(k)?))) else {
        let wanted = "the number of a [[stage.surface]] in this file, from 1";
        return Err(section.refuse(key, &span, Problem::Range { value: number.to_string(), wanted }));
    };
    let at_span = typed_at.as_ref().map_or(span, Spanned::span);
    let on_picture_m = match at {
        PictureWord::Named(name) => {
            let typed = Spanned::new(at_span, name.clone());
            let [across, up] = section.word("at", Some(&typed), [0.0; 2], &NAMED_POINTS, KNOWN_POINTS)?;
            [across * spec.size_m[0], up * spec.size_m[1]]
        }
        PictureWord::Pixel(pixel) => on_picture(spec, *pixel).ok_or_else(|| {
            let wanted = "pixels [u, v] on the surface's picture, as its file has them";
            section.refuse("at", &at_span, Problem::Range { value: format!("{pixel:?}"), wanted })
        })?,
    };
    Ok(PicturePoint { surface, on_picture_m })
}

/// Converts a raw pixel of a surface's picture to metres from its centre; `None` outside the
/// surface.
fn on_picture(spec: &SurfaceSpec, [u, v]: [f64; 2]) -> Option<[f64; 2]> {
    let artwork = spec.artwork_pixel(Pixel(Vector2::new(u, v)))?;
    let metres: [f64; 2] = spec.to_metres(artwork).into();
    let is_inside = metres.iter().zip(spec.size_m).all(|(m, side)| m.abs() <= 0.5 * side * (1.0 + 1e-9));
    is_inside.then_some(metres)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::Settings;

    /// Loads the fixture's backdrop, 4 x 3 m, with a flat in front of it and these measurements.
    fn load(survey: &str) -> Result<Settings, ConfigError> {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dolly/stage.toml");
        let text = format!(
            "[camera]\ncalibration = \"camera.toml\"\n[[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n\
             [[stage.surface]]\nimage = \"flat.png\"\nsize_m = [1.1, 1.7]\nposition_m = [1.0, -0.8, -0.65]\n{survey}\n"
        );
        Settings::from_text(&text, &file)
    }

    #[test]
    fn measured_points_are_given_by_name_or_pixel() {
        let settings = load(
            "[[survey.distance]]\nsurfaces = [1, 2]\nat = [\"top left\", [-0.5, -0.5]]\nlength_m = 3.25\nsigma_m = 0.001\n\
             [[survey.point]]\nsurface = 2\nat = \"bottom right\"\nposition_m = [1.55, -0.8, -1.5]",
        )
        .unwrap();
        let point = |surface, on_picture_m| PicturePoint { surface, on_picture_m };
        let between = [point(0, [-2.0, 1.5]), point(1, [-0.55, 0.85])];
        let [length, place] = settings.measured.as_slice() else { panic!("{:?}", settings.measured) };
        assert_eq!(length.measured, Measured::Distance { between, length_m: 3.25 });
        assert_eq!((length.name.as_str(), length.sigma_m), ("[[survey.distance]], line 10", 0.001));
        let position_m = nalgebra::Vector3::new(1.55, -0.8, -1.5);
        assert_eq!(place.measured, Measured::Place { of: point(1, [0.55, -0.85]), position_m });
        assert_eq!(place.sigma_m, USUAL_SIGMA_M);
    }

    #[test]
    fn invalid_measurements_are_refused_with_line_and_hint() {
        let distance = "[[survey.distance]]\nsurfaces = [1, 2]\nat = [\"left\", \"right\"]\nlength_m = 3.0\n";
        let point = "[[survey.point]]\nsurface = 2\nat = \"left\"\nposition_m = [0, 0, 0]\n";
        for (text, from, to, parts) in [
            (distance, "surfaces = [1, 2]\n", "", ["[[survey.distance]], line 10,", "add the two surfaces"]),
            (distance, "at = [\"left\", \"right\"]\n", "", ["has no `at`", "pixels of the picture"]),
            (distance, "length_m = 3.0\n", "", ["has no `length_m`", "3.254"]),
            (distance, "[1, 2]", "[1, 3]", ["`surfaces` in [[survey.distance]], line 11", "3 cannot be used"]),
            (distance, "[1, 2]", "[1, 0]", ["line 11", "from 1"]),
            (distance, "3.0", "3254", ["line 13", "3.254"]),
            (distance, "\"left\"", "\"rihgt\"", ["line 12", "did you mean `right`"]),
            (distance, "\"left\"", "[9000, 3]", ["line 12", "pixels [u, v]"]),
            (distance, "\"left\"", "7", ["line 12", "a point's name, or its pixel [u, v]"]),
            (distance, "[1, 2]\nat = [\"left\", \"right\"]", "[1, 1]\nat = [\"left\", \"left\"]", ["line 12", "both points are the same"]),
            (point, "surface = 2\n", "", ["has no `surface`", "surface = 2"]),
            (point, "position_m = [0, 0, 0]\n", "", ["has no `position_m`", "[1.5, -0.8, 0.3]"]),
            (point, "[0, 0, 0]\n", "[0, 0, 0]\nsigma_m = 0\n", ["`sigma_m` in [[survey.point]], line 14", "one sigma"]),
            (point, "at =", "att =", ["unknown key `att` in [[survey.point]], line 12", "did you mean `at`"]),
        ] {
            let said = load(&text.replace(from, to)).unwrap_err().to_string();
            parts.iter().for_each(|part| assert!(said.contains(part), "`{part}` is not in {said}"));
        }
    }
}
