//! The map of a set: facets, small surfaces that a walk painted, and the file that holds them
//! (C13).
//!
//! A map adds surfaces to a stage and nothing else: each [`Facet`] becomes a [`SurfaceSpec`]. The
//! file is bytes here, little-endian: a mark, a version, the length and the digest of what follows,
//! then the map. A file that was cut or altered is refused.

use std::sync::Arc;

use image::{GrayImage, Luma};
use nalgebra::{Quaternion, SVector, UnitQuaternion, Vector1, Vector2, Vector3};
use thiserror::Error;

use super::shape::{BentShape, ShapeWay, SurfaceShape};
use super::surface::{ReferenceKind, SurfaceError, SurfaceSpec};
use crate::fingerprint;
use crate::geometry::bspline::BicubicSpline;
use crate::geometry::{Body, Camera, Pose, ReferenceCamera, SurfaceFrame};
use crate::light::Transfer;
use crate::light::camera_curve::{Bend, KNOTS};

/// The first bytes of a map file.
const MARK: &[u8; 16] = b"stagepose map\r\n\0";
/// The version of the format; another one is refused.
const VERSION: u32 = 1;
/// Steps of a texture per unit of light; the brightest texel is 255 and some.
pub const LIGHT_STEPS: f32 = 256.0;
/// Number of channels of a texture: grey. Colour is for a later version.
const CHANNELS: u8 = 1;
/// Maximum number of facets: each takes a tenth of a second before the first frame. Raised, a file
/// may take minutes.
const MAX_FACETS: usize = 200;
/// Maximum number of keyframes. Raised, a damaged file may take more memory.
const MAX_KEYFRAMES: usize = 10_000;
/// Maximum number of modes of uncertainty of a facet.
const MAX_WAYS: usize = 256;
/// Maximum length of a name, bytes.
const MAX_NAME: usize = 256;
/// Maximum side of a texture, texels.
const MAX_SIDE: u32 = 8192;
/// Maximum number of spline intervals along a side.
const MAX_INTERVALS: usize = 400;
/// Maximum position, size or height in a file, metres.
const MAX_M: f64 = 10_000.0;
/// Maximum deviation of a quaternion's norm from 1.
const NORM_TOLERANCE: f64 = 1e-9;

/// The map of a set.
#[derive(Debug, Clone, PartialEq)]
pub struct StageMap {
    /// Bend of the curve of the camera that filmed it.
    pub bend: Bend,
    /// `T_body_camera` of the walk's keyframes; at least one.
    pub keyframes: Vec<Pose<Body, Camera>>,
    /// The facets; at least one.
    pub facets: Vec<Facet>,
}

/// A flat piece of the set.
#[derive(Debug, Clone, PartialEq)]
pub struct Facet {
    /// Its name in messages.
    pub name: String,
    /// Width and height, metres.
    pub size_m: [f64; 2],
    /// `T_body_surface`.
    pub pose: Pose<Body, SurfaceFrame>,
    /// Its shape, with the modes of the map's uncertainty.
    pub shape: SurfaceShape,
    /// Its picture.
    pub texture: FacetTexture,
}

/// A picture in linear light.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FacetTexture {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Light of each texel, row by row from the top left, in 256ths of a unit of light.
    pub light: Vec<u16>,
}

/// Why bytes are not a map that can be used.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum MapFileError {
    /// Something else.
    #[error("it is not a map of `stagepose map`")]
    NotAMap,
    /// Another version of the format.
    #[error("its format is version {0}, this program reads version {VERSION}; map the set again (`stagepose map`)")]
    OtherVersion(u32),
    /// Bytes are missing, or too many.
    #[error("it is cut or something was added: {found} bytes follow its head, {wanted} should; copy it again")]
    Length {
        /// Bytes that follow the head.
        found: u64,
        /// Bytes that should.
        wanted: u64,
    },
    /// The digest does not match.
    #[error("it was altered after it was written: its digest does not match; copy it again")]
    Altered,
    /// Values that make no map.
    #[error("it holds {0} that cannot be; map the set again (`stagepose map`)")]
    Impossible(&'static str),
    /// A facet that cannot be tracked.
    #[error("its facet {name}: {reason}; map the set again (`stagepose map`)")]
    Facet {
        /// The facet's name.
        name: String,
        /// What is wrong with it.
        reason: SurfaceError,
    },
}

