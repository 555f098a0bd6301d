//! The report of a comparison: the source's figures of two photographs (figures 22 to 32), in one
//! HTML file.

mod epipolar;
mod histograms;
mod pairs;
mod space;

use image::GrayImage;

use super::{Comparison, Model};
use crate::html_page::svg::escaped;
use crate::html_page::{figure, page};

/// Builds the report; `names` are the pictures' and `date` is when it was made.
pub fn html(made: &Comparison, pictures: [&GrayImage; 2], names: [&str; 2], date: &str) -> String {
    let [a, b] = names.map(escaped);
    let mut body = format!(
        "<p class=\"facts\">A: {a} ({} &times; {}) &middot; B: {b} ({} &times; {}) &middot; {} and {} keypoints ({}, {}) &middot; {} matches</p>\n",
        pictures[0].width(),
        pictures[0].height(),
        pictures[1].width(),
        pictures[1].height(),
        made.features[0].keypoints.len(),
        made.features[1].keypoints.len(),
        made.settings.detector.name(),
        made.settings.descriptor.name(),
        made.matches.len()
    );
    body += &verdict(made);
    body += &numbers(made);
    let sheet = pairs::Sheet::new(pictures);
    body += "<h2>Matches</h2>\n<div class=\"figures\">";
    let (fitting, others) = made.split_matches();
    body += &figure(
        &sheet.drawn(made, &fitting, "hsl(140 70% 45%)", "Matches that fit"),
        &format!(
            "<b>Matches that fit</b> ({} of {}): they agree with the model that best explains the two pictures.",
            fitting.len(),
            made.matches.len()
        ),
    );
    body += &figure(
        &sheet.drawn(made, &others, "hsl(0 80% 55%)", "Matches that do not fit"),
        &format!("<b>Matches that do not fit</b> ({}): they only look alike, or they moved.", others.len()),
    );
    body += "</div>\n<h2>Geometry</h2>\n<div class=\"figures\">";
    if let Some(relation) = made.essential_or_fundamental() {
        body += &figure(
            &epipolar::lines(made, &relation, pictures),
            "<b>Epipolar lines</b> of 20 matches: in each picture the line on which a point of the other one must lie. They meet in the epipole, where \
             the other camera stands (a ring, where it is in the picture).",
        );
    }
    if let Some(homography) = &made.homography {
        body += &figure(
            &pairs::transfer(made, homography, pictures),
            "<b>Homography.</b> Picture B with A's outline and grid laid onto it. Crosses are A's points as the homography puts them, dots where they are \
             in B: on a flat scene they coincide.",
        );
    }
    if let Some(drawn) = space::figure(made) {
        body += &figure(
            &drawn,
            "<b>The two cameras</b> from above and from the side, A in blue at the origin and B in orange, with the matched points. The \
             distance between the cameras is the unit of length, because two pictures do not determine it.",
        );
    }
    body += &figure(
        &histograms::cumulative(made),
        "<b>How near.</b> Left: share of the matches whose descriptors are closer than this; this is similarity, not an error. Right: \
         share of the matches that lie within this many pixels of where the model puts them.",
    );
    body += "</div>\n";
    page("Two pictures compared", date, &body)
}

fn verdict(made: &Comparison) -> String {
    let class = if made.model.is_some() { "good" } else { "bad" };
    let rest: String = made.remarks().iter().map(|remark| format!("<li>{}</li>", escaped(remark))).collect();
    format!("<div class=\"verdict {class}\"><b>{}</b><ul>{rest}</ul></div>\n", escaped(&made.sentence()))
}

fn numbers(made: &Comparison) -> String {
    let mut rows = String::new();
    let models = [("homography", &made.homography), ("fundamental matrix", &made.fundamental), ("essential matrix", &made.essential)];
    for (name, relation) in models.iter().filter_map(|(name, relation)| Some((name, relation.as_ref()?))) {
        let cells: Vec<String> = relation.matrix.transpose().iter().map(|v| format!("{v:.6e}")).collect();
        rows += &format!(
            "<tr><td>{name}</td><td class=\"number\">{}</td><td class=\"number\">{:.2} px</td><td><code>{}</code></td></tr>",
            relation.inliers.len(),
            relation.sigma_px,
            cells.join(" ")
        );
    }
    let chosen = match made.model {
        Some(Model::Homography) => "homography",
        Some(Model::Fundamental) => "fundamental matrix",
        Some(Model::Essential) => "essential matrix",
        None => "none",
    };
    format!(
        "<div class=\"wide\"><table><tr><th>model</th><th class=\"number\">matches that agree</th><th class=\"number\">their error, sigma</th>\
         <th>matrix, row by row</th></tr>{rows}</table></div><p>Explains the pictures best: {chosen}.</p>\n"
    )
}
