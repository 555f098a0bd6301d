//! Reads the stage and the objects: every surface with its picture, size and place, all checked.

use std::collections::HashSet;
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, GrayImage};
use nalgebra::Vector2;
use toml::Spanned;

use super::as_typed;
use super::lens::LensSource;
use super::origin::Origin;
use super::rotation::Turned;
use super::transfer::transfer;
use super::values::Section;
use super::{ConfigError, Problem, stage_origin};
use crate::camera::{CameraModel, Pixel, plausible};
use crate::capture::orientation_words;
use crate::geometry::{Body, Pose, SurfaceFrame};
use crate::light::Transfer;
use crate::track::{BodySpec, SurfaceDoubt, SurfaceError, SurfaceShape, SurfaceSpec};

/// The stage's name among the bodies, which no object may have.
const STAGE: &str = "stage";
/// Allowed side lengths of a surface, metres: from a stamp to a stadium. Values beyond are slips of
/// the unit or the decimal point. Widened, such slips pass; `check` doubts a narrower range.
const SURFACE_SIDE_M: std::ops::RangeInclusive<f64> = 1e-3..=1e3;

/// Maximum number of surfaces of the stage and all objects together. Each takes a tenth of a second
/// and about 5 MB before the first frame, more with a large picture. Raised, a config may take
/// minutes and gigabytes; lowered, large sets do not fit.
pub(super) const MAX_SURFACES: usize = 100;

/// Refuses more surfaces than can be tracked, before reading their pictures.
pub(super) fn refuse_many(origin: &Origin<'_>, typed: &as_typed::Config) -> Result<(), ConfigError> {
    let of_stage = typed.stage.iter().flat_map(|stage| &stage.get_ref().surface).map(|surface| ("[[stage.surface]]", surface));
    let of_objects = typed.object.iter().flat_map(|object| &object.get_ref().surface).map(|surface| ("[[object.surface]]", surface));
    let mut all = of_stage.chain(of_objects).skip(MAX_SURFACES);
    let Some((section, first)) = all.next() else { return Ok(()) };
    let value = format!("{} surfaces", MAX_SURFACES + 1 + all.count());
    let wanted = "at most 100 surfaces of the stage and all objects together; leave out those that the camera sees least";
    Err(origin.value(section, "surface", &first.span(), Problem::Range { value, wanted }))
}

/// Reads the surfaces of one config: their common input, and the notes they produce.
pub(super) struct BodyReader<'a> {
    pub origin: &'a Origin<'a>,
    pub camera: CameraModel,
    pub lens: &'a LensSource,
    /// How the camera encodes light, if configured.
    pub transfer: Option<Transfer>,
    pub notes: &'a mut Vec<String>,
    /// Graver than notes: parts of the config that are left out, unusual numbers.
    pub warnings: &'a mut Vec<String>,
    /// The first surface's pose in the config, before `[stage] origin` moved it.
    pub first_as_typed: Pose<Body, SurfaceFrame>,
}