impl FacetTexture {
    /// Returns the picture as an sRGB one.
    pub fn picture(&self) -> GrayImage {
        let grey = |light: u16| (255.0 * Transfer::Srgb.encoded((f32::from(light) / LIGHT_STEPS / 255.0).min(1.0))).round() as u8;
        GrayImage::from_fn(self.width, self.height, |x, y| Luma([grey(self.light[y as usize * self.width as usize + x as usize])]))
    }
}

impl StageMap {
    /// Returns the facets as surfaces of a stage.
    ///
    /// # Errors
    /// [`MapFileError::Facet`].
    pub fn surfaces(&self) -> Result<Vec<SurfaceSpec>, MapFileError> {
        let Some(first) = self.keyframes.first() else { return Err(MapFileError::Impossible("no keyframes")) };
        // C3: the first keyframe's camera is the reference camera.
        let t_reference_body: Pose<ReferenceCamera, Body> = first.inverse().renamed();
        self.facets
            .iter()
            .map(|facet| {
                let refused = |reason| MapFileError::Facet { name: facet.name.clone(), reason };
                let spec = SurfaceSpec::from_any_artwork(facet.name.clone(), facet.texture.picture(), facet.size_m, facet.pose);
                let kind = ReferenceKind::Facet { pose: t_reference_body * facet.pose };
                Ok(SurfaceSpec { kind, shape: facet.shape.clone(), ..spec.map_err(refused)? })
            })
            .collect()
    }

    /// Returns the bytes of the map's file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut body = Vec::new();
        self.bend.iter().for_each(|v| body.extend(v.to_le_bytes()));
        write_count(&mut body, self.keyframes.len());
        self.keyframes.iter().for_each(|pose| write_pose(&mut body, pose));
        write_count(&mut body, self.facets.len());
        self.facets.iter().for_each(|facet| facet.write(&mut body));
        let mut bytes = MARK.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend((body.len() as u64).to_le_bytes());
        bytes.extend(digest(&body).to_le_bytes());
        bytes.extend(body);
        bytes
    }

    /// Reads the bytes of a map's file.
    ///
    /// # Errors
    /// See [`MapFileError`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MapFileError> {
        let mut head = Reader { left: bytes.strip_prefix(MARK).ok_or(MapFileError::NotAMap)? };
        let version = head.number("a version", u32::from_le_bytes)?;
        if version != VERSION {
            return Err(MapFileError::OtherVersion(version));
        }
        let wanted = head.number("a length", u64::from_le_bytes)?;
        let own = head.number("a digest", u64::from_le_bytes)?;
        let found = head.left.len() as u64;
        if found != wanted {
            return Err(MapFileError::Length { found, wanted });
        }
        if digest(head.left) != own {
            return Err(MapFileError::Altered);
        }
        let mut body = head;
        let mut bend = [0.0; KNOTS];
        for correction in &mut bend {
            *correction =
                Some(body.number("a curve", f32::from_le_bytes)?).filter(|v| v.is_finite()).ok_or(MapFileError::Impossible("a curve"))?;
        }
        let keyframes = (0..body.count(1, MAX_KEYFRAMES, "a number of keyframes")?).map(|_| body.pose()).collect::<Result<_, _>>()?;
        let facets = (0..body.count(1, MAX_FACETS, "a number of facets")?).map(|_| Facet::read(&mut body)).collect::<Result<_, _>>()?;
        if !body.left.is_empty() {
            return Err(MapFileError::Impossible("bytes after its end"));
        }
        Ok(Self { bend, keyframes, facets })
    }
}

