//! Common mistakes of a first evening, and what `check` must say about each. None of them may be
//! called good.
//!
//! Each mistake breaks one thing of a stage that is otherwise right. Exit codes: 0, it works but
//! with less than was intended (a surface is left out, a rate is assumed); 1, something must be
//! fixed; 2, the config is refused.

mod stage;

use image::{GrayImage, Luma, imageops};
use stagepose::diagnostics::simulate::{grey, paint};

use stage::{FRAMES, Stage, placed};

struct Mistake {
    /// What was done wrong.
    done: &'static str,
    spoil: fn(&Stage),
    code: i32,
    /// Texts that must all appear in the output.
    says: &'static [&'static str],
}

const IN_ORDER: [usize; 4] = [0, 1, 2, 3];

/// Sizes and places.
const LAYOUT: [Mistake; 9] = [
    Mistake {
        done: "width and height swapped",
        spoil: |s| s.config("[4.0, 3.0]", "[3.0, 4.0]"),
        code: 1,
        says: &["width and height are swapped: write size_m = [4.0, 3.0]", "tried: a pose then fits in"],
    },
    Mistake {
        done: "sizes in millimetres",
        spoil: |s| {
            s.write(
                "stage.toml",
                &stage::CONFIG
                    .replace("[4.0, 3.0]", "[4000, 3000]")
                    .replace("[1.1, 1.7]", "[1100, 1700]")
                    .replace("[0.95, -0.8, -0.65]", "[950, -800, -650]"),
            )
        },
        code: 2,
        says: &["`size_m`", "from 0.001 to 1000 metres: 4000 millimetres are 4.0"],
    },
    Mistake {
        done: "sizes in centimetres",
        spoil: |s| {
            s.write(
                "stage.toml",
                &stage::CONFIG
                    .replace("[4.0, 3.0]", "[400, 300]")
                    .replace("[1.1, 1.7]", "[110, 170]")
                    .replace("[0.95, -0.8, -0.65]", "[95, -80, -65]"),
            )
        },
        code: 1,
        says: &["400.0 m wide", "[4.0, 3.0] if centimetres"],
    },
    Mistake {
        done: "sizes in millimetres, of a small picture",
        spoil: |s| {
            s.write(
                "stage.toml",
                &stage::CONFIG
                    .replace("[4.0, 3.0]", "[400, 300]")
                    .split("[[stage.surface]]")
                    .take(2)
                    .collect::<Vec<_>>()
                    .join("[[stage.surface]]"),
            )
        },
        code: 1,
        says: &["write size_m = [0.4, 0.3] if those are millimetres"],
    },
    Mistake {
        done: "the height was guessed",
        spoil: |s| s.config("[4.0, 3.0]", "[4.0, 2.25]"),
        code: 1,
        says: &["times as high as wide, size_m says 0.56", "write size_m = [4.0, 3.0]"],
    },
    Mistake {
        done: "one surface's place in millimetres",
        spoil: |s| s.config("[0.95, -0.8, -0.65]", "[950.0, -800.0, -650.0]"),
        code: 1,
        says: &["flat.png", "position_m is in metres", "position_m = [0.95, -0.8, -0.65] if those are millimetres"],
    },
    Mistake {
        done: "one surface's place on the wrong side",
        spoil: |s| s.config("[0.95, -0.8, -0.65]", "[-0.95, -0.8, -0.65]"),
        code: 1,
        says: &["flat.png: it is not where the config puts it", "write position_m = [0.9"],
    },
    Mistake {
        done: "a plain surface among others",
        spoil: |s| s.picture("flat.png", |p| GrayImage::from_pixel(p.width(), p.height(), Luma([120]))),
        code: 0,
        says: &["flat.png: it has too little texture", "left out"],
    },
    Mistake {
        done: "nothing but a plain surface",
        spoil: |s| {
            s.picture("flat.png", |p| GrayImage::from_pixel(p.width(), p.height(), Luma([120])));
            s.picture("backdrop.png", |p| GrayImage::from_pixel(p.width(), p.height(), Luma([120])));
        },
        code: 2,
        says: &["backdrop.png", "too little texture", "use a picture with more detail"],
    },
];

