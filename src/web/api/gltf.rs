//! Whether a binary glTF file may be given to the page: whole, with nothing from elsewhere, and nothing that needs a decoder which the page
//! has not. What its meshes look like is the page's to see.

use std::io::Read;
use std::path::Path;

use serde_json::Value;

use crate::safe_file;

/// `glTF` as the file begins (glTF 2.0, 4.4.2), and the kind of the first chunk, `JSON`.
const MAGIC: u32 = 0x4654_6C67;
const JSON: u32 = 0x4E4F_534A;
/// Larger than the description in a model, bytes; meshes and pictures are behind it. Raised, judging one takes more memory.
const LARGEST_DESCRIPTION: u32 = 16 << 20;
/// Extensions that need a decoder in WebAssembly, which the page's policy does not let in.
const NEED_A_DECODER: [&str; 4] =
    ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression", "KHR_texture_basisu"];

/// Judges a file.
///
/// # Errors
/// Why it is not taken, with the mend.
pub(super) fn judge(file: &Path) -> Result<(), String> {
    let mut opened = safe_file::open(file).map_err(|e| format!("the model cannot be read ({e})"))?;
    let length = opened.metadata().map_or(0, |about| about.len());
    let not_whole = || "this is no whole binary glTF file; export the model as .glb (glTF 2.0) and send all of it".to_owned();
    let mut head = [0; 20];
    opened.read_exact(&mut head).map_err(|_| not_whole())?;
    let word = |k: usize| u32::from_le_bytes([head[k], head[k + 1], head[k + 2], head[k + 3]]);
    if word(0) != MAGIC || u64::from(word(8)) != length || word(16) != JSON || u64::from(word(12)) + 20 > length {
        return Err(not_whole());
    }
    if word(4) != 2 {
        return Err(format!("this is glTF {}; export the model as glTF 2.0", word(4)));
    }
    if word(12) > LARGEST_DESCRIPTION {
        return Err("the model's description is larger than 16 MB; export it with fewer parts".to_owned());
    }
    let mut text = vec![0; word(12) as usize];
    opened.read_exact(&mut text).map_err(|_| not_whole())?;
    let model: Value = serde_json::from_slice(&text).map_err(|e| format!("the model's description is no JSON ({e}); export it anew"))?;
    if !model["asset"]["version"].as_str().is_some_and(|version| version.starts_with("2.")) {
        return Err("the model's description has no version 2 in \"asset\"; export it as glTF 2.0".to_owned());
    }
    for kind in ["buffers", "images"] {
        let parts = model[kind].as_array().into_iter().flatten();
        if parts.filter_map(|part| part.get("uri")).any(|uri| !uri.as_str().is_some_and(|uri| uri.starts_with("data:"))) {
            return Err(format!(
                "its {kind} are in other files, which the page does not load; export the model with everything in one .glb"
            ));
        }
    }
    for list in ["extensionsUsed", "extensionsRequired"] {
        let named = model[list].as_array().into_iter().flatten().filter_map(Value::as_str);
        if let Some(extension) = named.into_iter().find(|name| NEED_A_DECODER.contains(name)) {
            return Err(format!("it is packed with {extension}, which the page cannot unpack; export it without compression"));
        }
    }
    Ok(())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A binary glTF file with this description.
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
    fn what_is_whole_and_by_itself_is_taken() {
        let inside = r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4},{"uri":"data:application/octet-stream;base64,AAAA"}]}"#;
        assert_eq!(judged(&glb(inside)), Ok(()));
        for (text, word) in [
            (r#"{"asset":{"version":"2.0"},"buffers":[{"uri":"a.bin"}]}"#, "buffers"),
            (r#"{"asset":{"version":"2.0"},"images":[{"uri":"//evil.example/a.png"}]}"#, "images"),
            (r#"{"asset":{"version":"2.0"},"images":[{"uri":7}]}"#, "images"),
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
    fn any_cut_or_changed_file_is_judged_without_harm() {
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
