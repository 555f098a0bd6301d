//! `[stage] origin`: moves the stage frame to the house's coordinates, by measured points of the
//! first surface.
//!
//! Surfaces are typed relative to each other, with the first one's centre at the origin by default.
//! The house counts from elsewhere: the centre line, the floor, the plaster line. If one point of
//! the first surface is given in house coordinates, all surfaces are translated; if three or more
//! are given, they are rotated as well.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Vector3};
use toml::Spanned;

use super::origin::Origin;
use super::typed_values::{Exactly, Number};
use super::values::Section;
use super::{ConfigError, Problem};
use crate::geometry::pose::quaternion;
use crate::geometry::{Body, Pose};
use crate::track::{BodySpec, SurfaceSpec};

/// Named points of a picture: shares of the surface's width and height from its centre, right and
/// up as its audience sees it.
pub(super) const NAMED_POINTS: [(&str, [f64; 2]); 10] = [
    ("centre", [0.0, 0.0]),
    ("center", [0.0, 0.0]),
    ("top left", [-0.5, 0.5]),
    ("top right", [0.5, 0.5]),
    ("bottom left", [-0.5, -0.5]),
    ("bottom right", [0.5, -0.5]),
    ("top", [0.0, 0.5]),
    ("bottom", [0.0, -0.5]),
    ("left", [-0.5, 0.0]),
    ("right", [0.5, 0.0]),
];
/// The same names for messages.
pub(super) const KNOWN_POINTS: &str = "centre, top left, top right, bottom left, bottom right, top, bottom, left or right, of the surface";
/// Maximum misfit between measured points and the surface's size, as a share of the surface's
/// diagonal: more means a slip. Chosen: cloths hang and stretch by less. Raised, slips pass;
/// lowered, honest measurements are refused.
const MAX_MISFIT: f64 = 0.02;
/// Allowed error of a tape measure in addition, metres. Chosen, not measured: it matters for small
/// surfaces only. Raised, slips there pass.
const TAPE_M: f64 = 0.01;

/// Moves a stage to its measured points; returns a sentence on how well they fit, if there are
/// several.
pub(super) fn place(
    origin: &Origin<'_>,
    typed: &Spanned<BTreeMap<String, Spanned<Exactly<Number, 3>>>>,
    stage: &mut BodySpec,
) -> Result<Option<String>, ConfigError> {
    let section = Section { origin, name: "[stage]" };
    let refuse = |problem| section.refuse("origin", &typed.span(), Problem::Combination(problem));
    let Some(first) = stage.surfaces.first() else { return Ok(None) };
    let mut pairs = Vec::new();
    for (name, measured) in typed.get_ref() {
        let typed_name = Spanned::new(measured.span(), name.clone());
        let [across, up] = section.word("origin", Some(&typed_name), [0.0; 2], &NAMED_POINTS, KNOWN_POINTS)?;
        let on_surface = Point3::new(across * first.size_m[0], up * first.size_m[1], 0.0);
        pairs.push((first.pose.transform(&on_surface).coords, section.position("origin", Some(measured))?));
    }
    let moved = match pairs.len() {
        0 => {
            return Err(refuse(
                "there is no point in it; name one of the first surface, such as origin = { \"bottom left\" = [-2.0, 6.0, 0.0] }",
            ));
        }
        1 => Pose::new(nalgebra::UnitQuaternion::identity(), pairs[0].1 - pairs[0].0),
        2 => return Err(refuse("two points do not determine the stage's rotation about the line through them; give one, or three")),
        _ => fitted(&pairs)
            .ok_or_else(|| refuse("these points lie in one line, so the stage's rotation about it is undetermined; give a third corner"))?,
    };
    let misfits = pairs.iter().map(|(from, to)| (moved.transform(&Point3::from(*from)).coords - to).norm());
    let (largest, diagonal) = (misfits.fold(0.0, f64::max), first.size_m[0].hypot(first.size_m[1]));
    if largest > TAPE_M + MAX_MISFIT * diagonal {
        let value = format!("a point {largest:.3} m from where size_m puts it");
        let wanted = "points that are as far apart as size_m says, or measure size_m again";
        return Err(section.refuse("origin", &typed.span(), Problem::Range { value, wanted }));
    }
    let moved_surface = |surface: &SurfaceSpec| SurfaceSpec { pose: moved * surface.pose, ..surface.clone() };
    stage.surfaces = stage.surfaces.iter().map(moved_surface).collect();
    let sentence = format!("origin: the measured points fit the first surface to {:.1} mm", largest * 1e3);
    Ok((pairs.len() > 1).then_some(sentence))
}