impl Facet {
    fn write(&self, body: &mut Vec<u8>) {
        let end = self.name.char_indices().map(|(at, c)| at + c.len_utf8()).take_while(|end| *end <= MAX_NAME).last().unwrap_or(0);
        write_count(body, end);
        body.extend(&self.name.as_bytes()[..end]);
        self.size_m.iter().for_each(|v| body.extend(v.to_le_bytes()));
        write_pose(body, &self.pose);
        match &self.shape {
            SurfaceShape::Flat => body.push(0),
            SurfaceShape::Bent(shape) => {
                body.push(1);
                write_intervals(body, shape.height.intervals());
                write_intervals(body, shape.stretch.intervals());
                write_count(body, shape.ways.len());
                let all = std::iter::once((&shape.height, &shape.stretch)).chain(shape.ways.iter().map(|way| (&way.height, &way.stretch)));
                all.for_each(|(height, stretch)| {
                    height
                        .coefficients()
                        .iter()
                        .flatten()
                        .chain(stretch.coefficients().iter().flatten())
                        .for_each(|v| body.extend(v.to_le_bytes()));
                });
            }
        }
        body.push(CHANNELS);
        body.extend(self.texture.width.to_le_bytes());
        body.extend(self.texture.height.to_le_bytes());
        self.texture.light.iter().for_each(|v| body.extend(v.to_le_bytes()));
    }

    fn read(body: &mut Reader<'_>) -> Result<Self, MapFileError> {
        let length = body.count(0, MAX_NAME, "a name")?;
        let name = String::from_utf8(body.take(length, "a name")?.to_vec()).map_err(|_| MapFileError::Impossible("a name"))?;
        let size_m = [body.metres("a size")?, body.metres("a size")?];
        if size_m.iter().any(|side| *side <= 0.0) {
            return Err(MapFileError::Impossible("a size"));
        }
        let pose = body.pose()?;
        let shape = match body.number("a shape", u8::from_le_bytes)? {
            0 => SurfaceShape::Flat,
            1 => SurfaceShape::Bent(Arc::new(body.shape(size_m)?)),
            _ => return Err(MapFileError::Impossible("a shape")),
        };
        if body.number("a texture", u8::from_le_bytes)? != CHANNELS {
            return Err(MapFileError::Impossible("a texture"));
        }
        let [width, height] = [body.number("a texture", u32::from_le_bytes)?, body.number("a texture", u32::from_le_bytes)?];
        if [width, height].iter().any(|side| !(1..=MAX_SIDE).contains(side)) {
            return Err(MapFileError::Impossible("a texture"));
        }
        let light = body.take(2 * width as usize * height as usize, "a texture")?;
        let light = light.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect();
        Ok(Self { name, size_m, pose, shape, texture: FacetTexture { width, height, light } })
    }
}

fn digest(bytes: &[u8]) -> u64 {
    fingerprint::fnv1a(fingerprint::START, bytes)
}

fn write_count(body: &mut Vec<u8>, count: usize) {
    body.extend((count as u32).to_le_bytes());
}

fn write_intervals(body: &mut Vec<u8>, intervals: [usize; 2]) {
    intervals.iter().for_each(|n| write_count(body, *n));
}

fn write_pose<A, B>(body: &mut Vec<u8>, pose: &Pose<A, B>) {
    pose.translation.iter().chain(pose.rotation.coords.iter()).for_each(|v| body.extend(v.to_le_bytes()));
}

