//! Checks whether a binary glTF file may be served to the page: it must be complete, refer to no
//! other files, and need no decoder that the page lacks. What its meshes look like is left to the
//! page.

use std::fmt::Formatter;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use serde::de::{SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use crate::safe_file;

/// `glTF`, the start of the file (glTF 2.0, 4.4.2).
const MAGIC: u32 = 0x4654_6C67;
/// `JSON`, the type of the first chunk.
const JSON: u32 = 0x4E4F_534A;
/// Maximum size of a model's JSON description, bytes; meshes and pictures follow it. Raised,
/// checking a model takes longer.
const MAX_DESCRIPTION: u32 = 16 << 20;
/// Extensions that need a decoder in WebAssembly, which the page's policy forbids.
const NEED_A_DECODER: [&str; 4] =
    ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression", "KHR_texture_basisu"];

/// Checks a file.
///
/// # Errors
/// Why it is refused, with the fix.
pub fn judge(file: &Path) -> Result<(), String> {
    let mut opened = safe_file::open(file).map_err(|e| format!("the model cannot be read ({e})"))?;
    let length = opened.metadata().map_or(0, |about| about.len());
    let not_whole = || "this is not a complete binary glTF file; export the model as .glb (glTF 2.0) and send all of it".to_owned();
    let mut head = [0; 20];
    opened.read_exact(&mut head).map_err(|_| not_whole())?;
    let word = |k: usize| u32::from_le_bytes([head[k], head[k + 1], head[k + 2], head[k + 3]]);
    if word(0) != MAGIC || u64::from(word(8)) != length || word(16) != JSON || u64::from(word(12)) + 20 > length {
        return Err(not_whole());
    }
    if word(4) != 2 {
        return Err(format!("this is glTF {}; export the model as glTF 2.0", word(4)));
    }
    if word(12) > MAX_DESCRIPTION {
        return Err("the model's description is larger than 16 MB; export it with fewer parts".to_owned());
    }
    let _alone = JUDGING.lock().unwrap_or_else(PoisonError::into_inner);
    let mut text = BufReader::new(opened.take(u64::from(word(12))));
    let begins = text.fill_buf().map_err(|_| not_whole())?.trim_ascii_start().first().copied();
    if begins != Some(b'{') {
        return Err("the model's description is not a JSON object; export it as glTF 2.0, with its version in \"asset\"".to_owned());
    }
    let read: Result<Description, serde_json::Error> = serde_json::from_reader(text);
    let model = read.map_err(|e| format!("the model's description is not glTF JSON ({e}); export it again"))?;
    if !model.asset.version.is_some_and(|version| version.starts_with("2.")) {
        return Err("the model's description has no version 2 in \"asset\"; export it as glTF 2.0".to_owned());
    }
    for (kind, parts) in [("buffers", model.buffers), ("images", model.images)] {
        if parts.has_foreign {
            return Err(format!(
                "its {kind} are in other files, which the page does not load; export the model with everything in one .glb"
            ));
        }
    }
    if let Some(extension) = model.used.packed_with.or(model.required.packed_with) {
        return Err(format!("it is packed with {extension}, which the page cannot unpack; export it without compression"));
    }
    Ok(())
}

/// Held while a model is checked: one at a time.
static JUDGING: Mutex<()> = Mutex::new(());

/// The checked parts of a description. It is parsed as a stream: everything else is skipped, and no
/// list is stored.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Description {
    asset: Asset,
    buffers: Parts,
    images: Parts,
    #[serde(rename = "extensionsUsed")]
    used: Extensions,
    #[serde(rename = "extensionsRequired")]
    required: Extensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Asset {
    version: Option<String>,
}

/// A list of buffers or images.
#[derive(Default)]
struct Parts {
    /// Whether one of them is in another file.
    has_foreign: bool,
}

/// A buffer or an image.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Part {
    uri: Place,
}

/// Where the data of a buffer or an image is.
#[derive(Default, PartialEq)]
enum Place {
    #[default]
    Inside,
    Elsewhere,
}

/// A list of extensions.
#[derive(Default)]
struct Extensions {
    /// The first one that needs a decoder.
    packed_with: Option<&'static str>,
}

impl<'de> Deserialize<'de> for Parts {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct List;
        impl<'de> Visitor<'de> for List {
            type Value = Parts;

