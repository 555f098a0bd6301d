//! The stage's meshes with their artwork, for `export` and for a running daemon's
//! `GET /api/v1/scene?format=…`, by the same writers.

#[cfg(feature = "http")]
mod of_daemon;

use std::io::Cursor;

use image::{DynamicImage, ImageFormat};

use crate::config::Settings;
use crate::export::scenery::Scenery;

#[cfg(feature = "http")]
pub(super) use of_daemon::StageOfDaemon;

/// Builds the meshes of a config with their artwork in colour; the pictures' names begin with
/// `stem`.
pub(super) fn scenery_with_artwork(settings: &Settings, stem: &str) -> image::ImageResult<Scenery> {
    let artwork = settings.artwork();
    let png = |picture: &DynamicImage| {
        let mut bytes = Cursor::new(Vec::new());
        picture.write_to(&mut bytes, ImageFormat::Png).map(|()| bytes.into_inner())
    };
    let all = |pictures: &Vec<DynamicImage>| pictures.iter().map(png).collect::<Result<Vec<_>, _>>();
    let objects = artwork.objects.iter().map(all).collect::<Result<Vec<_>, _>>()?;
    Ok(Scenery::new(&settings.stage, &settings.objects, all(&artwork.stage)?, objects, stem))
}