impl BodyReader<'_> {
    /// Reads the stage; one without surfaces is refused if it is needed.
    pub fn stage(&mut self, typed: Option<&Spanned<as_typed::Stage>>, is_needed: bool) -> Result<BodySpec, ConfigError> {
        let surfaces = typed.map_or(&[][..], |stage| &stage.get_ref().surface);
        let facets = typed.and_then(|stage| stage.get_ref().map.as_ref()).map(|map| self.facets(map)).transpose()?.unwrap_or_default();
        if surfaces.is_empty() && facets.is_empty() {
            let hint = "a section [[stage.surface]] with an `image` or a `photo` of the stage and its `size_m`";
            let missing = || self.origin.missing("the config".to_owned(), "stage.surface", hint);
            return if is_needed { Err(missing()) } else { Ok(BodySpec { name: STAGE.to_owned(), surfaces: Vec::new() }) };
        }
        let mut stage = BodySpec { name: STAGE.to_owned(), surfaces: Vec::new() };
        if !surfaces.is_empty() {
            stage.surfaces = self.surfaces(surfaces, "[[stage.surface]]")?;
        }
        self.first_as_typed = stage.surfaces.first().map_or_else(Pose::identity, |first| first.pose);
        if let Some(points) = typed.and_then(|stage| stage.get_ref().origin.as_ref()) {
            if surfaces.is_empty() {
                let problem = "it names points of the first surface, and this stage has a map only, which has its frame; remove it";
                return Err(Section { origin: self.origin, name: "[stage]" }.conflict("origin", points, problem));
            }
            self.notes.extend(stage_origin::place(self.origin, points, &mut stage)?);
        }
        stage.surfaces.extend(facets);
        Ok(stage)
    }

    /// Reads the facets of the stage's map, which has them in the stage frame.
    fn facets(&self, typed: &Spanned<as_typed::MapOfStage>) -> Result<Vec<SurfaceSpec>, ConfigError> {
        let section = Section { origin: self.origin, name: "[stage.map]" };
        match &typed.get_ref().file {
            Some(file) => section.map("file", file),
            None => Err(self.origin.missing(
                self.origin.section_at("[stage.map]", &typed.span()),
                "file",
                "file = \"stage.map\", of `stagepose map`",
            )),
        }
    }

    /// Warns of unusual camera parameters.
    pub fn note_camera(&mut self, name: &str, model: &CameraModel) {
        // Impossible parameters were refused when the file was read.
        let odd = plausible::judge(model).unwrap_or_default();
        self.warnings.extend(odd.into_iter().map(|sentence| format!("{name}: {sentence}")));
    }

    pub fn objects(&mut self, typed: &[Spanned<as_typed::Object>]) -> Result<Vec<BodySpec>, ConfigError> {
        let mut names = HashSet::from([STAGE.to_owned()]);
        typed.iter().map(|object| self.object(object, &mut names)).collect()
    }

    fn object(&mut self, typed: &Spanned<as_typed::Object>, names: &mut HashSet<String>) -> Result<BodySpec, ConfigError> {
        let section = Section { origin: self.origin, name: "[[object]]" };
        let here = || self.origin.section_at("[[object]]", &typed.span());
        let object = typed.get_ref();
        let Some(typed_name) = &object.name else {
            return Err(self.origin.missing(here(), "name", "a name for the records, such as name = \"prop\""));
        };
        let name = section.text("name", typed_name, "a name for the records, such as \"prop\"")?;
        if !names.insert(name.clone()) {
            return Err(section.refuse("name", &typed_name.span(), Problem::DuplicateName(name)));
        }
        if object.surface.is_empty() {
            return Err(self.origin.missing(here(), "surface", "a section [[object.surface]] below it, with its picture and size"));
        }
        Ok(BodySpec { name, surfaces: self.surfaces(&object.surface, "[[object.surface]]")? })
    }

    /// Reads all surfaces of a body. A surface without texture is left out, with a warning, if
    /// others have some.
    fn surfaces(&mut self, typed: &[Spanned<as_typed::Surface>], name: &'static str) -> Result<Vec<SurfaceSpec>, ConfigError> {
        let read = typed.iter().map(|surface| self.surface(surface, name)).collect::<Result<Vec<_>, _>>()?;
        let has_texture = read.iter().any(|surface| surface.refusal.is_none());
        let mut surfaces = Vec::with_capacity(read.len());
        for SurfaceRead { spec, refusal } in read {
            match refusal {
                None => surfaces.push(spec),
                Some(refusal) if !has_texture => return Err(refusal),
                Some(_) => {
                    self.warnings.push(format!(
                        "{}: it has too little texture to be found and is left out; the other surfaces are tracked. Take its section out, or \
                         give a picture with more detail",
                        spec.name
                    ));
                    surfaces.push(spec.left_out());
                }
            }
        }
        Ok(surfaces)
    }

    fn surface(&mut self, typed: &Spanned<as_typed::Surface>, name: &'static str) -> Result<SurfaceRead, ConfigError> {
        let section = Section { origin: self.origin, name };
        let here = || self.origin.section_at(name, &typed.span());
        let surface = typed.get_ref();
        let Some(typed_size) = &surface.size_m else {
            let hint = "the width and height between the picture's outer edges in metres, such as size_m = [4.0, 3.0]";
            return Err(self.origin.missing(here(), "size_m", hint));
        };
        let size_m = typed_size.get_ref().values();
        if !size_m.iter().all(|v| *v > 0.0) {
            let wanted = "a width and a height above 0 metres";
            return Err(section.refuse("size_m", &typed_size.span(), Problem::Range { value: format!("{size_m:?}"), wanted }));
        }
        if !size_m.iter().all(|v| SURFACE_SIDE_M.contains(v)) {
            let wanted = "a width and a height from 0.001 to 1000 metres: 4000 millimetres are 4.0";
            return Err(section.refuse("size_m", &typed_size.span(), Problem::Range { value: format!("{size_m:?}"), wanted }));
        }
        let rotation = Turned::Surface.typed(&section, surface.orientation_xyzw.as_ref(), surface.rotation_deg.as_ref())?;
        let pose = Pose::new(rotation, section.position("position_m", surface.position_m.as_ref())?);
        let placed = Placed { size_m, size_span: typed_size.span(), pose };
        let mut read = match (&surface.image, &surface.photo) {
            (Some(image), None) => self.artwork(&section, surface, image, &placed),
            (None, Some(photo)) => self.photograph(&section, surface, photo, &placed, here()),
            (Some(_), Some(photo)) => {
                Err(section.conflict("photo", photo, "a surface has either `image` or `photo`, this one has both; remove one"))
            }
            (None, None) => Err(self.origin.missing(here(), "image", "image = \"artwork.png\", or photo = \"photo.jpg\" with corners_px")),
        }?;
        read.spec.doubt = doubt(&section, surface, read.spec.doubt)?;
        // A photograph is most likely one of the camera's own.
        let usual = self.transfer.filter(|_| surface.photo.is_some()).unwrap_or_default();
        read.spec.transfer = transfer(&section, surface.transfer.as_ref())?.unwrap_or(usual);
        Ok(read)
    }

    fn artwork(
        &mut self,
        section: &Section<'_>,
        typed: &as_typed::Surface,
        image: &Spanned<String>,
        placed: &Placed,
    ) -> Result<SurfaceRead, ConfigError> {
        if let Some(corners) = &typed.corners_px {
            return Err(section.conflict("corners_px", corners, "it belongs to `photo`, but this surface has an `image`; remove it"));
        }
        if let Some(calibration) = &typed.photo_calibration {
            let problem = "it belongs to `photo`, but this surface has an `image`; remove it";
            return Err(section.conflict("photo_calibration", calibration, problem));
        }
        if let Some(sigma) = &typed.corner_sigma_px {
            return Err(section.conflict("corner_sigma_px", sigma, "it belongs to `photo`, but this surface has an `image`; remove it"));
        }
        let (picture, orientation) = section.picture("image", image)?;
        let picture = self.upright(image.get_ref(), picture, orientation);
        self.note_pixel_shape(image.get_ref(), &picture, placed.size_m);
        let refused = |e| self.refused(section, "image", image, typed, placed, e);
        let mut spec = SurfaceSpec::from_any_artwork(file_name(image.get_ref()), picture, placed.size_m, placed.pose).map_err(refused)?;
        spec.shape = shape(section, typed, &spec)?;
        Ok(SurfaceRead { refusal: spec.check_texture().map_err(refused).err(), spec })
    }

    fn photograph(
        &mut self,
        section: &Section<'_>,
        typed: &as_typed::Surface,
        photo: &Spanned<String>,
        placed: &Placed,
        here: String,
    ) -> Result<SurfaceRead, ConfigError> {
        let Some(typed_corners) = &typed.corners_px else {
            let hint =
                "the surface's corners in the photograph, clockwise from the top left: corners_px = [[u, v], [u, v], [u, v], [u, v]]";
            return Err(self.origin.missing(here, "corners_px", hint));
        };
        let corners = typed_corners.get_ref().0.map(|corner| corner.values());
        if !corners.iter().flatten().all(|v| v.is_finite()) {
            let wanted = "four corners [u, v] in pixels";
            return Err(section.refuse("corners_px", &typed_corners.span(), Problem::Range { value: format!("{corners:?}"), wanted }));
        }
        let picture = section.raw_picture("photo", photo, "corners_px and its calibration count")?;
        let camera = self.photo_camera(section, typed, photo.get_ref(), &picture)?;
        let corners = corners.map(|[u, v]| Pixel(Vector2::new(u, v)));
        let refused = |e| self.refused(section, "photo", photo, typed, placed, e);
        let mut spec = SurfaceSpec::from_any_photograph(file_name(photo.get_ref()), &picture, corners, camera, placed.size_m, placed.pose)
            .map_err(refused)?;
        spec.shape = shape(section, typed, &spec)?;
        Ok(SurfaceRead { refusal: spec.check_texture().map_err(refused).err(), spec })
    }

    /// Returns the camera that took a photograph: its own calibration, or the stage camera if the
    /// size is equal, or a guess.
    fn photo_camera(
        &mut self,
        section: &Section<'_>,
        typed: &as_typed::Surface,
        name: &str,
        photo: &GrayImage,
    ) -> Result<CameraModel, ConfigError> {
        let (width, height) = photo.dimensions();
        if let Some(file) = &typed.photo_calibration {
            let model = section.calibration("photo_calibration", file)?.model;
            self.note_camera(file.get_ref(), &model);
            if (model.width(), model.height()) == (width, height) {
                return Ok(model);
            }
            let refuse = |e| section.refuse("photo_calibration", &file.span(), Problem::Camera(e));
            let scaled = model.scaled_to(width, height).map_err(refuse)?;
            let from = format!("{} x {}", model.width(), model.height());
            self.notes.push(format!("{name}: its calibration for {from} pixels is scaled to the photograph's {width} x {height}"));
            return Ok(scaled);
        }
        if let LensSource::Guess(guess, size) = self.lens
            && size.is_none_or(|size| size == (width, height))
        {
            self.notes.push(format!("{name}: no photo_calibration; the guess for the camera's own lens is used"));
            return guess.camera(width, height).map_err(|e| section.refuse("photo", &(0..0), Problem::Camera(e)));
        }
        if (self.camera.width(), self.camera.height()) == (width, height) {
            self.notes
                .push(format!("{name}: no photo_calibration; the photograph has the camera's size, so the camera's calibration is used"));
            return Ok(self.camera);
        }
        let focal = f64::from(width.max(height));
        self.notes.push(format!(
            "{name}: no photo_calibration, and its size is not the camera's: no distortion and a focal length of {focal} pixels are \
             assumed; give photo_calibration if the photograph was taken with a wide lens"
        ));
        let (cx, cy) = ((f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0);
        let refuse = |e| section.refuse("photo", &(0..0), Problem::Camera(e));
        CameraModel::pinhole(width, height, focal, focal, cx, cy).map_err(refuse)
    }

    /// Applies the EXIF rotation to artwork, in which nobody has measured pixels.
    fn upright(&mut self, name: &str, picture: GrayImage, orientation: Orientation) -> GrayImage {
        let Some(words) = orientation_words(orientation) else { return picture };
        self.notes.push(format!("{name}: it is {words} before use, as its file says (EXIF)"));
        let mut shown = DynamicImage::ImageLuma8(picture);
        shown.apply_orientation(orientation);
        shown.into_luma8()
    }

    /// Notes non-square pixels: they reveal a wrong size, the most likely mistake.
    fn note_pixel_shape(&mut self, name: &str, picture: &GrayImage, [width_m, height_m]: [f64; 2]) {
        let shape = (width_m / f64::from(picture.width())) / (height_m / f64::from(picture.height()));
        if !(0.98..=1.02).contains(&shape) {
            self.notes.push(format!("{name}: at this size_m its pixels are {shape:.3} times as wide as high; check size_m"));
        }
    }

    /// Attaches a surface's refusal to the key it concerns.
    fn refused(
        &self,
        section: &Section<'_>,
        picture_key: &str,
        picture: &Spanned<String>,
        typed: &as_typed::Surface,
        placed: &Placed,
        reason: SurfaceError,
    ) -> ConfigError {
        let corners = typed.corners_px.as_ref();
        let (key, span) = match (&reason, corners) {
            (SurfaceError::Size(_), _) => ("size_m", placed.size_span.clone()),
            (SurfaceError::Corners(_) | SurfaceError::CornerOutside { .. }, Some(corners)) => ("corners_px", corners.span()),
            _ => (picture_key, picture.span()),
        };
        section.refuse(key, &span, Problem::Surface { file: self.origin.beside(picture.get_ref()), reason })
    }
}

