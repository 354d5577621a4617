//! What it is worth to weigh blurred pictures less when labels are lifted: plants labels in rooms, takes
//! 60 pictures of each with motions of several severities, and compares the labels that come back with
//! all pictures counting alike and with weights by their motion.

use crate::Arguments;
use crate::planted::{Planted, Size};
use anyhow::Result;
use scenesplat_lab::capture::frame_weight;
use scenesplat_rasterizer::lifting::{DepthTolerance, FinaliseSettings, LiftSettings};

pub fn run(mut args: Arguments) -> Result<()> {
    let (gaussians, first, count): (_, u64, u64) = (args.or(100_000)?, args.or(0)?, args.or(3)?);
    let settings =
        LiftSettings { depth: Some(DepthTolerance::RENDERED), ..LiftSettings::default() };
    for room in first..first + count {
        let planted = Planted::new(Size { gaussians, views: 60, picture: [640, 480], room });
        for severity in [0.0, 1.0, 2.0, 3.0, 5.0] {
            for (name, finalise) in
                [("mean", FinaliseSettings::default()), ("median", FinaliseSettings::robust())]
            {
                // What the median picture's detail lacks after so many pixels, as detectors say it: 0.9 nat at
                // severity 2, about 2.4 pixels.
                let weights = |pixels: f64| frame_weight(Some(0.38 * pixels));
                let mut found = Vec::new();
                for on in [false, true] {
                    let weigh = |pixels: f64| if on { weights(pixels) } else { 1.0 };
                    let mut lifter = planted.blurred_lifter(severity, settings.clone(), weigh)?;
                    let weighted = lifter.num_weighted();
                    found.push((planted.recover(&mut lifter, &finalise)?, weighted));
                }
                let [(off, _), (on, weighted)] = &found[..] else { continue };
                println!(
                    "room {room} blur={severity} {name}: own object {:.2} % → {:.2} % of the weight, {:.2} % → \
                     {:.2} % of the Gaussians; 1 − cosine {:.4} → {:.4}; {weighted} of 60 pictures weigh less",
                    100.0 * off.mass,
                    100.0 * on.mass,
                    100.0 * off.gaussians,
                    100.0 * on.gaussians,
                    off.error,
                    on.error
                );
            }
        }
    }
    Ok(())
}