            fn expecting(&self, to: &mut Formatter<'_>) -> std::fmt::Result {
                to.write_str("a list of buffers or images")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Parts, A::Error> {
                let mut parts = Parts::default();
                while let Some(part) = list.next_element::<Part>()? {
                    parts.has_foreign |= part.uri == Place::Elsewhere;
                }
                Ok(parts)
            }
        }
        deserializer.deserialize_seq(List)
    }
}

impl<'de> Deserialize<'de> for Place {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Uri;
        impl Visitor<'_> for Uri {
            type Value = Place;

            fn expecting(&self, to: &mut Formatter<'_>) -> std::fmt::Result {
                to.write_str("the URI of a buffer or an image")
            }

            fn visit_str<E: serde::de::Error>(self, uri: &str) -> Result<Place, E> {
                Ok(if uri.starts_with("data:") { Place::Inside } else { Place::Elsewhere })
            }
        }
        deserializer.deserialize_str(Uri)
    }
}

impl<'de> Deserialize<'de> for Extensions {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct List;
        impl<'de> Visitor<'de> for List {
            type Value = Extensions;

            fn expecting(&self, to: &mut Formatter<'_>) -> std::fmt::Result {
                to.write_str("a list of extensions' names")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Extensions, A::Error> {
                let mut extensions = Extensions::default();
                while let Some(name) = list.next_element::<String>()? {
                    let packed_with = NEED_A_DECODER.into_iter().find(|known| *known == name);
                    extensions.packed_with = extensions.packed_with.or(packed_with);
                }
                Ok(extensions)
            }
        }
        deserializer.deserialize_seq(List)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns a binary glTF file with this description.
    pub fn glb(description: &str) -> Vec<u8> {
        let padded = format!("{description}{}", " ".repeat((4 - description.len() % 4) % 4));
        let length = padded.len() as u32;
        let words = [MAGIC, 2, 20 + length, length, JSON];
        [words.iter().flat_map(|word| word.to_le_bytes()).collect(), padded.into_bytes()].concat()
    }

    fn judged(bytes: &[u8]) -> Result<(), String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.glb");
        std::fs::write(&file, bytes).unwrap();
        judge(&file)
    }

    #[test]
    fn complete_self_contained_models_are_accepted() {
        let inside = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4},{"uri":"data:application/octet-stream;base64,AAAA"}]}"#;
        assert_eq!(judged(&glb(inside)), Ok(()));
        for (text, word) in [
            (r#"{"asset":{"version":"2.0"},"buffers":[{"uri":"a.bin"}]}"#, "buffers"),
            (r#"{"asset":{"version":"2.0"},"images":[{"uri":"//evil.example/a.png"}]}"#, "images"),
            (r#"{"asset":{"version":"2.0"},"images":[{"uri":7}]}"#, "image"),
            (r#"{"asset":{"version":"2.0"},"images":[{"uri":"data:,"}],"images":[]}"#, "images"),
            (r#"{"asset":{"version":"2.0"},"extensionsUsed":["KHR_draco_mesh_compression"]}"#, "draco"),
            (r#"{"asset":{"version":"2.0"},"extensionsRequired":["EXT_meshopt_compression"]}"#, "meshopt"),
            (r#"{"asset":{"version":"1.0"}}"#, "version"),
            ("[]", "version"),
            ("{", "JSON"),
        ] {
            let reason = judged(&glb(text)).unwrap_err();
            assert!(reason.contains(word), "{text}: {reason}");
        }
    }

    #[test]
    fn ignored_model_parts_may_have_any_size() {
        let many = vec![r#"{"name":"a part","mesh":0,"children":[1,2],"extras":{"deep":[[[[]]]]}}"#; 10_000].join(",");
        let nodes = format!(r#"{{"asset":{{"version":"2.0","generator":"any"}},"nodes":[{many}],"images":[{{"bufferView":0}}]}}"#);
        assert_eq!(judged(&glb(&nodes)), Ok(()));
        let deep = format!(r#"{{"asset":{{"version":"2.0"}},"extras":{}{}}}"#, "[".repeat(100_000), "]".repeat(100_000));
        assert_eq!(judged(&glb(&deep)), Ok(()));
        assert!(judged(&glb(&deep.replace("]}", "}"))).is_err());
    }

    #[test]
    fn truncated_or_changed_models_never_panic() {
        let good = glb(r#"{"asset":{"version":"2.0"}}"#);
        for n in 0..good.len() {
            assert!(judged(&good[..n]).is_err(), "{n}");
        }
        for k in 0..20 {
            let mut changed = good.clone();
            changed[k] ^= 0x80;
            assert!(judged(&changed).is_err(), "{k}");
        }
    }
}
