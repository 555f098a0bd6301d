//! The result as text, as lines for the config, and as JSON.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};
use serde_json::{Value, json};

use crate::geometry::{Body, Camera, FilmingCamera, Pose};
use crate::mount::{NextView, Solution, StillPair, Verdict, worst_sigmas};
use crate::protocols::{PanTiltRoll, to_body_axes};
use crate::publish::MountSettings;

/// Squared Mahalanobis distance that two identical mounts exceed once in a hundred times: the 99 %
/// quantile of chi-squared with six degrees of freedom. Raised, configured mounts with larger
/// errors still agree.
const SAME: f64 = 16.8;
/// Accuracy of a tape measure and an inclinometer, one sigma each: metres and radians. Used for
/// configured values without a sigma. Chosen, not measured. Raised, larger differences from the
/// measured mount still agree.
const TYPED_SIGMA_M: f64 = 2e-3;
const TYPED_SIGMA_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// The measurement, ready to print.
pub(super) struct MountReport<'a> {
    pub mount: &'a Pose<Camera, FilmingCamera>,
    /// Including the lenses' uncertainty.
    pub covariance: Matrix6<f64>,
    pub solution: &'a Solution,
    pub pairs: &'a [StillPair],
    pub verdict: Verdict,
    pub reasons: Vec<String>,
    pub next: Option<NextView>,
    pub typed: Option<&'a MountSettings>,
    /// The filming camera's calibration.
    pub lens: Option<&'a Path>,
    pub tracking_config: &'a Path,
}

/// Returns the rotation from the camera's optical axes to its body's: x right, y forward, z up.
fn body_axes() -> UnitQuaternion<f64> {
    to_body_axes(&Pose::identity()).rotation.inverse()
}