/// A surface as read, and why it cannot be tracked if its picture lacks texture.
struct SurfaceRead {
    spec: SurfaceSpec,
    refusal: Option<ConfigError>,
}

/// A surface's place and size.
struct Placed {
    size_m: [f64; 2],
    size_span: std::ops::Range<usize>,
    pose: Pose<Body, SurfaceFrame>,
}

/// Returns a surface's shape, by default flat.
fn shape(section: &Section<'_>, typed: &as_typed::Surface, spec: &SurfaceSpec) -> Result<SurfaceShape, ConfigError> {
    typed.shape.as_ref().map_or(Ok(SurfaceShape::Flat), |file| section.shape("shape", file, spec))
}

/// Returns the uncertainty of a surface's place; by default its place is exact.
fn doubt(section: &Section<'_>, typed: &as_typed::Surface, of_picture: SurfaceDoubt) -> Result<SurfaceDoubt, ConfigError> {
    let mut doubt = of_picture;
    doubt.corner_px = section.number(
        "corner_sigma_px",
        typed.corner_sigma_px.as_ref(),
        doubt.corner_px,
        |v| (0.0..=100.0).contains(&v),
        "pixels from 0 to 100",
    )?;
    doubt.position_m =
        section.number("position_sigma_m", typed.position_sigma_m.as_ref(), 0.0, |v| (0.0..=10.0).contains(&v), "metres from 0 to 10")?;
    let degrees = section.number(
        "rotation_sigma_deg",
        typed.rotation_sigma_deg.as_ref(),
        0.0,
        |v| (0.0..=45.0).contains(&v),
        "degrees from 0 to 45",
    )?;
    doubt.rotation_rad = degrees.to_radians();
    Ok(doubt)
}

fn file_name(name: &str) -> String {
    Path::new(name).file_name().map_or_else(|| name.to_owned(), |n| n.to_string_lossy().into_owned())
}
