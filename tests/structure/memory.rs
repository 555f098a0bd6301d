//! Checks where the tracker keeps what it remembers from frame to frame.
//!
//! Everything that outlives a frame is a field of [`ROOT`], or of what its fields hold. Of these
//! types, those that change have methods with `&mut self`, or functions take them as `&mut`. In
//! `body` and `align/learned` they are memory. Elsewhere each is on one of two lists: what
//! remembers nevertheless, and scratch space. The lists say what each holds; nothing checks that
//! scratch space is filled anew, except for whoever adds to the list.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use syn::visit::{self, Visit};
use syn::{Fields, FnArg, ImplItem, Item, ItemMod, Type};

/// What lives as long as the tracker tracks.
const ROOT: &str = "BodyTracker";
/// The rooms of memory.
const MEMORY: [&str; 2] = ["body/", "align/learned/"];

/// A type, its file below `src/track`, and what it holds.
type Place = (&'static str, &'static str, &'static str);

/// What remembers outside the rooms of memory, and what it remembers; `src/track/mod.rs` lists
/// them.
const REMEMBERS: [Place; 19] = [
    ("Aligner", "align/aligner.rs", "owns the online calibration of `align/learned`, and its buffers"),
    ("Buffers", "align/frame_problem/mod.rs", "for how many frames the camera has been still, and whether its pixels are kept"),
    ("LevelProblem", "align/solve/level_problem/mod.rs", "the finest level keeps its pixels while the camera is still"),
    ("Appearance", "align/pixels/appearance.rs", "the prediction at those pixels"),
    ("Pixels", "align/pixels/runs.rs", "those pixels"),
    ("FrameLevels", "frame/frame_levels.rs", "the camera's curve, by which frames are decoded"),
    ("TouchingPlanes", "align/pixels/touching_planes.rs", "the planes at those pixels"),
    ("FieldSize", "model_error/field_error.rs", "mean size of the model's error over recent frames"),
    ("Jump", "model_error/focal_step.rs", "usual error of predictions"),
    ("FocalMean", "model_error/lens_watch.rs", "usual estimate of the focal length"),
    ("LensWatch", "model_error/lens_watch.rs", "evidence of a lens that differs from its calibration"),
    ("ModelStudy", "model_error/model_study.rs", "evidence of many frames about lens, layout and shape"),
    ("ModelWatch", "model_error/model_watch.rs", "when that evidence is judged, and what was said"),
    ("Evidence", "model_error/moments/evidence.rs", "evidence of pictures that mix two moments"),
    ("MixtureWatch", "model_error/moments/mod.rs", "the same over frames, and what was said"),
    ("UnexplainedCells", "acquire/unexplained_cells.rs", "when each cell of the frame was last searched"),
    ("Unexplained", "acquire/unexplained.rs", "owns those cells, and its buffers"),
    ("BodySearch", "body_search.rs", "which missing body has its turn, and the buffers of the search"),
    ("BodyTracker", "body_tracker/mod.rs", "owns all bodies, watches and buffers"),
];

/// What outlives a frame and changes, but carries nothing from one frame to the next: it is filled
/// anew before it is read, or was made at load.
const SCRATCH: [Place; 26] = [
    ("AveragedPicture", "scene/averaged_picture.rs", "a copy of a picture, made again for another resolution"),
    ("PreparedSurface", "scene/reference.rs", "made at load"),
    ("RowOfTexels", "scene/bilinear.rs", "texels of a row"),
    ("Level", "frame/frame_levels.rs", "the frame itself"),
    ("VerifyBuffers", "patches/verify.rs", "buffers"),
    ("SilentSearch", "patches/verify.rs", "buffers of a study"),
    ("AlignSurface", "align/picture/surface.rs", "made at load; a survey may move it"),
    ("Texture", "align/picture/texture.rs", "made at load"),
    ("Selector", "align/pixels/selection.rs", "buffers of a selection"),
    ("ProductBuffer", "align/kernel/tile_products.rs", "buffers of a kernel"),
    ("Residuals", "align/kernel/normal.rs", "residuals of an iteration"),
    ("Moments", "align/solve/jump_instant.rs", "sums within a frame"),
    ("SchurComplement", "align/solve/system/schur_complement.rs", "buffers of a solution"),
    ("System", "align/solve/system/mod.rs", "normal equations of an iteration"),
    ("ModelErrorBuffers", "model_error/field_error.rs", "buffers"),
    ("Weighted", "model_error/field_error.rs", "sums within a frame"),
    ("WayTable", "model_error/shape_doubt.rs", "made at load"),
    ("SmoothField", "model_error/smooth_field.rs", "buffers of a frame's covariance"),
    ("TileResiduals", "model_error/tile_residuals.rs", "residuals of the frame"),
    ("Recognition", "acquire/candidate.rs", "what a search recognised in its frame"),
    ("ExpectedView", "acquire/expected_view.rs", "a rendering for the frame"),
    ("FeatureSearch", "acquire/feature_search.rs", "features and matches of the frame, and views made at load"),
    ("SearchWindows", "acquire/search_windows.rs", "windows of the frame"),
    ("Moments", "acquire/unexplained.rs", "sums within a frame"),
    ("HalfSize", "body_search.rs", "the frame at half size"),
    ("TwoViewBuffers", "two_view.rs", "buffers"),
];

/// What the source of `src/track` says about one type.
#[derive(Default)]
struct Found {
    /// The files that declare it, relative to `src/track`.
    files: BTreeSet<String>,
    /// Names of the types in its fields.
    fields: BTreeSet<String>,
}

/// Types of `src/track`, and which of them change.
#[derive(Default)]
struct Reader {
    file: String,
    types: BTreeMap<String, Found>,
    changing: BTreeSet<String>,
}

/// Names in a type, with those of its generic arguments.
struct Names<'a>(&'a mut BTreeSet<String>);

