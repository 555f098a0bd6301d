//! The cache that one start leaves for the next: records are the same with it, without it, and with
//! a damaged one.

use std::path::{Path, PathBuf};

use super::scene::Scene;

/// Returns the records of a replay with this cache folder.
fn replayed(scene: &Scene, cache: &Path) -> String {
    let mut command = scene.command(&["replay", "clip", "--config", "stage.toml", "--poses", "poses.jsonl"]);
    let output = command.env_remove("CACHE_DIRECTORY").env("XDG_CACHE_HOME", cache).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stderr.is_empty(), "not quiet: {}", String::from_utf8_lossy(&output.stderr));
    scene.read("poses.jsonl")
}

fn kept(cache: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let Ok(folder) = std::fs::read_dir(cache.join("stagepose")) else { return Vec::new() };
    let mut files: Vec<PathBuf> = folder.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files.into_iter().map(|file| (file.clone(), std::fs::read(file).unwrap())).collect()
}

#[test]
fn cached_views_give_the_same_bytes_and_are_rebuilt_if_damaged() {
    let scene = Scene::new();
    let mut uncached = scene.command(&["replay", "clip", "--config", "stage.toml", "--poses", "poses.jsonl"]);
    assert!(uncached.env("CACHE_DIRECTORY", "/dev/null").status().unwrap().success());
    let alone = scene.read("poses.jsonl");
    let cache = scene.path("cache");
    assert_eq!(replayed(&scene, &cache), alone);
    let cold = kept(&cache);
    assert!(cold.len() == 1 && cold[0].1.len() > 10_000, "{}", cold.len());
    assert_eq!(replayed(&scene, &cache), alone);
    assert_eq!(kept(&cache), cold);
    let (file, whole) = &cold[0];
    let mut flipped = whole.clone();
    flipped[whole.len() / 3] ^= 1;
    for damaged in [flipped, whole[..whole.len() / 2].to_vec(), Vec::new()] {
        std::fs::write(file, damaged).unwrap();
        assert_eq!(replayed(&scene, &cache), alone);
        assert_eq!(kept(&cache), cold);
    }
}

#[test]
fn a_cache_folder_that_cannot_be_written_changes_nothing() {
    let scene = Scene::new();
    let cache = scene.path("cache");
    let alone = replayed(&scene, &cache);
    // A file in place of the folder stops even root.
    scene.write("no-folder", "");
    for place in [scene.path("no-folder"), PathBuf::from("/proc")] {
        assert_eq!(replayed(&scene, &place), alone);
    }
    std::fs::remove_dir_all(&cache).unwrap();
    let read_only = scene.path("read-only");
    std::fs::create_dir(&read_only).unwrap();
    let mut rights = std::fs::metadata(&read_only).unwrap().permissions();
    rights.set_readonly(true);
    std::fs::set_permissions(&read_only, rights).unwrap();
    assert_eq!(replayed(&scene, &read_only), alone);
}

#[test]
fn a_service_has_a_folder_of_its_own() {
    let scene = Scene::new();
    let service = scene.path("of-service");
    let mut command = scene.command(&["replay", "clip", "--config", "stage.toml"]);
    let output = command.env("CACHE_DIRECTORY", &service).env("XDG_CACHE_HOME", scene.path("cache")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!((std::fs::read_dir(service).unwrap().count(), scene.path("cache").exists()), (1, false));
}
