//! The flags that choose a detector, a descriptor and the matching criterion: one per option of the
//! library.

use clap::Args;
use clap::builder::PossibleValuesParser;

use crate::cli::failure::Failure;
use crate::features::two_views::{DescriptorKind, DetectorKind, FeatureSettings};
use crate::matching::exact::ExactOptions;

/// The choice of features and the matching criterion.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct FeatureArguments {
    /// How keypoints are detected [default of compare: sift; of detectors: all of them]
    #[arg(long, value_name = "NAME", value_parser = names(DetectorKind::ALL.map(|(name, _)| name)))]
    pub(in crate::cli) detector: Option<String>,
    /// How they are described [default: the detector's usual one]
    #[arg(long, value_name = "NAME", value_parser = names(DescriptorKind::ALL.map(|(name, _)| name)))]
    descriptor: Option<String>,
    /// Maximum number of keypoints, the most distinctive ones (asift: per simulated view)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    nfeat: Option<u64>,
    /// Minimum strength of a keypoint, in the detector's own unit
    #[arg(long, value_name = "X")]
    cmin: Option<f32>,
    /// Of two corners closer together than this, pixels, keep the stronger (harris, noble,
    /// shi-tomasi)
    #[arg(long, value_name = "PX")]
    suppress: Option<f64>,
    /// Half the width of a patch, pixels: 2 N + 1 across (descriptor patch)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=64))]
    half_width: Option<u64>,
    /// Harris' k (harris)
    #[arg(long, value_name = "K")]
    k: Option<f64>,
    /// Smoothing of the gradients' products, pixels (harris, noble, shi-tomasi, structure-tensor)
    #[arg(long, value_name = "PX")]
    sigma: Option<f64>,
    /// Maximum ratio of a match's distance to that of the nearest other candidate; 1 accepts all
    #[arg(long, value_name = "R", default_value_t = ExactOptions::default().ratio)]
    ratio: f32,
    /// Also accept matches that hold in one direction only
    #[arg(long)]
    one_way: bool,
}

fn names<const N: usize>(all: [&'static str; N]) -> PossibleValuesParser {
    PossibleValuesParser::new(all)
}

impl FeatureArguments {
    /// Returns the requested features.
    pub fn settings(&self) -> Result<FeatureSettings, Failure> {
        let kind =
            DetectorKind::ALL.iter().find(|(name, _)| self.detector.as_deref() == Some(name)).map_or(DetectorKind::Sift, |(_, kind)| *kind);
        let settings = self.settings_of(kind)?;
        self.refuse_idle(&settings)?;
        Ok(settings)
    }

    /// Refuses a flag that would have no effect: whoever typed it expects one.
    fn refuse_idle(&self, settings: &FeatureSettings) -> Result<(), Failure> {
        let is_corners = matches!(settings.detector, DetectorKind::Harris | DetectorKind::Noble | DetectorKind::ShiTomasi);
        let flags = [
            ("--cmin", self.cmin.is_some(), settings.detector != DetectorKind::Live, "any detector but live"),
            ("--suppress", self.suppress.is_some(), is_corners, "--detector harris, noble or shi-tomasi"),
            ("--k", self.k.is_some(), settings.detector == DetectorKind::Harris, "--detector harris"),
            (
                "--sigma",
                self.sigma.is_some(),
                is_corners || settings.descriptor == DescriptorKind::StructureTensor,
                "--detector harris, noble or shi-tomasi, or --descriptor structure-tensor",
            ),
            ("--half-width", self.half_width.is_some(), settings.descriptor == DescriptorKind::Patch, "--descriptor patch"),
        ];
        match flags.iter().find(|(_, is_given, applies, _)| *is_given && !applies) {
            Some((flag, .., with)) => Err(Failure::Usage(format!(
                "{flag} changes nothing with --detector {} and --descriptor {}; it goes with {with}",
                settings.detector.name(),
                settings.descriptor.name()
            ))),
            None => Ok(()),
        }
    }

    /// Returns the settings for another detector, with the requested descriptor, if any. Flags that
    /// do not apply to it are ignored.
    pub fn settings_of(&self, kind: DetectorKind) -> Result<FeatureSettings, Failure> {
        let chosen = self.descriptor.as_ref().and_then(|wanted| DescriptorKind::ALL.iter().find(|(name, _)| name == wanted));
        let within = |flag: &str, value: Option<f64>, least: f64, most: f64| match value {
            Some(v) if !(least..=most).contains(&v) => {
                Err(Failure::Usage(format!("--{flag} is {v}; give a number from {least} to {most}")))
            }
            _ => Ok(value),
        };
        if self.cmin.is_some_and(|c| !c.is_finite()) {
            return Err(Failure::Usage("--cmin is not a number; give the minimum strength of a keypoint".to_owned()));
        }
        Ok(FeatureSettings {
            descriptor: chosen.map_or(kind.usual_descriptor(), |(_, kind)| *kind),
            count: self.nfeat.map(|n| n as usize),
            least_response: self.cmin,
            suppress_px: within("suppress", self.suppress, 0.0, 1e4)?,
            half_width: self.half_width.map(|n| n as usize),
            k: within("k", self.k, 0.0, 0.24)?,
            sigma_px: within("sigma", self.sigma, 0.5, 20.0)?,
            ..FeatureSettings::of(kind)
        })
    }

    /// Returns the matching criterion.
    pub fn matching(&self) -> Result<ExactOptions, Failure> {
        if !(self.ratio > 0.0 && self.ratio <= 1.0) {
            return Err(Failure::Usage(format!("--ratio is {}; give a number above 0, at most 1", self.ratio)));
        }
        Ok(ExactOptions { ratio: self.ratio, is_mutual: !self.one_way })
    }
}