impl Visit<'_> for Names<'_> {
    fn visit_path_segment(&mut self, segment: &syn::PathSegment) {
        self.0.insert(segment.ident.to_string());
        visit::visit_path_segment(self, segment);
    }
}

fn is_test(item: &ItemMod) -> bool {
    item.attrs.iter().any(|a| a.path().is_ident("cfg") && a.meta.require_list().is_ok_and(|l| l.tokens.to_string().contains("test")))
}

impl Reader {
    fn declare(&mut self, name: &syn::Ident, fields: &[&Fields]) {
        let found = self.types.entry(name.to_string()).or_default();
        found.files.insert(self.file.clone());
        fields.iter().flat_map(|fields| fields.iter()).for_each(|field| Names(&mut found.fields).visit_type(&field.ty));
    }
}

impl<'a> Visit<'a> for Reader {
    fn visit_item(&mut self, item: &'a Item) {
        match item {
            Item::Mod(m) if is_test(m) => return,
            Item::Struct(s) => self.declare(&s.ident, &[&s.fields]),
            Item::Enum(e) => self.declare(&e.ident, &e.variants.iter().map(|v| &v.fields).collect::<Vec<_>>()),
            Item::Impl(i) => {
                let changes = |item: &ImplItem| match item {
                    ImplItem::Fn(f) => {
                        matches!(f.sig.inputs.first(), Some(FnArg::Receiver(r)) if r.reference.is_some() && r.mutability.is_some())
                    }
                    _ => false,
                };
                if let (Type::Path(own), true) = (&*i.self_ty, i.items.iter().any(changes)) {
                    self.changing.extend(own.path.segments.last().map(|s| s.ident.to_string()));
                }
            }
            _ => {}
        }
        visit::visit_item(self, item);
    }

    fn visit_fn_arg(&mut self, argument: &'a FnArg) {
        if let FnArg::Typed(typed) = argument
            && let Type::Reference(reference) = &*typed.ty
            && reference.mutability.is_some()
            && let Type::Path(own) = &*reference.elem
        {
            self.changing.extend(own.path.segments.last().map(|s| s.ident.to_string()));
        }
    }
}

/// Returns the types that change and outlive a frame, as (name, file).
fn lasting(reader: &Reader) -> BTreeSet<(String, String)> {
    let (mut reached, mut waiting) = (BTreeSet::new(), vec![ROOT.to_owned()]);
    while let Some(name) = waiting.pop() {
        if let Some(found) = reader.types.get(&name)
            && reached.insert(name)
        {
            waiting.extend(found.fields.iter().cloned());
        }
    }
    let changing = reached.into_iter().filter(|name| reader.changing.contains(name));
    changing.flat_map(|name| reader.types[&name].files.iter().map(move |file| (name.clone(), file.clone())).collect::<Vec<_>>()).collect()
}

#[test]
fn what_outlives_a_frame_is_in_the_rooms_of_memory() {
    let track = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/track");
    let mut reader = Reader::default();
    for file in super::files_below("src/track") {
        let name = file.strip_prefix(&track).expect("below src/track").display().to_string();
        if name.ends_with("_tests.rs") || name == "synthetic.rs" {
            continue;
        }
        let text = std::fs::read_to_string(&file).expect("a source");
        reader.file = name;
        reader.visit_file(&syn::parse_file(&text).expect("Rust"));
    }
    let lasting = lasting(&reader);
    let (memory, elsewhere): (Vec<_>, Vec<_>) = lasting.iter().partition(|(_, file)| MEMORY.iter().any(|room| file.starts_with(room)));
    assert!(memory.len() > 8, "the reader sees only {} types that remember: {memory:?}", memory.len());
    let named = || REMEMBERS.iter().chain(&SCRATCH);
    let is_named = |(name, file): &&&(String, String)| named().any(|(n, f, _)| n == name && f == file);
    let new: Vec<_> = elsewhere.iter().filter(|place| !is_named(place)).collect();
    assert!(new.is_empty(), "these outlive a frame: move them to `body` or `align/learned`, or list what they hold: {new:#?}");
    let gone = |(name, file, _): &&Place| !elsewhere.iter().any(|(n, f)| n == name && f == file);
    let gone: Vec<_> = named().filter(gone).collect();
    assert!(gone.is_empty(), "named, but no longer there: {gone:#?}");
    // A reader of the source finds the places of memory without this test.
    let page = std::fs::read_to_string(track.join("mod.rs")).expect("a source");
    let unlisted: Vec<_> = REMEMBERS.iter().filter(|(name, ..)| !page.contains(&format!("`{name}`"))).collect();
    assert!(unlisted.is_empty(), "src/track/mod.rs does not list {unlisted:#?}");
}

#[test]
fn a_type_that_changes_and_outlives_a_frame_is_found_out() {
    let source = "
        pub struct BodyTracker { kept: Vec<Kept>, fixed: Fixed }
        struct Kept { inner: Option<Inner> }
        struct Inner(u8);
        struct Fixed;
        struct Passing;
        impl Kept { fn look(&self) {} }
        impl Inner { fn change(&mut self) {} }
        impl Passing { fn change(&mut self) {} }
        fn fill(kept: &mut Kept, numbers: &mut Vec<Fixed>) {}
    ";
    let mut reader = Reader { file: "room/file.rs".into(), ..Reader::default() };
    reader.visit_file(&syn::parse_file(source).expect("Rust"));
    let names: Vec<String> = lasting(&reader).into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["Inner", "Kept"]);
}
