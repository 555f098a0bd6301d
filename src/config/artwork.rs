//! The surfaces' artwork in colour, for other programs. Tracking uses its grey levels only.

use image::{DynamicImage, Rgb, RgbImage};

use super::as_typed::{Config, Surface};
use super::{ConfigSource, Settings};
use crate::capture::{decode_colours, decode_on_white};
use crate::track::SurfaceSpec;

/// The pictures of all surfaces, upright, in the config's order.
#[derive(Debug, Clone)]
pub struct Artwork {
    /// The stage's.
    pub stage: Vec<DynamicImage>,
    /// The objects', by object.
    pub objects: Vec<Vec<DynamicImage>>,
}

impl Settings {
    /// Returns each surface's artwork as its file has it. Where the file has no plain colours (a
    /// photograph, which is rectified; a picture with transparency), it is grey.
    pub fn artwork(&self) -> Artwork {
        let typed = Config::parse(&self.source.text, &self.file).ok();
        let of_stage = typed.iter().flat_map(|typed| &typed.stage).flat_map(|stage| &stage.get_ref().surface);
        let of_stage: Vec<&Surface> = of_stage.map(|surface| surface.get_ref()).collect();
        let of_objects = typed.iter().flat_map(|typed| &typed.object);
        let of_objects: Vec<Vec<&Surface>> =
            of_objects.map(|object| object.get_ref().surface.iter().map(|surface| surface.get_ref()).collect()).collect();
        let pictures = |specs: &[SurfaceSpec], typed: Option<&Vec<&Surface>>| -> Vec<DynamicImage> {
            let of = |(k, spec)| picture(&self.source, typed.and_then(|typed| typed.get(k)).copied(), spec);
            specs.iter().enumerate().map(of).collect()
        };
        Artwork {
            stage: pictures(&self.stage.surfaces, Some(&of_stage)),
            objects: self.objects.iter().enumerate().map(|(k, object)| pictures(&object.surfaces, of_objects.get(k))).collect(),
        }
    }
}

fn picture(source: &ConfigSource, typed: Option<&Surface>, spec: &SurfaceSpec) -> DynamicImage {
    let image = typed.and_then(|typed| typed.image.as_ref());
    let coloured = image.and_then(|image| colours(source.bytes(image.get_ref()).ok()?));
    let is_same = |picture: &DynamicImage| (picture.width(), picture.height()) == spec.artwork.dimensions();
    coloured.filter(is_same).unwrap_or_else(|| DynamicImage::ImageLuma8(spec.artwork.clone()))
}

fn is_grey(picture: &RgbImage) -> bool {
    picture.pixels().all(|Rgb([r, g, b])| r == g && g == b)
}

/// Decodes a picture as it is to be shown; `None` if it is partly transparent, or has no colours.
fn colours(bytes: &[u8]) -> Option<DynamicImage> {
    let (_, orientation, transparent) = decode_on_white(bytes).ok()?;
    let colours = decode_colours(bytes).filter(|picture| transparent == 0.0 && !is_grey(picture))?;
    let mut picture = DynamicImage::ImageRgb8(colours);
    picture.apply_orientation(orientation);
    Some(picture)
}

#[cfg(test)]
mod tests {
    use image::{Rgba, RgbaImage};

    use super::*;

    #[test]
    fn artwork_keeps_its_colours_unless_it_is_transparent() {
        let folder = tempfile::tempdir().unwrap();
        let level = |x: u32, y: u32| ((x / 7 * 37 + y / 5 * 91) % 251) as u8;
        let red = RgbImage::from_fn(120, 90, |x, y| Rgb([level(x, y), 20, 255 - level(x, y)]));
        red.save(folder.path().join("red.png")).unwrap();
        let clear = RgbaImage::from_fn(120, 90, |x, y| Rgba([level(x, y), 0, 0, if x < 9 { 0 } else { 255 }]));
        clear.save(folder.path().join("clear.png")).unwrap();
        let text = "[camera]\nfov_deg = 60\n[[stage.surface]]\nimage = \"clear.png\"\nsize_m = [4.0, 3.0]\n\
                    [[stage.surface]]\nimage = \"red.png\"\nsize_m = [4.0, 3.0]\n\
                    [[object]]\nname = \"prop\"\n[[object.surface]]\nimage = \"red.png\"\nsize_m = [0.4, 0.3]\n";
        let settings = Settings::from_text(text, &folder.path().join("stage.toml")).unwrap();
        let artwork = settings.artwork();
        assert_eq!(artwork.stage[0], DynamicImage::ImageLuma8(settings.stage.surfaces[0].artwork.clone()));
        assert_eq!(artwork.stage[1], DynamicImage::ImageRgb8(red.clone()));
        assert_eq!(artwork.objects, [[DynamicImage::ImageRgb8(red)]]);
    }
}
