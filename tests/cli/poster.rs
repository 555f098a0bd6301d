//! `stagepose poster`: the page, the picture beside it, and printed lines that work in a config.

use super::scene::Scene;

#[test]
fn the_printed_lines_work_in_a_config() {
    let scene = Scene::new();
    let run = scene.run(&["poster", "--paper", "a4", "--seed", "5", "-o", "wall.pdf"]);
    run.assert_success();
    assert!(std::fs::read(scene.path("wall.pdf")).unwrap().starts_with(b"%PDF-"));
    let surface: toml::Table = run.stdout.parse().unwrap();
    assert_eq!(surface["stage"]["surface"][0]["image"].as_str(), Some("wall-picture.png"));
    let [width, height] = [0, 1].map(|k| surface["stage"]["surface"][0]["size_m"][k].as_float().unwrap());
    assert!(width == 0.19 && height > 0.2 && height < 0.277, "{width} x {height}");
    scene.write("poster.toml", &format!("[camera]\ncalibration = \"camera.toml\"\n{}", run.stdout));
    let check = scene.run(&["check", "--config", "poster.toml"]);
    check.assert_success();
    assert!(check.stdout.contains("wall-picture.png: artwork 1700 x"), "{}", check.stdout);
}

#[test]
fn the_same_seed_is_the_same_file() {
    let scene = Scene::new();
    for (seed, file) in [("1", "a.svg"), ("1", "b.svg"), ("2", "c.svg")] {
        scene.run(&["poster", "--paper", "150x120 mm", "--seed", seed, "-o", file]).assert_success();
    }
    let picture = |name: &str| std::fs::read(scene.path(name)).unwrap();
    assert!(picture("a-picture.png") == picture("b-picture.png") && picture("a-picture.png") != picture("c-picture.png"));
    assert!(scene.read("a.svg").contains("href=\"a-picture.png\""));
}

#[test]
fn bad_papers_and_files_are_refused() {
    let scene = Scene::new();
    scene.run(&["poster", "--paper", "a33", "-o", "x.pdf"]).assert_refused(2, &["--paper is \"a33\"", "letter"]);
    scene.run(&["poster", "--paper", "0.5x0.7", "-o", "x.pdf"]).assert_refused(2, &["0.5x0.7 mm", "100 to 5000 mm"]);
    scene.run(&["poster", "--paper", "a4", "-o", "x.jpg"]).assert_refused(2, &["x.jpg", ".pdf or .svg"]);
    scene.run(&["poster", "--paper", "a4", "-o", "nowhere/x.pdf"]).assert_refused(1, &["nowhere"]);
    assert!(!scene.path("x-picture.png").exists());
}