/// The four corners of a photograph.
const CORNERS: [Mistake; 8] = [
    Mistake {
        done: "corners begun a quarter on",
        spoil: |s| s.photo([1, 2, 3, 0], "", ""),
        code: 1,
        says: &["the corners do not start at the top left", "FIRST CORNER"],
    },
    Mistake {
        done: "corners begun a quarter back",
        spoil: |s| s.photo([3, 0, 1, 2], "", ""),
        code: 1,
        says: &["the corners do not start at the top left", "FIRST CORNER"],
    },
    Mistake {
        done: "corners begun at the opposite one",
        spoil: |s| s.photo([2, 3, 0, 1], "", ""),
        code: 1,
        says: &["upside down", "FIRST CORNER"],
    },
    Mistake {
        done: "corners anticlockwise",
        spoil: |s| s.photo([0, 3, 2, 1], "", ""),
        code: 2,
        says: &["`corners_px`", "anticlockwise", "FIRST CORNER"],
    },
    Mistake {
        done: "corners mirrored, from the top right",
        spoil: |s| s.photo([1, 0, 3, 2], "", ""),
        code: 2,
        says: &["anticlockwise", "FIRST CORNER"],
    },
    Mistake { done: "corners line by line", spoil: |s| s.photo([0, 1, 3, 2], "", ""), code: 2, says: &["cross", "FIRST CORNER"] },
    Mistake {
        done: "a corner outside of the photograph",
        spoil: |s| s.photo(IN_ORDER, "corners_px = [[", "corners_px = [[-90.0, 20.0], [440.0, 20.0], [440.0, 300.0], [20.0, 300.0]] # [["),
        code: 2,
        says: &["corner 1 at [-90", "outside of the photograph"],
    },
    Mistake {
        done: "a photograph without corners",
        spoil: |s| s.photo(IN_ORDER, "corners_px", "# corners_px"),
        code: 2,
        says: &["has no `corners_px`", "clockwise from the top left"],
    },
];

/// The artwork's file.
const PICTURE: [Mistake; 9] = [
    Mistake {
        done: "artwork upside down",
        spoil: |s| s.picture("backdrop.png", |p| imageops::rotate180(&p)),
        code: 1,
        says: &["upside down", "turn the picture's file"],
    },
    Mistake {
        done: "artwork on its side, as EXIF leaves it",
        spoil: |s| s.picture("backdrop.png", |p| imageops::rotate90(&p)),
        code: 1,
        says: &["lies on its side", "EXIF"],
    },
    Mistake {
        done: "artwork mirrored",
        spoil: |s| {
            s.picture("backdrop.png", |p| imageops::flip_horizontal(&p));
            s.picture("flat.png", |p| imageops::flip_horizontal(&p));
        },
        code: 1,
        says: &["mirror image", "flip it left to right"],
    },
    Mistake {
        done: "artwork in negative",
        spoil: |s| {
            for name in ["backdrop.png", "flat.png"] {
                s.picture(name, |mut p| {
                    imageops::invert(&mut p);
                    p
                });
            }
        },
        code: 1,
        says: &["negative", "invert the picture's file"],
    },
    Mistake {
        done: "artwork of another show",
        spoil: |s| {
            s.picture("backdrop.png", |_| grey(&paint(800, 600, 77)));
            s.picture("flat.png", |_| grey(&paint(220, 340, 78)));
        },
        code: 1,
        says: &["not recognised", "name the picture of this stage"],
    },
    Mistake {
        done: "the only artwork upside down",
        spoil: |s| {
            s.picture("backdrop.png", |p| imageops::rotate180(&p));
            s.write("stage.toml", &stage::CONFIG.split("[[stage.surface]]").take(2).collect::<Vec<_>>().join("[[stage.surface]]"));
        },
        code: 1,
        says: &["upside down", "turn the picture's file"],
    },
    Mistake {
        done: "one of two pictures of another show",
        spoil: |s| s.picture("flat.png", |_| grey(&paint(220, 340, 78))),
        code: 0,
        says: &["flat.png: it should be in view, and is recognised in none of"],
    },
    Mistake {
        done: "artwork cropped at one side",
        spoil: |s| s.picture("backdrop.png", |p| imageops::crop_imm(&p, 0, 0, 520, 600).to_image()),
        code: 1,
        says: &["backdrop.png", "size_m = ["],
    },
    Mistake {
        done: "a photograph given as flat artwork",
        spoil: |s| {
            s.photo(IN_ORDER, "photo = \"photo.png\"", "image = \"photo.png\"");
            let text = std::fs::read_to_string(s.path("stage.toml")).unwrap();
            s.write("stage.toml", &text.replace("corners_px", "# corners_px"));
        },
        code: 1,
        says: &["photo.png", "corners_px"],
    },
];

