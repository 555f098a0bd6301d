//! Checks the architecture: rooms (top-level modules) use only rooms above them, and no sibling
//! modules depend on each other in a circle. Also checks what the source says about itself: every
//! constant has a comment.
//!
//! `STAGEPOSE_REMAKE=1 cargo test --test stagepose structure` redraws docs/modules.md.

mod constants;
mod memory;
mod modules;
mod prose;
mod specification;
mod tuning;
mod warnings;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};

use modules::{Modules, Name};
use syn::{Item, Visibility};

/// The rooms from the top. Each uses only those above it.
const ROOMS: [&str; 43] = [
    // The core.
    "compute_clock",
    "simd",
    "fingerprint",
    "geometry",
    "camera",
    "frame",
    "features",
    "light",
    "matching",
    "motion",
    "track",
    "pose",
    "record",
    "tracker",
    // Around it.
    "simulate",
    "survey",
    "printable",
    "safe_file",
    "contain",
    "drop_oldest",
    "utc",
    "timecode",
    "html_page",
    "refine",
    "export",
    "capture",
    "calibrate",
    "targets",
    "mount",
    "compare",
    "diagnose",
    "protocols",
    "delay",
    "other_tracker",
    "publish",
    "telemetry",
    "config",
    "daemon",
    "web",
    "cli",
    "two_views",
    "diagnostics",
    "main",
];
/// Number of rooms in the core: the first ones of [`ROOMS`].
const CORE: usize = 13;

fn read() -> Modules {
    Modules::of(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs"))
}

/// Returns which rooms use which.
fn arrows_of_rooms(modules: &Modules) -> BTreeSet<(String, String)> {
    let room = |name: &Name| name.first().cloned();
    let arrows = modules.uses().into_iter().filter_map(|(user, used)| Some((room(&user)?, room(&used)?)));
    arrows.filter(|(user, used)| user != used).collect()
}

#[test]
fn every_module_group_uses_only_groups_before_it() {
    let place =
        |room: &str| ROOMS.iter().position(|r| *r == room).unwrap_or_else(|| panic!("`{room}` has no place in the order of the rooms"));
    let arrows = arrows_of_rooms(&read());
    assert!(arrows.len() > 60, "the reader sees only {} arrows", arrows.len());
    let back: Vec<_> = arrows.iter().filter(|(user, used)| place(used) >= place(user)).collect();
    assert!(back.is_empty(), "arrows back: {back:?}");
}

/// The rooms of `track` from the top, and the files that run them; each uses only those above it.
const TRACK: [&str; 15] = [
    "scene",
    "frame",
    "patches",
    "align",
    "model_error",
    "acquire",
    "body",
    // The order of a frame.
    "tuning",
    "settings",
    "failure",
    "two_view",
    "tile_observer",
    "body_search",
    "body_tracker",
    "synthetic",
];
/// The rooms of `track::align`, likewise.
const ALIGN: [&str; 12] =
    ["tuning", "lanes", "picture", "learned", "pixels", "kernel", "solve", "request", "kernels", "frame_problem", "hypotheses", "aligner"];

/// Holds the modules directly inside `parent` to an order.
fn assert_order(parent: &[&str], order: &[&str]) {
    let modules = read();
    let depth = parent.len();
    let below = |name: &Name| (name.len() > depth && name.iter().zip(parent).all(|(a, b)| a == b)).then(|| name[depth].clone());
    let place = |room: &String| order.iter().position(|r| r == room).unwrap_or_else(|| panic!("`{room}` has no place in {parent:?}"));
    let uses = modules.uses();
    let arrows: BTreeSet<(String, String)> =
        uses.iter().filter_map(|(user, used)| Some((below(user)?, below(used)?))).filter(|(user, used)| user != used).collect();
    assert!(arrows.len() > order.len(), "the reader sees only {} arrows in {parent:?}", arrows.len());
    let back: Vec<_> = arrows.iter().filter(|(user, used)| place(used) >= place(user)).collect();
    assert!(back.is_empty(), "arrows back in {parent:?}: {back:?}");
}

#[test]
fn every_room_of_track_uses_only_rooms_above_it() {
    assert_order(&["track"], &TRACK);
    assert_order(&["track", "align"], &ALIGN);
}

#[test]
fn only_protocols_two_views_and_diagnostics_are_public() {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs")).expect("lib.rs is there");
    let lib = syn::parse_file(&text).expect("lib.rs is Rust");
    let public = lib.items.iter().filter_map(|item| match item {
        Item::Mod(m) if matches!(m.vis, Visibility::Public(_)) => Some(m.ident.to_string()),
        _ => None,
    });
    assert_eq!(public.collect::<BTreeSet<_>>(), ["diagnostics", "protocols", "two_views"].map(str::to_owned).into());
    // A glob would publish whatever a room happens to have.
    assert!(!text.contains("::*"), "lib.rs names what it gives on");
}

/// Returns the files below a folder of the project, at any depth.
fn files_below(folder: &str) -> Vec<PathBuf> {
    let (mut folders, mut files) = (vec![Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)], Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())) {
            let path = entry.expect("an entry").path();
            if path.is_dir() { folders.push(path) } else { files.push(path) }
        }
    }
    files
}