/// Reads values one after the other.
struct Reader<'a> {
    left: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize, what: &'static str) -> Result<&'a [u8], MapFileError> {
        let (taken, left) = self.left.split_at_checked(count).ok_or(MapFileError::Impossible(what))?;
        self.left = left;
        Ok(taken)
    }

    fn number<T, const N: usize>(&mut self, what: &'static str, of: fn([u8; N]) -> T) -> Result<T, MapFileError> {
        let (taken, left) = self.left.split_first_chunk().ok_or(MapFileError::Impossible(what))?;
        self.left = left;
        Ok(of(*taken))
    }

    fn count(&mut self, least: usize, most: usize, what: &'static str) -> Result<usize, MapFileError> {
        let count = self.number(what, u32::from_le_bytes)? as usize;
        Some(count).filter(|n| (least..=most).contains(n)).ok_or(MapFileError::Impossible(what))
    }

    fn metres(&mut self, what: &'static str) -> Result<f64, MapFileError> {
        Some(self.number(what, f64::from_le_bytes)?).filter(|v| v.abs() <= MAX_M).ok_or(MapFileError::Impossible(what))
    }

    fn pose<A, B>(&mut self) -> Result<Pose<A, B>, MapFileError> {
        let what = "a pose";
        let translation = Vector3::new(self.metres(what)?, self.metres(what)?, self.metres(what)?);
        let mut rotation = Quaternion::identity();
        for v in rotation.coords.iter_mut() {
            *v = self.number(what, f64::from_le_bytes)?;
        }
        if (rotation.norm() - 1.0).abs() >= NORM_TOLERANCE || !rotation.norm().is_finite() {
            return Err(MapFileError::Impossible(what));
        }
        Ok(Pose::new(UnitQuaternion::new_unchecked(rotation), translation))
    }

    fn shape(&mut self, size_m: [f64; 2]) -> Result<BentShape, MapFileError> {
        let what = "a shape";
        let mut intervals =
            || -> Result<[usize; 2], MapFileError> { Ok([self.count(1, MAX_INTERVALS, what)?, self.count(1, MAX_INTERVALS, what)?]) };
        let (of_height, of_stretch) = (intervals()?, intervals()?);
        let ways = self.count(0, MAX_WAYS, what)?;
        let height = self.spline(of_height, size_m, Vector1::from)?;
        let stretch = self.spline(of_stretch, size_m, Vector2::from)?;
        let mut way = || {
            Ok(ShapeWay {
                height: self.spline(of_height, size_m, Vector1::from)?,
                stretch: self.spline(of_stretch, size_m, Vector2::from)?,
            })
        };
        Ok(BentShape { height, stretch, ways: (0..ways).map(|_| way()).collect::<Result<_, MapFileError>>()? })
    }

    fn spline<const N: usize>(
        &mut self,
        intervals: [usize; 2],
        size_m: [f64; 2],
        of: fn([f64; N]) -> SVector<f64, N>,
    ) -> Result<BicubicSpline<N>, MapFileError> {
        let what = "a shape";
        let count = (intervals[0] + 3) * (intervals[1] + 3);
        if self.left.len() < 8 * N * count {
            return Err(MapFileError::Impossible(what));
        }
        let mut coefficients = Vec::with_capacity(count);
        for _ in 0..count {
            let mut values = [0.0; N];
            for v in &mut values {
                *v = self.metres(what)?;
            }
            coefficients.push(of(values));
        }
        BicubicSpline::from_coefficients(intervals, size_m, coefficients).ok_or(MapFileError::Impossible(what))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map() -> StageMap {
        let size_m = [0.4, 0.3];
        let mut height = BicubicSpline::<1>::zero([2, 3], size_m);
        let mut stretch = BicubicSpline::<2>::zero([1, 2], size_m);
        height.coefficients_mut().iter_mut().enumerate().for_each(|(k, c)| c.x = 1e-3 * (k as f64).sin());
        stretch.coefficients_mut().iter_mut().enumerate().for_each(|(k, c)| c.y = 1e-4 * k as f64);
        let way = ShapeWay { height: height.clone(), stretch: stretch.clone() };
        let shape = SurfaceShape::Bent(Arc::new(BentShape { height, stretch, ways: vec![way.clone(), way] }));
        let turned = |k: f64| UnitQuaternion::from_euler_angles(0.1 * k, -0.3, 0.02);
        let texture = FacetTexture { width: 70, height: 64, light: (0..70 * 64).map(|n| (n * 14) as u16).collect() };
        let facet = |k: usize, shape| Facet {
            name: format!("facet {k}"),
            size_m,
            pose: Pose::new(turned(k as f64), Vector3::new(0.5 * k as f64, 2.0, -1.0)),
            shape,
            texture: texture.clone(),
        };
        StageMap {
            bend: [0.5, 1.0, 0.0, -2.0, 0.0, 0.25, 0.0],
            keyframes: vec![Pose::new(turned(3.0), Vector3::new(0.0, -3.0, 0.2)), Pose::identity()],
            facets: vec![facet(0, SurfaceShape::Flat), facet(1, shape)],
        }
    }

    #[test]
    fn a_written_map_reads_back_bit_for_bit() {
        let map = map();
        let bytes = map.to_bytes();
        assert_eq!(StageMap::from_bytes(&bytes), Ok(map.clone()));
        assert_eq!(StageMap::from_bytes(&bytes).unwrap().to_bytes(), bytes);
    }

    #[test]
    fn facets_become_surfaces_seen_from_the_first_keyframe() {
        let map = map();
        let surfaces = map.surfaces().unwrap();
        assert_eq!(surfaces.len(), 2);
        let ReferenceKind::Facet { pose } = &surfaces[1].kind else { panic!("it is a facet") };
        let seen = map.keyframes[0].inverse().renamed::<ReferenceCamera, Body>() * map.facets[1].pose;
        assert!((pose.matrix() - seen.matrix()).norm() < 1e-12);
        // Light of a quarter of full, 64 units, is a grey of 137 in sRGB.
        let quarter = FacetTexture { width: 1, height: 1, light: vec![64 * 256] };
        assert_eq!(quarter.picture().as_raw(), &[137]);
    }

    #[test]
    fn cut_altered_and_foreign_files_are_refused_each_with_its_reason() {
        let bytes = map().to_bytes();
        let read = |bytes: &[u8]| StageMap::from_bytes(bytes).unwrap_err();
        assert_eq!(read(b""), MapFileError::NotAMap);
        assert_eq!(read(b"PNG"), MapFileError::NotAMap);
        let mut newer = bytes.clone();
        newer[16] = 2;
        assert_eq!(read(&newer), MapFileError::OtherVersion(2));
        for cut in (17..36).chain([bytes.len() - 1, bytes.len() / 2]) {
            assert!(matches!(read(&bytes[..cut]), MapFileError::Length { .. } | MapFileError::Impossible(_)), "{cut}");
        }
        assert!(matches!(read(&[&bytes[..], b"x"].concat()), MapFileError::Length { .. }));
        for place in (36..bytes.len()).step_by(97) {
            let mut altered = bytes.clone();
            altered[place] ^= 0x40;
            assert_eq!(read(&altered), MapFileError::Altered, "{place}");
        }
    }

    /// What the limits must let pass, each at its edge.
    #[test]
    fn a_map_at_the_limits_is_read() {
        let mut map = map();
        let SurfaceShape::Bent(bent) = &map.facets[1].shape else { panic!("it is bent") };
        let mut shape = (**bent).clone();
        shape.ways = vec![shape.ways[0].clone(); MAX_WAYS];
        map.facets[1].shape = SurfaceShape::Bent(Arc::new(shape));
        map.facets[0].name = "n".repeat(MAX_NAME);
        map.facets[0].size_m = [MAX_M, 0.1];
        map.facets[0].texture = FacetTexture { width: MAX_SIDE, height: 1, light: vec![7; MAX_SIDE as usize] };
        map.facets.resize(MAX_FACETS, map.facets[0].clone());
        map.keyframes.resize(MAX_KEYFRAMES, map.keyframes[0]);
        assert_eq!(StageMap::from_bytes(&map.to_bytes()), Ok(map.clone()));
        map.facets.push(map.facets[0].clone());
        assert_eq!(StageMap::from_bytes(&map.to_bytes()), Err(MapFileError::Impossible("a number of facets")));
    }

    #[test]
    fn impossible_values_are_refused_even_with_a_right_digest() {
        let bytes = map().to_bytes();
        let (head, body) = bytes.split_at(36);
        for place in (0..600).chain((600..body.len()).step_by(331)) {
            for value in [0x00, 0x7f, 0xff] {
                let mut other = body.to_vec();
                other[place] = value;
                let whole = [&head[..28], &digest(&other).to_le_bytes(), &other].concat();
                // Nothing panics, and what is read can be written again.
                if let Ok(map) = StageMap::from_bytes(&whole) {
                    assert_eq!(map.to_bytes(), whole, "{place}");
                    let _ = map.surfaces();
                }
            }
        }
    }
}