/// The lens, the shutter and the mask.
const CAMERA: [Mistake; 9] = [
    Mistake {
        done: "the calibration of another camera",
        spoil: |s| s.lens((480, 360), 760.0, [0.0; 5]),
        code: 1,
        says: &["the calibration is for another camera", "focal length of 760.0 pixels", "write fx = 4"],
    },
    Mistake {
        done: "the calibration of a wider lens",
        spoil: |s| s.lens((480, 360), 260.0, [0.0; 5]),
        code: 1,
        says: &["the calibration is for another camera", "write fx = 4"],
    },
    Mistake {
        done: "the calibration of a picture of another shape",
        spoil: |s| s.lens((1920, 1080), 1700.0, [0.0; 5]),
        code: 2,
        says: &["1920 x 1080", "480 x 360"],
    },
    Mistake {
        done: "a digit of the focal length lost",
        spoil: |s| s.lens((480, 360), 43.2, [-0.11, 0.06, 0.0006, -0.0004, 0.0]),
        code: 2,
        says: &["fx is 43.2, which no camera has"],
    },
    Mistake {
        done: "the distortion in another program's order",
        spoil: |s| s.lens((480, 360), 432.0, [-0.11, 0.06, 0.08, 0.0006, -0.0004]),
        code: 1,
        says: &["k1, k2, k3, p1, p2", "distortion = [-0.11, 0.06, 0.0006, -0.0004, 0.08]"],
    },
    Mistake {
        done: "the readout in milliseconds",
        spoil: |s| s.config("calibration = \"camera.toml\"", "calibration = \"camera.toml\"\nreadout_s = 15.0"),
        code: 2,
        says: &["`readout_s`", "15 milliseconds are 0.015"],
    },
    Mistake {
        done: "an exposure longer than a frame",
        spoil: |s| s.config("calibration = \"camera.toml\"", "calibration = \"camera.toml\"\nexposure_s = 0.8"),
        code: 1,
        says: &["exposure_s = 0.8 is longer than the 66.7 ms between two frames"],
    },
    Mistake {
        done: "a mask that hides the stage",
        spoil: |s| {
            let mask = GrayImage::from_fn(480, 360, |x, y| Luma([if (40..440).contains(&x) && (20..340).contains(&y) { 0 } else { 255 }]));
            mask.save(s.path("mask.png")).unwrap();
            s.config("calibration = \"camera.toml\"", "calibration = \"camera.toml\"\nmask = \"mask.png\"");
        },
        code: 1,
        says: &["the mask hides the stage"],
    },
    Mistake {
        done: "a mask that is black all over",
        spoil: |s| {
            GrayImage::new(480, 360).save(s.path("mask.png")).unwrap();
            s.config("calibration = \"camera.toml\"", "calibration = \"camera.toml\"\nmask = \"mask.png\"");
        },
        code: 2,
        says: &["mask.png is black everywhere", "leave white what to use"],
    },
];

