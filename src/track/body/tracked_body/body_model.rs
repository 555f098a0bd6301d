//! How well the model of a body (lens, shapes, places) fits its frames, and what it leaves
//! uncertain.
//!
//! [`BodyModel::fit`] measures the residual displacements of a verified pose's anchors.
//! [`BodyModel::study`] then names the part of the model that frames contradict. Neither moves a
//! pose: they only add covariance and report.

use nalgebra::{Matrix6, Vector6};
use tracing::debug;

use crate::camera::CameraModel;
use crate::geometry::covariance::covariance_of_inverse;
use crate::track::body::pose_anchors::PoseAnchors;
use crate::track::body::tuning::TUNING;
use crate::track::model_error::field_error::{FieldSize, ModelErrorBuffers, blended, model_error};
use crate::track::model_error::focal_clue::{FocalClue, RowDisplacement, focal_clue, is_suspect};
use crate::track::model_error::focal_step::Jump;
use crate::track::model_error::misfit::{Misfit, ModelNews, ModelReport};
use crate::track::model_error::model_study::StudiedFrame;
use crate::track::model_error::model_watch::ModelWatch;
use crate::track::model_error::shape_doubt::ShapeDoubt;
use crate::track::model_error::surface_doubt::covariance_by_surfaces;
use crate::track::model_error::tile_residuals::TileResiduals;
use crate::track::patches::fitted_anchor::FittedAnchor;
use crate::track::patches::row_motion::RowMotion;
use crate::track::patches::verify::{SilentSearch, Verified, View, search_silent};
use crate::track::scene::reference::PreparedBody;

/// What residual tile displacements imply about the model.
#[derive(Debug, Clone, Copy)]
pub struct ModelFit {
    /// Root mean square of the displacements, pixels.
    pub rms_px: f64,
    /// Covariance of [δp, δθ] of `T_body_camera`, body axes, assuming that all misfit is one smooth
    /// field and that the pose rests on this frame alone; `None` if the misfit is within the noise.
    pub at_most: Option<Matrix6<f64>>,
    /// What they imply about the focal length; `None` if that explains nothing and was not asked
    /// for.
    pub focal: Option<FocalClue>,
    /// The change in log focal length that would explain a jump of the pose; `None` if it did not
    /// jump.
    pub step: Option<f64>,
}

/// A verified pose of a body, and what it rests on.
#[derive(Clone, Copy)]
pub struct Observed<'a> {
    /// The body.
    pub body: &'a PreparedBody,
    /// The anchors of the pose.
    pub anchors: &'a PoseAnchors,
    /// The pose.
    pub verified: &'a Verified,
    /// The lens.
    pub camera: &'a CameraModel,
}

/// Whose model is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// The stage's: a lens error spans the picture, and the stage shows it.
    Picture,
    /// An object's: its model error is no larger than the object.
    Object,
}

/// The fit of a body's model over its frames; keeps its buffers between frames.
pub struct BodyModel {
    residuals: TileResiduals,
    buffers: ModelErrorBuffers,
    field_size: FieldSize,
    /// Covariance of [δp, δθ] of `T_body_camera`, body axes, of the last fitted pose, due to
    /// misfit.
    by_misfit: Matrix6<f64>,
    shape_doubt: ShapeDoubt,
    jump: Jump,
    watch: ModelWatch,
    silent: SilentSearch,
    /// Anchors of the frame under study, and their residuals.
    studied: Vec<FittedAnchor>,
    study_residuals: TileResiduals,
}

impl BodyModel {
    /// Creates the model of a body with at most so many patches per frame.
    pub fn new(body: &PreparedBody, max_patches: usize) -> Self {
        Self {
            residuals: TileResiduals::default(),
            buffers: ModelErrorBuffers::with_capacity(max_patches),
            field_size: FieldSize::default(),
            by_misfit: Matrix6::zeros(),
            shape_doubt: ShapeDoubt::of(&body.surfaces),
            jump: Jump::default(),
            watch: ModelWatch::new(body),
            silent: SilentSearch::default(),
            studied: Vec::with_capacity(max_patches),
            study_residuals: TileResiduals::default(),
        }
    }

    /// Measures the residual displacements of a verified pose's anchors and updates the covariance
    /// by misfit; `None` if there are too few anchors. `asks_focal`: estimate the focal length in
    /// any case.
    pub fn fit(&mut self, observed: &Observed, rows: &RowMotion, asks_focal: bool, extent: Extent) -> Option<ModelFit> {
        let Observed { body, anchors, verified, camera } = *observed;
        let t_camera_body = verified.t_camera_body();
        let Self { residuals, buffers, field_size, by_misfit, .. } = self;
        residuals.take(&t_camera_body, camera, anchors.all())?;
        let is_stage = extent == Extent::Picture;
        let field_px = if is_stage { f64::from(camera.width()) } else { residuals.extent_px() };
        let error = model_error(&t_camera_body, field_px, residuals, buffers);
        // An object with few tiles cannot separate model error from noise: all of it counts as a
        // field.
        let tells = is_stage || residuals.weight() > TUNING.min_model_error_tiles;
        let of_frame = error.map_or(Matrix6::zeros(), |e| if tells { field_size.take(&e) } else { e.at_most() });
        let noise = error.map_or(1.0, |e| e.noise);
        *by_misfit = blended(&t_camera_body, residuals, &verified.covariance, &of_frame, by_misfit).unwrap_or(of_frame);
        let asks_focal = asks_focal || residuals.is_misfit() || is_suspect(residuals);
        let step = self.jump.step(&t_camera_body, rows, residuals);
        let rows = RowDisplacement::new(camera, rows, &t_camera_body);
        let focal = if asks_focal || step.is_some() { focal_clue(residuals, &t_camera_body, body, anchors.all(), &rows) } else { None };
        let fit = ModelFit { rms_px: residuals.rms_px(), at_most: error.map(|e| e.at_most()), focal, step };
        debug!(body = %body.name, rms_px = fit.rms_px, doubts = error.is_some(), noise, focal = ?fit.focal, step, "model");
        Some(fit)
    }

