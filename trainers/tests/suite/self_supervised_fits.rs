//! Views, networks and stores of self-supervised training: which fit together, and what is said of others.

use crate::self_supervised_terms::{masking, model, module, prototypes, terms};
use crate::support::{batch_of, in_step, views};
use scenesplat_datasets::{InputFeatures, TrainBatch, View, ViewKind};
use scenesplat_models::{BackboneConfig, ParamStore};
use scenesplat_trainers::TrainingModule;
use scenesplat_trainers::tasks::self_supervised::{
    Balance, Compat, Prototypes, SelfDistillationTerm, SelfSupervised, SelfSupervisedConfig,
    SimDinoRowsTerm, TermConfig,
};

#[test]
fn views_networks_and_stores_that_do_not_fit_are_named() {
    let own =
        module(vec![terms()[0].clone(), terms()[1].clone(), terms()[3].clone()], Compat::None);
    let names: Vec<&str> = own.stores().into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, ["teacher", "centers"]);
    let centers = |terms: Vec<TermConfig>| -> Vec<String> {
        let module = module(terms, Compat::Original);
        let stores = module.stores();
        assert!(stores.iter().any(|(name, _)| *name == "heads"));
        let centers = stores.into_iter().find(|(name, _)| *name == "centers");
        centers.map_or(Vec::new(), |(_, store)| store.parameters().into_keys().collect())
    };
    assert_eq!(
        centers(vec![terms()[1].clone(), terms()[3].clone()]),
        ["dino", "ibot_cross_entropy"]
    );
    let distillation = |shares, balance| {
        let prototypes = Prototypes { balance, ..prototypes() };
        vec![TermConfig::SelfDistillation(SelfDistillationTerm {
            prototypes,
            up_cast: 1,
            shares,
            ..<_>::default()
        })]
    };
    let balance = Balance::Centering(0.5);
    let [masked, local] = ["self_distillation.masked", "self_distillation.local"];
    assert_eq!(centers(distillation([0.5; 3], balance)), [local, masked]);
    assert_eq!(centers(distillation([0.0, 0.5, 0.0], balance)), [masked]);
    assert_eq!(centers(distillation([0.5, 0.0, 0.0], balance)), [masked]);
    assert_eq!(centers(distillation([0.0, 0.0, 0.5], balance)), [local]);
    assert!(centers(distillation([0.5; 3], Balance::SinkhornKnopp(2))).is_empty());

    let views =
        batch_of(&[(0..30).map(|i| [i as f32 * 0.2, 0.0, 0.0]).collect()], &views(0.6)).views;
    let refused = |views: &[View]| {
        let masks = vec![None; views.len()];
        in_step(|cx| own.step_with_masks(views, &masks, cx).err().unwrap().to_string())
    };
    assert!(refused(&[]).contains("the batch has none"));
    assert!(refused(&views[2..]).contains("the batch has none"));
    let [a, b] = [views[0].clone(), views[2].clone()];
    assert!(refused(&[a.clone(), b.clone(), a.clone()]).contains("global ones come first"));
    let mut other = b.clone();
    other.batch.ids = vec!["other".to_owned()];
    assert!(refused(&[a.clone(), b, other]).contains("views: of"));
    let mut empty = a.clone();
    empty.batch = TrainBatch::default();
    let masks = in_step(|cx| own.masks(&[empty, a], cx).unwrap());
    assert_eq!(masks.iter().map(Option::is_some).collect::<Vec<_>>(), [false, true]);
    assert!(views[2].kind == ViewKind::Local);

    // A token that nothing masks, and masks without a token.
    for (token, masked) in [(true, None), (false, Some(masking()))] {
        let mut model = model();
        if let BackboneConfig::PointTransformerV3(config) = &mut model.backbone {
            config.mask_token = token;
        }
        let config = SelfSupervisedConfig {
            masking: masked,
            terms: vec![terms()[0].clone()],
            ..<_>::default()
        };
        let (input, params) = (InputFeatures::default(), ParamStore::trainable(3));
        let error = SelfSupervised::new(&config, &model, &input, params, 3).err().unwrap();
        assert!(error.to_string().contains("model.mask_token"), "{error}");
    }
    let wide = SimDinoRowsTerm { up_cast: 1, ..<_>::default() };
    let narrow = SimDinoRowsTerm { up_cast: 0, ..<_>::default() };
    for (term, width) in [(wide, 24), (narrow, 16)] {
        let module = module(vec![TermConfig::SimDinoRows(term)], Compat::None);
        let weight = &module.params().parameters()["heads.sim_dino_rows.mlp.0.weight"];
        assert_eq!(weight.dims(), [512, width]);
    }
}