/// The clip.
const CLIP: [Mistake; 10] = [
    Mistake { done: "too dark", spoil: |s| s.levels(|v| 0.02 * v), code: 1, says: &["the frame is too dark: give more light"] },
    Mistake { done: "overexposed", spoil: |s| s.levels(|v| 4.0 * v + 230.0), code: 1, says: &["overexposed: expose less"] },
    Mistake { done: "the lens cap on", spoil: |s| s.levels(|_| 90.0), code: 1, says: &["without detail: take the lens cap off"] },
    Mistake { done: "out of focus", spoil: |s| s.frames(|_, f| imageops::blur(&f, 9.0)), code: 1, says: &["blurred: focus the lens"] },
    Mistake {
        done: "the stage is covered",
        spoil: |s| {
            let other = grey(&paint(480, 360, 31));
            s.frames(|_, f| GrayImage::from_fn(480, 360, |x, y| if x > 120 { *other.get_pixel(x, y) } else { *f.get_pixel(x, y) }));
        },
        code: 1,
        says: &["covered"],
    },
    Mistake {
        done: "the stage is tiny in the frame",
        spoil: |s| s.frames(|_, f| placed(&imageops::resize(&f, 64, 48, imageops::FilterType::Triangle))),
        code: 1,
        says: &["near"],
    },
    Mistake {
        done: "a webcam's selfie view",
        spoil: |s| s.frames(|_, f| imageops::flip_horizontal(&f)),
        code: 1,
        says: &["mirror image", "selfie view"],
    },
    Mistake {
        done: "interlaced",
        spoil: |s| {
            let frames: Vec<GrayImage> = (0..FRAMES).map(|k| s.frame(k)).collect();
            s.frames(|k, f| {
                let next = &frames[(k + 1).min(FRAMES - 1)];
                GrayImage::from_fn(480, 360, |x, y| if y % 2 == 0 { *f.get_pixel(x, y) } else { *next.get_pixel(x, y) })
            });
        },
        code: 1,
        says: &["interlaced", "bwdif"],
    },
    Mistake {
        done: "letterboxed",
        spoil: |s| {
            s.frames(|_, f| {
                let mut boxed = GrayImage::from_pixel(480, 360, Luma([16]));
                imageops::replace(&mut boxed, &imageops::resize(&f, 480, 270, imageops::FilterType::Triangle), 0, 45);
                boxed
            });
        },
        code: 1,
        says: &["black bars of 45 and 45 pixels above and below"],
    },
    Mistake {
        done: "pictures without stamps or a rate",
        spoil: |s| std::fs::remove_file(s.path("clip/timestamps.csv")).map(|()| move_up(s)).unwrap(),
        code: 0,
        says: &["no stamps", "--fps"],
    },
];

/// Moves the frames into the clip's folder itself, as in a plain folder of pictures.
fn move_up(stage: &Stage) {
    for k in 0..FRAMES {
        std::fs::rename(stage.path(&format!("clip/frames/{k:06}.pgm")), stage.path(&format!("clip/{k:06}.pgm"))).unwrap();
    }
    std::fs::remove_dir(stage.path("clip/frames")).unwrap();
}

/// Makes every mistake of a table, and reports all failures together.
fn assert_named(mistakes: &[Mistake]) {
    let failed: Vec<String> = mistakes
        .iter()
        .filter_map(|mistake| {
            let stage = Stage::new();
            (mistake.spoil)(&stage);
            let said = stage.check();
            let first_corner = stage.corner(0);
            let wanted = mistake.says.iter().map(|says| if *says == "FIRST CORNER" { first_corner.as_str() } else { says });
            let missing: Vec<&str> = wanted.filter(|says| !said.text.contains(says)).collect();
            let called_good = said.text.lines().next().is_some_and(|line| line.contains("good"));
            let is_named = missing.is_empty() && !called_good && said.code == mistake.code && !said.text.contains("panicked");
            (!is_named).then(|| format!("{}: code {}, not said: {missing:?}\n{}", mistake.done, said.code, said.text))
        })
        .collect();
    assert!(failed.is_empty(), "{} of {} are not named:\n\n{}", failed.len(), mistakes.len(), failed.join("\n\n"));
}

#[test]
fn mistakes_in_sizes_and_places_are_named() {
    assert_named(&LAYOUT);
}

#[test]
fn mistakes_in_photograph_corners_are_named() {
    assert_named(&CORNERS);
}

#[test]
fn mistakes_in_the_picture_file_are_named() {
    assert_named(&PICTURE);
}

#[test]
fn mistakes_about_the_camera_are_named() {
    assert_named(&CAMERA);
}

#[test]
fn mistakes_about_the_clip_are_named() {
    assert_named(&CLIP);
}

/// Returns the first line that says what to fix.
fn first(said: &stage::Said) -> &str {
    said.text.lines().find_map(|line| line.strip_prefix("mend ")).unwrap_or_default().trim()
}