    /// Forgets the misfit: the next verified pose does not rest on earlier frames.
    pub fn forget_misfit(&mut self) {
        (self.by_misfit, self.field_size) = (Matrix6::zeros(), FieldSize::default());
    }

    /// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, due to misfit, of the last
    /// pose passed to [`fit`](Self::fit); zero if everything fits.
    pub fn covariance_by_misfit(&self) -> Matrix6<f64> {
        self.by_misfit
    }

    /// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, of a verified pose due to
    /// doubt about the surfaces' shapes and places; `None` without such doubt.
    pub fn covariance_by_shape(&self, observed: &Observed) -> Option<Matrix6<f64>> {
        let Observed { body, anchors, verified, camera } = *observed;
        self.shape_doubt.covariance(&verified.pose, camera, &body.surfaces, anchors.fitting())
    }

    /// Like [`covariance_by_shape`](Self::covariance_by_shape), due to the configured uncertainty
    /// of corners and places.
    pub fn covariance_by_surfaces(&self, observed: &Observed) -> Option<Matrix6<f64>> {
        let Observed { body, anchors, verified, camera } = *observed;
        covariance_by_surfaces(&verified.pose, camera, &body.surfaces, anchors.fitting())
    }

    /// Returns the covariance of [δp, δθ] of `T_body_camera`, body axes, of the last pose passed to
    /// [`fit`](Self::fit), if the log focal length has this sigma. `distance_m`: to the nearest
    /// surface.
    pub fn covariance_by_focal(&self, verified: &Verified, sigma: f64, distance_m: f64) -> Option<Matrix6<f64>> {
        let step = self.residuals.pose_by_focal()? * sigma;
        let linear = covariance_of_inverse(&verified.t_camera_body(), &(step * step.transpose()));
        // The linear step is wrong by the square of sigma, in every direction.
        let (turn, shift) = (sigma.powi(2), sigma.powi(2) * distance_m);
        Some(linear + Matrix6::from_diagonal(&Vector6::new(shift, shift, shift, turn, turn, turn).map(|off| off.powi(2))))
    }

    /// Whether this frame is to be studied. `is_lens_right`: otherwise the misfit is due to a moved
    /// lens, not to the model.
    pub fn is_study_due(&mut self, is_lens_right: bool) -> bool {
        self.watch.is_due(is_lens_right)
    }

    /// Studies which part of the model the frame of a verified pose contradicts. Returns a part
    /// that frames have contradicted for some time. `distance_m`: to the nearest surface.
    pub fn study(&mut self, observed: &Observed, view: &View, distance_m: f64) -> Option<ModelNews> {
        let Observed { body, anchors, verified, .. } = *observed;
        let t_camera_body = verified.t_camera_body();
        let Self { studied, residuals, study_residuals, watch, buffers, silent, .. } = self;
        let aligned = anchors.all();
        search_silent(body, &t_camera_body, view, aligned, silent);
        let view = &view.full;
        if watch.is_thorough() {
            let doubt_m2 = model_error(&t_camera_body, f64::from(view.camera.width()), residuals, buffers);
            let doubt_m2 = doubt_m2.map_or(0.0, |error| error.covariance().fixed_view::<3, 3>(0, 0).trace());
            watch.doubt(&verified.pose, doubt_m2, distance_m);
        }
        if !watch.is_thorough() && silent.found.is_empty() && !residuals.is_misfit() {
            return None;
        }
        let is_searched = |surface: u32| silent.found.iter().any(|a| a.surface == surface);
        studied.clear();
        studied.extend(aligned.iter().filter(|a| !is_searched(a.surface)));
        studied.extend_from_slice(&silent.found);
        study_residuals.take(&t_camera_body, view.camera, studied)?;
        let rows = RowDisplacement::new(view.camera, &view.row_motion, &t_camera_body);
        watch.take(&StudiedFrame { residuals: study_residuals, pose: &t_camera_body, anchors: studied, rows: &rows }, body);
        Some(named(&watch.news(body, view.camera)?, body))
    }

    /// From now on studies every frame, for the final [`ModelWatch::parts`].
    pub fn study_thoroughly(&mut self, body: &PreparedBody) {
        self.watch = ModelWatch::thorough(body);
    }

    /// Returns how well the model fitted the frames since
    /// [`study_thoroughly`](Self::study_thoroughly).
    pub fn report(&self, body: &PreparedBody, camera: &CameraModel) -> ModelReport {
        let parts = self.watch.parts(body, camera);
        ModelReport { parts: parts.iter().map(|m| named(m, body)).collect(), ..self.watch.report() }
    }
}

/// Names the surface of a misfit.
fn named(misfit: &Misfit, body: &PreparedBody) -> ModelNews {
    let surface = misfit.part.surface().and_then(|k| body.surfaces.get(k));
    let is_mapped = surface.is_some_and(|surface| surface.spec.is_facet());
    let name = surface.map(|s| s.spec.name.clone());
    ModelNews { part: misfit.part, surface: name, cost_mm: misfit.cost_mm, is_mapped, is_left_out: false }
}
