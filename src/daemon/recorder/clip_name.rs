//! Names of recordings that nobody named.

use std::path::{Path, PathBuf};

use crate::utc;

/// A name below `folder` that is not taken: clip-20261121T074500Z, with a number behind it where need be.
pub fn new_clip_name(folder: &Path) -> PathBuf {
    let plain: String = utc::date_and_time(utc::now_s()).chars().filter(|c| *c != '-' && *c != ':').collect();
    let first = folder.join(format!("clip-{plain}"));
    let mut others = (2..).map(|n: u32| folder.join(format!("clip-{plain}-{n}")));
    if first.exists() { others.find(|p| !p.exists()).unwrap_or(first) } else { first }
}