/// Mistakes with a photograph whose corners were read by eye. The true cause comes first, although
/// no corner is exact.
#[test]
fn photograph_mistakes_are_named_before_inexact_corners() {
    let by_eye = |order: [usize; 4], from: &str, to: &str| {
        let stage = Stage::new();
        stage.photo_by_eye(order, from, to);
        stage.check()
    };
    let swapped = by_eye(IN_ORDER, "[4.0, 3.0]", "[3.0, 4.0]");
    assert!(swapped.code == 1 && first(&swapped).contains("width and height are swapped: write size_m = [4.0, 3.0]"), "{}", swapped.text);
    for order in [[1, 2, 3, 0], [3, 0, 1, 2]] {
        let begun = by_eye(order, "", "");
        assert!(begun.code == 1 && first(&begun).contains("the corners do not start at the top left"), "{order:?} {}", begun.text);
    }
}

#[test]
fn a_guessed_lens_is_corrected_by_its_own_key() {
    for (line, wanted) in [("fov_deg = 85", "write fov_deg = 5"), ("focal_35mm_mm = 20", "write focal_35mm_mm = 3")] {
        let stage = Stage::new();
        stage.config("calibration = \"camera.toml\"", line);
        let said = stage.check();
        assert!(said.code == 1 && first(&said).contains(wanted), "{line}\n{}", said.text);
        assert!(!said.text.contains("fx ="), "{line}\n{}", said.text);
    }
}

/// 480 x 360 pixels stretched to 640 x 360, as a camera or a recording program does when it puts
/// 4:3 into 16:9; and to 480 x 480.
#[test]
fn a_stretched_clip_is_called_so() {
    for ((width, height), undone) in [((640, 360), "scale=480:360"), ((480, 480), "scale=480:360")] {
        let stage = Stage::new();
        stage.frames(|_, f| imageops::resize(&f, width, height, imageops::FilterType::CatmullRom));
        // The config states only the horizontal angle of view, which the stretching does not
        // change.
        stage.config("calibration = \"camera.toml\"", "fov_deg = 58.1");
        let said = stage.check();
        assert!(said.code == 1 && first(&said).contains("pixels are not square"), "{width} x {height}\n{}", said.text);
        let [across, down] = [undone, "setsar=1"];
        assert!(said.text.contains(across) && said.text.contains(down), "{}", said.text);
    }
}

/// The camera is shaken by hand and has a rolling shutter that the config does not mention.
#[test]
fn an_unconfigured_readout_does_not_blame_the_lens() {
    let folder = tempfile::tempdir().unwrap();
    let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/dolly");
    let config = format!(
        "[camera]\ncalibration = \"{fixture}/camera.toml\"\n[[stage.surface]]\nimage = \"{fixture}/backdrop.png\"\nsize_m = [4.0, 3.0]\n"
    );
    std::fs::write(folder.path().join("stage.toml"), config).unwrap();
    let mut command = crate::program();
    let output = command.args(["check", "--config", "stage.toml", "--clip", fixture]).current_dir(folder.path()).output().unwrap();
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
    let said = stage::Said { code: output.status.code().unwrap(), text };
    assert!(said.code == 0 && said.text.contains("its pose given in 40"), "{}", said.text);
    assert!(!said.text.contains("set zoom and focus back") && !said.text.contains("poses are withheld"), "{}", said.text);
}

#[test]
fn a_right_config_is_rated_good() {
    let said = Stage::new().check();
    assert!(said.code == 0 && said.text.starts_with("stage.toml: good\n"), "{}", said.text);
    let stage = Stage::new();
    stage.photo(IN_ORDER, "", "");
    let said = stage.check();
    assert!(said.code == 0 && said.text.starts_with("stage.toml: good\n"), "{}", said.text);
}

#[test]
fn an_upside_down_camera_is_questioned() {
    let stage = Stage::new();
    stage.frames(|_, f| imageops::rotate180(&f));
    stage.lens((480, 360), 432.0, [0.0; 5]);
    let said = stage.check();
    assert!(said.code == 1 && said.text.contains("right if it is mounted so") && said.text.contains("16 of 16 frames"), "{}", said.text);
}