/// Returns the rigid motion that best carries each pair's first point to its second (Kabsch 1976);
/// `None` if they are collinear.
fn fitted(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Pose<Body, Body>> {
    let n = pairs.len() as f64;
    let (from, to) = (pairs.iter().map(|p| p.0).sum::<Vector3<f64>>() / n, pairs.iter().map(|p| p.1).sum::<Vector3<f64>>() / n);
    let cross: Matrix3<f64> = pairs.iter().map(|(a, b)| (b - to) * (a - from).transpose()).sum();
    let svd = cross.svd(true, true);
    if svd.singular_values[1] <= 1e-6 * svd.singular_values[0] {
        return None;
    }
    let (u, v_t) = (svd.u?, svd.v_t?);
    let rotation = quaternion(&(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum())) * v_t));
    Some(Pose::new(rotation, to - rotation * from))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::Settings;

    /// Loads the fixture's backdrop, 4 x 3 m, with a flat in front of it.
    fn load(origin: &str) -> Result<Settings, ConfigError> {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/dolly/stage.toml");
        let text = format!(
            "[camera]\ncalibration = \"camera.toml\"\n[stage]\n{origin}\n[[stage.surface]]\nimage = \"backdrop.png\"\nsize_m = [4.0, 3.0]\n\
             [[stage.surface]]\nimage = \"flat.png\"\nsize_m = [1.1, 1.7]\nposition_m = [1.0, -0.8, -0.65]\n"
        );
        Settings::from_text(&text, &file)
    }

    fn places(origin: &str) -> Vec<[f64; 3]> {
        let rounded = |v: f64| (v * 1e6).round() / 1e6 + 0.0;
        load(origin).unwrap().stage.surfaces.iter().map(|s| s.pose.translation.map(rounded).into()).collect()
    }

    #[test]
    fn one_origin_point_shifts_the_stage_and_three_rotate_it() {
        assert_eq!(places(""), [[0.0, 0.0, 0.0], [1.0, -0.8, -0.65]]);
        assert_eq!(places("origin = { \"bottom left\" = [-2.1, 6.0, 0.1] }"), [[-0.1, 6.0, 1.6], [0.9, 5.2, 0.95]]);
        assert_eq!(places("origin = { Centre = [0, 5, 1] }"), [[0.0, 5.0, 1.0], [1.0, 4.2, 0.35]]);
        // Rotated by 90 degrees: the backdrop extends along y, and what stood in front of it is to
        // its right.
        let turned = "origin = { \"bottom left\" = [0, 0, 0], \"bottom right\" = [0, 4, 0], \"top_left\" = [0, 0, 3] }";
        assert_eq!(places(turned), [[0.0, 2.0, 1.5], [0.8, 3.0, 0.85]]);
        let settings = load(turned).unwrap();
        assert!(settings.notes.iter().any(|note| note.contains("fit the first surface to 0.0 mm")), "{:?}", settings.notes);
        let across = settings.stage.surfaces[1].pose.rotation * Vector3::x();
        assert!((across - Vector3::y()).norm() < 1e-9, "{across}");
        // A tape measure's error is distributed over the points.
        let slack = "origin = { \"bottom left\" = [0, 0, 0], \"bottom right\" = [4.012, 0, 0], \"top left\" = [0, 0, 3] }";
        assert!(load(slack).unwrap().notes.iter().any(|note| note.contains("mm")));
    }

    #[test]
    fn insufficient_origin_points_are_refused() {
        let cases = [
            ("origin = {}", "there is no point in it"),
            ("origin = { \"bottom left\" = [0, 0, 0], \"top left\" = [0, 0, 3] }", "two points do not determine"),
            ("origin = { left = [-2, 0, 0], centre = [0, 0, 0], right = [2, 0, 0] }", "lie in one line"),
            ("origin = { corner = [0, 0, 0] }", "`corner` cannot be used; give centre, top left"),
            ("origin = { \"botom left\" = [0, 0, 0] }", "did you mean `bottom left`?"),
            ("origin = { centre = [0, 0, 20000] }", "three numbers of metres between"),
            (
                "origin = { \"bottom left\" = [0, 0, 0], \"bottom right\" = [4.5, 0, 0], \"top left\" = [0, 0, 3] }",
                "from where size_m puts it cannot be used; give points that are as far apart as size_m says",
            ),
        ];
        for (origin, wanted) in cases {
            let said = load(origin).map(|_| ()).expect_err(origin).to_string();
            assert!(said.contains("`origin` in [stage], line 4") && said.contains(wanted), "{origin}: {said}");
        }
    }
}