/// Returns the source files, relative to `src/`.
fn sources() -> Vec<PathBuf> {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    files_below("src").iter().map(|file| file.strip_prefix(&src).expect("below src").to_owned()).collect()
}

#[test]
fn no_module_file_sits_beside_a_folder_of_its_name() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let files = sources();
    assert!(files.len() > 300, "the reader sees only {} files", files.len());
    let both: Vec<_> = files.iter().filter(|file| src.join(file).with_extension("").is_dir()).collect();
    assert!(both.is_empty(), "make them mod.rs in their folders: {both:?}");
}

/// `lanes.rs` calls AVX2 from safe functions. That is sound as long as only its macro names the
/// type, because the macro first checks the processor.
#[test]
fn avx2_is_named_only_behind_its_detection() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let names_it = |file: &PathBuf| std::fs::read_to_string(src.join(file)).is_ok_and(|text| text.contains("Avx2"));
    let naming: Vec<_> = sources().into_iter().filter(names_it).collect();
    assert_eq!(naming, [Path::new("track/align/lanes.rs")]);
}

/// Returns a dependency circle among sibling modules, or `None`, by a depth-first search along what
/// each uses.
fn circle(children: &BTreeSet<String>, arrows: &BTreeMap<&String, BTreeSet<&String>>) -> Option<Vec<String>> {
    fn follow<'a>(
        at: &'a String,
        path: &mut Vec<&'a String>,
        done: &mut BTreeSet<&'a String>,
        arrows: &BTreeMap<&'a String, BTreeSet<&'a String>>,
    ) -> Option<Vec<String>> {
        if let Some(k) = path.iter().position(|p| *p == at) {
            return Some(path[k..].iter().map(|p| (*p).clone()).collect());
        }
        if !done.insert(at) {
            return None;
        }
        path.push(at);
        let found = arrows.get(at).into_iter().flatten().find_map(|next| follow(next, path, done, arrows));
        path.pop();
        found
    }
    let mut done = BTreeSet::new();
    children.iter().find_map(|child| follow(child, &mut Vec::new(), &mut done, arrows))
}

#[test]
fn sibling_modules_have_no_circular_dependencies() {
    let modules = read();
    let uses = modules.uses();
    let mut circles = Vec::new();
    for (parent, children) in modules.parents() {
        let depth = parent.len();
        let below = |name: &Name| (name.len() > depth && name.starts_with(parent)).then(|| children.get(&name[depth])).flatten();
        let mut arrows: BTreeMap<&String, BTreeSet<&String>> = BTreeMap::new();
        for (user, used) in &uses {
            if let (Some(user), Some(used)) = (below(user), below(used))
                && user != used
            {
                arrows.entry(user).or_default().insert(used);
            }
        }
        circles.extend(circle(children, &arrows).map(|c| format!("crate::{}: {}", parent.join("::"), c.join(" -> "))));
    }
    assert!(circles.is_empty(), "circles:\n{}", circles.join("\n"));
}

/// Draws the rooms as a Mermaid diagram, which browsers and code forges render, with the core
/// separate from the rest.
fn drawn(arrows: &BTreeSet<(String, String)>) -> String {
    let mut text = String::from(
        "# Modules\n\nWhich room of `src/` uses which; drawn from the source by\n`STAGEPOSE_REMAKE=1 cargo test --test stagepose structure`. An arrow that follows from others is\nleft out.\n\n```mermaid\ngraph BT\n",
    );
    for (title, rooms) in [("core", &ROOMS[..CORE]), ("around", &ROOMS[CORE..])] {
        let _ = writeln!(text, "  subgraph {title}");
        rooms.iter().filter(|room| arrows.iter().any(|(a, b)| a == *room || b == *room)).for_each(|room| {
            let _ = writeln!(text, "    {room}");
        });
        text.push_str("  end\n");
    }
    for (user, used) in arrows {
        if !is_reached_otherwise(user, used, arrows) {
            let _ = writeln!(text, "  {user} --> {used}");
        }
    }
    text + "```\n"
}

/// Whether a longer path leads from one room to another.
fn is_reached_otherwise(user: &str, used: &str, arrows: &BTreeSet<(String, String)>) -> bool {
    let next = |at: &str| arrows.iter().filter(move |(from, _)| from == at).map(|(_, to)| to.clone()).collect::<Vec<_>>();
    let mut waiting: Vec<String> = next(user).into_iter().filter(|n| n != used).collect();
    let mut seen = BTreeSet::new();
    while let Some(at) = waiting.pop() {
        if at == used {
            return true;
        }
        if seen.insert(at.clone()) {
            waiting.extend(next(&at));
        }
    }
    false
}

#[test]
fn the_module_diagram_matches_the_source() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/modules.md");
    let wanted = drawn(&arrows_of_rooms(&read()));
    if std::env::var_os("STAGEPOSE_REMAKE").is_some() {
        std::fs::write(&file, &wanted).expect("docs/modules.md can be written");
    }
    let found = std::fs::read_to_string(&file).unwrap_or_default();
    assert_eq!(found, wanted, "run STAGEPOSE_REMAKE=1 cargo test --test stagepose structure");
}
