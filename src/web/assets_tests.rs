use std::collections::BTreeSet;
use std::path::Path;

use super::*;

/// Returns the names in quotes that a module imports, or that an HTML attribute references.
fn named(text: &str) -> impl Iterator<Item = &str> {
    let parts: Vec<&str> = text.split('"').collect();
    let follows = |before: &str| ["from", "import", "import(", "src=", "href="].iter().any(|word| before.trim_end().ends_with(word));
    parts.windows(2).filter(|pair| follows(pair[0])).map(|pair| pair[1]).collect::<Vec<_>>().into_iter()
}

/// Resolves a name relative to the file at `from`; `None` if it is not in the page's folder.
fn path(from: &str, name: &str) -> Option<String> {
    let folder = from.rsplit_once('/').map_or("", |(folder, _)| folder);
    match (name.strip_prefix("./"), name.strip_prefix("../")) {
        (Some(below), _) => Some(format!("{folder}/{below}")),
        (_, Some(beside)) => Some(format!("{}/{beside}", folder.rsplit_once('/')?.0)),
        _ => None,
    }
}

#[test]
fn the_page_names_exactly_the_files_that_exist() {
    let there: BTreeSet<String> = ASSETS.iter().map(|asset| asset.path.to_owned()).collect();
    let mut reached = BTreeSet::from(["/".to_owned(), "/vendor/LICENSES.txt".to_owned()]);
    // A bundled module imports nothing, and its minified text has `from` and quotes with other
    // meanings.
    for asset in ASSETS.iter().filter(|asset| asset.path != "/vendor/three.js") {
        let text = std::str::from_utf8(asset.bytes).unwrap();
        // Types are for the compiler that checks the modules; browsers do not load them.
        for name in named(text).filter(|name| !name.ends_with("/types.js")) {
            let path = path(asset.path, name).unwrap_or_else(|| panic!("{} names {name:?}, which is not below the page", asset.path));
            assert!(there.contains(&path), "{} names {name:?}, which is not embedded", asset.path);
            reached.insert(path);
        }
    }
    assert_eq!(reached, there);
}

/// Whether a file is for the compiler of types, and for editors: no browser asks for it.
fn is_for_the_compiler(path: &Path) -> bool {
    path.ends_with("tsconfig.json") || path.to_string_lossy().ends_with(".d.ts")
}

#[test]
fn each_file_of_the_folder_is_embedded() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/web/page");
    let (mut folders, mut files) = (vec![root.clone()], BTreeSet::new());
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some() && !is_for_the_compiler(&path) {
                files.insert(format!("/{}", path.strip_prefix(&root).unwrap().display()).replace("/index.html", "/"));
            }
        }
    }
    assert_eq!(files, ASSETS.iter().map(|asset| asset.path.to_owned()).collect());
}

#[test]
fn the_html_has_no_script_and_no_style_within_it() {
    let html = std::str::from_utf8(ASSETS[0].bytes).unwrap();
    assert!(html.contains("<script type=\"module\" src=\"./app.js\"></script>"), "{html}");
    assert_eq!(html.matches("<script").count(), 1);
    for inline in ["<style", "style=", "onload", "onclick", "javascript:"] {
        assert!(!html.contains(inline), "{inline}");
    }
}

#[test]
fn another_version_of_a_file_has_another_tag() {
    assert_eq!(fnv1a(fingerprint::START, b""), 0xcbf2_9ce4_8422_2325);
    assert_eq!(fnv1a(fingerprint::START, b"foobar"), 0x8594_4171_f739_67e8, "the authors' own example");
    assert_eq!(version().len(), 16);
}

#[test]
fn an_etag_is_recognised_in_every_form() {
    let has = |said: &str| has_it(&Request::builder().header(header::IF_NONE_MATCH, said).body(Body::empty()).unwrap(), "\"0a\"");
    for said in ["\"0a\"", "W/\"0a\"", "\"1\", \"0a\"", "*"] {
        assert!(has(said), "{said}");
    }
    for said in ["", "0a", "\"0A\"", "\"1\"", "W/0a"] {
        assert!(!has(said), "{said}");
    }
}

#[test]
fn a_compressed_asset_unpacks_to_the_original() {
    for (asset, packed) in ASSETS.iter().zip(PACKED.iter()) {
        let mut whole = Vec::new();
        std::io::copy(&mut flate2::read::GzDecoder::new(packed.as_slice()), &mut whole).unwrap();
        assert!(whole == asset.bytes, "{}", asset.path);
    }
}
