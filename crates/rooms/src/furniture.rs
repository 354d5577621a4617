//! Builders of objects, one function per class. Each draws shape, size, colors and materials.
//!
//! Sizes are those of furniture shops: meters, with wide ranges.

pub(crate) mod bathroom;
pub(crate) mod bedroom;
pub(crate) mod decoration;
pub(crate) mod electronics;
pub(crate) mod kitchen;
pub(crate) mod lighting;
pub(crate) mod openings;
pub(crate) mod seating;
pub(crate) mod small;
pub(crate) mod storage;
pub(crate) mod tables;

#[cfg(test)]
mod tests {
    use crate::model::Build;
    use scenesplat_kernels::random::sample_rng;

    #[test]
    fn every_model_stands_at_its_origin_and_looks_to_the_front() {
        let builders: &[(&str, Build)] = &[
            ("chair", super::seating::chair),
            ("stool", super::seating::stool),
            ("sofa", super::seating::sofa),
            ("bed", super::bedroom::bed),
            ("nightstand", super::bedroom::nightstand),
            ("pillow", super::bedroom::pillow),
            ("table", super::tables::table),
            ("coffee table", super::tables::coffee_table),
            ("desk", super::tables::desk),
            ("cabinet", super::storage::cabinet),
            ("wardrobe", super::storage::wardrobe),
            ("bookshelf", super::storage::bookshelf),
            ("tv stand", super::storage::tv_stand),
            ("refrigerator", super::kitchen::refrigerator),
            ("toilet", super::bathroom::toilet),
            ("bathtub", super::bathroom::bathtub),
            ("sink", super::bathroom::sink),
            ("monitor", super::electronics::monitor),
            ("keyboard", super::electronics::keyboard),
            ("laptop", super::electronics::laptop),
            ("floor lamp", super::lighting::floor_lamp),
            ("table lamp", super::lighting::table_lamp),
            ("plant", super::decoration::plant),
            ("book", super::small::book),
            ("box", super::small::carton),
            ("trash can", super::small::trash_can),
            ("mug", super::small::mug),
            ("clock", super::small::standing_clock),
        ];
        for (name, build) in builders {
            for index in 0..60 {
                let model = build(&mut sample_rng(7, 0, index));
                let block = model.bounds();
                let [w, d, h] = std::array::from_fn(|i| block.high[i] - block.low[i]);
                let lowest = if *name == "sink" { 0.6 } else { 0.1 };
                assert!(block.low[2] > -0.011 && block.low[2] < lowest, "{name} {index} {block:?}");
                assert!((0.03..3.4).contains(&w), "{name} {index} {block:?}");
                assert!((0.01..2.6).contains(&d), "{name} {index} {block:?}");
                assert!((0.004..2.6).contains(&h), "{name} {index} {block:?}");
                for solid in model.occupied() {
                    for i in 0..3 {
                        assert!(solid.low[i] < solid.high[i], "{name} {index} {solid:?}");
                    }
                }
                for s in &model.supports {
                    assert!(s.low[0] < s.high[0] && s.low[1] < s.high[1], "{name} {index} {s:?}");
                }
                let area: f64 = model.surfaces.iter().map(|s| s.shape.area()).sum();
                assert!(area.is_finite() && area > 1e-3, "{name} {index} {area}");
            }
        }
    }
}
