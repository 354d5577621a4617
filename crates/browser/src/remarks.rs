//! What the reader of a page has to know about how a scene was read.

use scenesplat::Alignment;
use scenesplat::alignment::Remark;

/// A smaller share of a scene that stays unknown is only counted.
const WORTH_A_REMARK: f64 = 0.02;

/// What is not sure about how the scene lies, and how the network turned and scaled it; the scene itself keeps its frame.
pub(crate) fn of_alignment(alignment: &Alignment) -> [Vec<String>; 2] {
    let (doubts, others): (Vec<_>, Vec<_>) =
        alignment.remarks.iter().partition(|remark| remark.is_warning());
    [doubts, others].map(|remarks| remarks.into_iter().map(of).collect())
}

fn of(remark: &Remark) -> String {
    match *remark {
        Remark::Turned { from } => {
            format!("Up is {}: the network read a copy turned to +z.", from.described())
        }
        Remark::Scaled { by } => {
            format!("One unit is {by} m: the network read a copy in meters.")
        }
        Remark::Leveled { tilt } => {
            format!("The floor is {tilt:.1} degrees out of level: the network read a level copy.")
        }
        Remark::Squared { yaw } => format!(
            "Walls are turned by {yaw:.1} degrees: the network read a copy with its walls along the axes."
        ),
        Remark::ScaledToRoom { by, height } => format!(
            "The unit is a guess: the walls are {height:.2} units high, so the network read a copy with {by:.3} m per unit."
        ),
        Remark::ScaledBySize { by, confidence } => format!(
            "The unit is a guess by the sizes of things: {by:.3} m per unit, with confidence {confidence:.2}."
        ),
        Remark::UpUnclear { likely, confidence } => format!(
            "Which way is up is unclear (confidence {confidence:.2}): {likely} is taken, and most labels are lost if it is \
             not. The program takes it with --up."
        ),
        Remark::UnitUnclear { likely, confidence } => format!(
            "The unit is unclear ({} is likeliest, confidence {confidence:.2}): it was taken for meters, and labels mean \
             little if it is not. The program takes it with --unit.",
            likely.symbol()
        ),
        Remark::SizeUnclear { height } => format!(
            "How large the scene is is unclear: it is {height:.3} units high, which were taken for meters. The program takes \
             it with --unit."
        ),
    }
}

/// That a share of the scene has no label because the network does not know it.
pub(crate) fn of_strangeness(share: f64) -> Option<String> {
    let what = match share {
        share if share < WORTH_A_REMARK => return None,
        share if share > 0.995 => "This looks".to_owned(),
        share => format!("{:.0} % of this look", 100.0 * share),
    };
    Some(format!("{what} like nothing that the network was trained on: those labels are left out."))
}