impl MountReport<'_> {
    /// Returns the mount between the cameras' bodies.
    fn of_bodies(&self) -> Pose<Body, Body> {
        let axes = body_axes();
        Pose::new(axes * self.mount.rotation * axes.inverse(), axes * self.mount.translation)
    }

    /// Returns its covariance in the tracking camera's body axes.
    fn of_bodies_covariance(&self) -> Matrix6<f64> {
        let rotation = body_axes().to_rotation_matrix().into_inner();
        let mut both = Matrix6::zeros();
        both.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        both.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        let rotated = both * self.covariance * both.transpose();
        (rotated + rotated.transpose()) * 0.5
    }

    /// Returns one sigma of right, forward, up (metres), then of pan, tilt, roll (degrees).
    fn sigmas(&self) -> [f64; 6] {
        let s = self.of_bodies_covariance().diagonal().map(f64::sqrt);
        [s[0], s[1], s[2], s[5].to_degrees(), s[3].to_degrees(), s[4].to_degrees()]
    }

    pub fn text(&self) -> String {
        let mut text = String::new();
        let used = self.solution.views.iter().filter(|view| view.is_used).count();
        let _ = writeln!(text, "{} pairs of views, {} measured by both cameras, {used} used", self.pairs.len(), self.solution.views.len());
        for line in missing(self.pairs).iter().chain(&self.left_out()) {
            let _ = writeln!(text, "  {line}");
        }
        let (mount, s) = (self.of_bodies(), self.sigmas());
        let (o, angles) = (mount.translation * 1e3, PanTiltRoll::of_rotation(&mount.rotation, 0.0));
        let _ = writeln!(text, "offset    right {:+.2} mm, forward {:+.2} mm, up {:+.2} mm", o.x, o.y, o.z);
        let _ = writeln!(text, "  sigma   {:.2} mm, {:.2} mm, {:.2} mm", s[0] * 1e3, s[1] * 1e3, s[2] * 1e3);
        let (pan, tilt, roll) = (angles.pan_deg, angles.tilt_deg, angles.roll_deg);
        let _ = writeln!(text, "rotation  pan {pan:+.3}, tilt {tilt:+.3}, roll {roll:+.3} degrees");
        let _ = writeln!(text, "  sigma   {:.3}, {:.3}, {:.3} degrees", s[3], s[4], s[5]);
        let _ = writeln!(text, "verdict   {}", self.verdict);
        for reason in &self.reasons {
            let _ = writeln!(text, "          {reason}");
        }
        if let Some(NextView { words, sigmas }) = self.next.as_ref().filter(|_| self.verdict != Verdict::Good) {
            let then =
                sigmas.map(|[shift, rotation]| format!(": then about {:.2} mm and {:.3} degrees", shift * 1e3, rotation.to_degrees()));
            let _ = writeln!(text, "next      {words}{}", then.unwrap_or_default());
        }
        if let Some(typed) = self.typed {
            let _ = writeln!(text, "config    {}", self.judged(typed));
        }
        let _ = write!(text, "\n# for {}\n{}", self.tracking_config.display(), self.section());
        text
    }

    /// Describes pairs that contradict the others.
    fn left_out(&self) -> Vec<String> {
        let measured = self.pairs.iter().filter(|pair| pair.views.iter().all(Option::is_some));
        let wrong = measured.zip(&self.solution.views).filter(|(_, view)| !view.is_used);
        let line = |(pair, view): (&StillPair, &crate::mount::Used)| {
            let off = (view.squared_distance / 6.0).sqrt();
            format!(
                "{}: left out, its residual is {off:.0} times what noise explains; was the rig moved between the two pictures?",
                named(pair)
            )
        };
        wrong.map(line).collect()
    }

    /// Compares the config's mount with the measured one.
    fn judged(&self, typed: &MountSettings) -> String {
        let (measured, typed_pose) = (self.of_bodies(), typed.mount.pose);
        let shift = typed_pose.translation - measured.translation;
        let rotation = (typed_pose.rotation * measured.rotation.inverse()).scaled_axis();
        let difference = Vector6::new(shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z);
        let own = if typed.mount.covariance == Matrix6::zeros() {
            let sigmas = [TYPED_SIGMA_M, TYPED_SIGMA_M, TYPED_SIGMA_M, TYPED_SIGMA_RAD, TYPED_SIGMA_RAD, TYPED_SIGMA_RAD];
            Matrix6::from_diagonal(&Vector6::from(sigmas).map(|s| s * s))
        } else {
            typed.mount.covariance
        };
        let both = (own + self.of_bodies_covariance()).cholesky();
        let distance = both.map_or(f64::INFINITY, |both| difference.dot(&both.solve(&difference)));
        let apart = format!("{:.1} mm and {:.2} degrees", shift.norm() * 1e3, rotation.norm().to_degrees());
        if distance <= SAME {
            return format!("its [mount] agrees with the measurement: {apart} apart");
        }
        let worst: Vec<String> = [("right", shift.x), ("forward", shift.y), ("up", shift.z)]
            .iter()
            .map(|(word, metres)| format!("{word} {:+.1} mm", metres * 1e3))
            .collect();
        format!(
            "its [mount] differs from the measurement by {apart} ({}); replace it by the lines below, or measure again",
            worst.join(", ")
        )
    }

    /// Returns the lines for the config.
    fn section(&self) -> String {
        let (mount, s) = (self.of_bodies(), self.sigmas());
        let (o, angles) = (mount.translation, PanTiltRoll::of_rotation(&mount.rotation, 0.0));
        // `+ 0.0` keeps a rounded zero from being printed as -0.
        let [x, y, z] = [o.x, o.y, o.z].map(|v| (v * 1e5).round() / 1e5 + 0.0);
        let [pan, tilt, roll] = [angles.pan_deg, angles.tilt_deg, angles.roll_deg].map(|v| (v * 1e4).round() / 1e4 + 0.0);
        let mut text = String::from("[mount]\n");
        if let Some(typed) = self.typed {
            let _ = writeln!(text, "name = {}", toml::Value::String(typed.name.clone()));
        }
        let _ = writeln!(text, "offset_m = [{x:.5}, {y:.5}, {z:.5}]");
        let _ = writeln!(text, "rotation_deg = [{pan:.4}, {tilt:.4}, {roll:.4}]");
        let _ = writeln!(text, "offset_sigma_m = [{:.5}, {:.5}, {:.5}]", s[0], s[1], s[2]);
        let _ = writeln!(text, "rotation_sigma_deg = [{:.4}, {:.4}, {:.4}]", s[3], s[4], s[5]);
        if let Some(lens) = self.lens {
            let _ = writeln!(text, "calibration = {}", toml::Value::String(self.beside(lens).display().to_string()));
        }
        if let Some(typed) = self.typed.filter(|typed| !typed.delay.is_zero()) {
            let _ = writeln!(text, "delay_s = {}", typed.delay.as_secs_f64());
        }
        text
    }

    /// Returns a file's path relative to the tracking camera's config.
    fn beside(&self, file: &Path) -> PathBuf {
        let folder = self.tracking_config.parent().unwrap_or(Path::new(""));
        let inside = file.strip_prefix(folder).map(Path::to_owned);
        inside.or_else(|_| std::path::absolute(file)).unwrap_or_else(|_| file.to_owned())
    }

    pub fn json(&self) -> String {
        let (mount, s) = (self.of_bodies(), self.sigmas());
        let angles = PanTiltRoll::of_rotation(&mount.rotation, 0.0);
        let mut used = self.solution.views.iter();
        let view = |pair: &StillPair| {
            let found = pair.views.map(|view| view.is_some());
            let used = if found == [true, true] { used.next() } else { None };
            json!({
                "rows": pair.rows, "found": found, "used": used.is_some_and(|used| used.is_used),
                "nees": used.map(|used| used.squared_distance / 6.0),
            })
        };
        let views: Vec<Value> = self.pairs.iter().map(view).collect();
        let [worst_m, worst_rad] = worst_sigmas(&self.covariance);
        let json = json!({
            "offset_m": mount.translation.as_slice(),
            "rotation_deg": [angles.pan_deg, angles.tilt_deg, angles.roll_deg],
            "orientation_xyzw": mount.orientation_xyzw(),
            "offset_sigma_m": s[..3],
            "rotation_sigma_deg": s[3..],
            "covariance": self.of_bodies_covariance().transpose().as_slice(),
            "worst_sigma_m": worst_m,
            "worst_sigma_deg": worst_rad.to_degrees(),
            "T_tracking_filming": self.mount,
            "excess": self.solution.excess,
            "views": views,
            "verdict": self.verdict.to_string(),
            "reasons": self.reasons,
            "next": self.next.as_ref().map(|next| &next.words),
        });
        format!("{json:#}\n")
    }
}

/// Names a pair, counting from 1.
fn named(pair: &StillPair) -> String {
    match pair.rows {
        [a, b] if a == b => format!("picture {}", a + 1),
        [a, b] => format!("the standstill from picture {} of the first clip and {} of the second on", a + 1, b + 1),
    }
}

/// Describes the pairs in which a camera does not see its stage.
pub(super) fn missing(pairs: &[StillPair]) -> Vec<String> {
    let line = |pair: &StillPair| {
        let who = match pair.views {
            [None, None] => "neither camera finds its stage",
            [None, _] => "the tracking camera does not find its stage",
            [_, None] => "the filming camera does not find its stage",
            _ => return None,
        };
        Some(format!("{}: {who}", named(pair)))
    };
    pairs.iter().filter_map(line).collect()
}

/// Names a rotation about an axis of the tracking camera, and the two other rotations.
pub(super) fn axis_words(axis: &Vector3<f64>) -> (&'static str, &'static str) {
    match axis.abs().imax() {
        0 => ("it was tilted", "panned or rolled"),
        1 => ("it was panned", "tilted or rolled"),
        _ => ("it was rolled", "panned or tilted"),
    }
}
