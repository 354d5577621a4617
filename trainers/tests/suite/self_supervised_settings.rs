//! Settings of self-supervised training: defaults, names, what each term needs, and what is refused.

use scenesplat_datasets::{MaskShape, Masking};
use scenesplat_losses::self_supervised::{Expansion, GaussianDistance};
use scenesplat_trainers::CosineSchedule;
use scenesplat_trainers::tasks::autoencoder::AutoencoderConfig;
use scenesplat_trainers::tasks::self_supervised::{
    Balance, Compat, DinoTerm, Export, GaussianHeads, IbotCrossEntropyTerm, IbotTerm,
    LanguageAlignmentTerm, MaskedGaussiansTerm, Prototypes, SelfDistillationTerm,
    SelfSupervisedConfig, SimDinoRowsTerm, SimDinoTerm, TermConfig, is_head,
};

/// What a test does to good settings.
type Change = fn(&mut Prototypes);

fn all() -> [TermConfig; 8] {
    [
        TermConfig::MaskedGaussians(MaskedGaussiansTerm { weight: 2.0, ..<_>::default() }),
        TermConfig::SimDino(SimDinoTerm { weight: 3.0, ..<_>::default() }),
        TermConfig::Dino(DinoTerm { weight: 4.0, ..<_>::default() }),
        TermConfig::Ibot(IbotTerm { weight: 5.0, ..<_>::default() }),
        TermConfig::IbotCrossEntropy(IbotCrossEntropyTerm { weight: 6.0, ..<_>::default() }),
        TermConfig::SelfDistillation(SelfDistillationTerm { weight: 7.0, ..<_>::default() }),
        TermConfig::SimDinoRows(SimDinoRowsTerm { weight: 8.0, ..<_>::default() }),
        TermConfig::LanguageAlignment(LanguageAlignmentTerm { weight: 9.0, ..<_>::default() }),
    ]
}

#[test]
fn defaults_are_those_of_the_original_and_of_sonata() {
    let config = SelfSupervisedConfig {
        compat: Compat::None,
        export: Export::Student,
        momentum: CosineSchedule::new(0.9, 1.0),
        masking: Some(Masking::default()),
        mask_size: None,
        mask_ratio: None,
        terms: Vec::new(),
    };
    assert_eq!(SelfSupervisedConfig::default(), config);
    let (distance, heads) = (GaussianDistance::MeanSquare, GaussianHeads::Joint);
    assert_eq!(
        MaskedGaussiansTerm::default(),
        MaskedGaussiansTerm { weight: 1.0, distance, heads }
    );
    let expansion = Expansion::StudentAndTeacher;
    let (weight, epsilon) = (1.0, 0.05);
    let sim = SimDinoTerm { weight, hidden: 2048, out: 256, coefficient: 0.1, epsilon, expansion };
    assert_eq!(SimDinoTerm::default(), sim);
    let warm = CosineSchedule { warmup: 0.6, warmup_from: 0.04, from: 0.07, to: 0.07 };
    let prototypes = Prototypes {
        count: 1024,
        hidden: 2048,
        out: 256,
        student_temperature: 0.1,
        teacher_temperature: warm,
        balance: Balance::SinkhornKnopp(3),
    };
    assert_eq!(DinoTerm::default(), DinoTerm { weight, prototypes: prototypes.clone() });
    assert_eq!(IbotTerm::default(), IbotTerm { weight, hidden: 256, out: 32 });
    let small = Prototypes { hidden: 256, out: 32, ..prototypes };
    assert_eq!(IbotCrossEntropyTerm::default(), IbotCrossEntropyTerm { weight, prototypes: small });
    // 4096 prototypes, the temperature over the first 5 %, partners within 0.32 m, shares 2, 2 and 4 of 8.
    let teacher_temperature = CosineSchedule { warmup: 0.05, ..warm };
    let sonata = Prototypes { count: 4096, hidden: 4096, teacher_temperature, ..prototypes };
    let (up_cast, max_distance, shares) = (2, 0.32, [0.25, 0.25, 0.5]);
    let term = SelfDistillationTerm { weight, prototypes: sonata, up_cast, max_distance, shares };
    assert_eq!(SelfDistillationTerm::default(), term);
    let rows = SimDinoRowsTerm {
        weight,
        hidden: 512,
        out: 128,
        coefficient: 1.0,
        epsilon,
        expansion,
        max_rows: 1024,
        up_cast,
        max_distance,
        shares,
    };
    assert_eq!(SimDinoRowsTerm::default(), rows);
    let alignment = LanguageAlignmentTerm { weight, out: 16, hidden: 32, masked_only: true };
    assert_eq!(LanguageAlignmentTerm::default(), alignment);
    let widths = vec![768, 384, 192, 96, 48, 16];
    assert_eq!(AutoencoderConfig::default(), AutoencoderConfig { widths, l2: 1.0, cosine: 1.0 });
    let bad = [(-0.1, 1.0), (1.0, -0.1), (f64::NAN, 1.0), (1.0, f64::INFINITY), (0.0, 0.0)];
    for (l2, cosine) in bad {
        assert!(
            AutoencoderConfig { l2, cosine, ..<_>::default() }.check().is_err(),
            "{l2} {cosine}"
        );
    }
    assert!(AutoencoderConfig { l2: 0.0, ..<_>::default() }.check().is_ok());
    assert!(AutoencoderConfig { cosine: 0.0, ..<_>::default() }.check().is_ok());
    assert!(
        is_head("heads.ibot.0")
            && !is_head("heads")
            && !is_head("headset.x")
            && !is_head("enc.heads.x")
    );
}

#[test]
fn terms_have_their_names_weights_and_needs() {
    // Name, teacher, rows of the finest scale, masks.
    let want = [
        ("masked_gaussians", false, true, true),
        ("sim_dino", true, false, false),
        ("dino", true, false, false),
        ("ibot", true, true, true),
        ("ibot_cross_entropy", true, true, true),
        ("self_distillation", true, false, false),
        ("sim_dino_rows", true, false, false),
        ("language_alignment", false, true, true),
    ];
    for (i, (term, (name, teacher, rows, mask))) in all().into_iter().zip(want).enumerate() {
        assert_eq!((term.name(), term.weight()), (name, i as f64 + 2.0));
        let needs = (term.has_teacher(), term.reads_rows(), term.needs_mask());
        assert_eq!(needs, (teacher, rows, mask), "{name}");
        let written = serde_json::to_value(&term).unwrap();
        assert_eq!(written["type"], name);
        assert_eq!(serde_json::from_value::<TermConfig>(written).unwrap(), term);
        let config = SelfSupervisedConfig { terms: vec![term], ..<_>::default() };
        assert_eq!(config.has_teacher(), teacher, "{name}");
        config.check().unwrap();
        let seeing = SelfSupervisedConfig { masking: None, ..config };
        assert_eq!(seeing.check().is_ok(), !mask, "{name}");
    }
    let whole = LanguageAlignmentTerm { masked_only: false, ..<_>::default() };
    assert!(!TermConfig::LanguageAlignment(whole).needs_mask());
}

#[test]
fn each_setting_is_refused_by_its_own_name() {
    let refused = |config: &SelfSupervisedConfig| config.check().err().map(|e| e.to_string());
    let with = |term: TermConfig| SelfSupervisedConfig { terms: vec![term], ..<_>::default() };
    let prototypes = |change: fn(&mut Prototypes)| {
        let mut p = Prototypes::default();
        change(&mut p);
        [
            TermConfig::Dino(DinoTerm { weight: 1.0, prototypes: p.clone() }),
            TermConfig::IbotCrossEntropy(IbotCrossEntropyTerm {
                weight: 1.0,
                prototypes: p.clone(),
            }),
            TermConfig::SelfDistillation(SelfDistillationTerm { prototypes: p, ..<_>::default() }),
        ]
    };
    let changes: [(&str, Change); 9] = [
        ("prototypes.count", |p| p.count = 0),
        ("prototypes.hidden", |p| p.hidden = 65_537),
        ("prototypes.out", |p| p.out = 0),
        ("prototypes.student_temperature", |p| p.student_temperature = 0.0),
        ("prototypes.teacher_temperature.from", |p| p.teacher_temperature.from = 0.0),
        ("prototypes.teacher_temperature.to", |p| p.teacher_temperature.to = -1.0),
        ("prototypes.teacher_temperature.warmup_from", |p| p.teacher_temperature.warmup_from = 0.0),
        ("prototypes.balance.centering", |p| p.balance = Balance::Centering(1.01)),
        ("warmup", |p| p.teacher_temperature.warmup = 1.5),
    ];
    for (field, change) in changes {
        for term in prototypes(change) {
            let error = refused(&with(term.clone())).unwrap();
            assert!(error.starts_with(&format!("{field} is")), "{}: {error}", term.name());
        }
    }
    // Without a warm-up its first value is not looked at; a center may be kept whole or not at all.
    let good: [Change; 3] = [
        |p| (p.teacher_temperature.warmup, p.teacher_temperature.warmup_from) = (0.0, 0.0),
        |p| p.balance = Balance::Centering(1.0),
        |p| (p.balance, p.count) = (Balance::Centering(0.0), 65_536),
    ];
    for change in good {
        assert!(prototypes(change).into_iter().all(|term| refused(&with(term)).is_none()));
    }
    let (sim, rows) = (SimDinoTerm::default, SimDinoRowsTerm::default);
    let distillation = |shares, max_distance| {
        TermConfig::SelfDistillation(SelfDistillationTerm {
            shares,
            max_distance,
            ..<_>::default()
        })
    };
    for (field, term) in [
        ("weight", TermConfig::Ibot(IbotTerm { weight: 0.0, ..<_>::default() })),
        ("hidden", TermConfig::Ibot(IbotTerm { hidden: 0, ..<_>::default() })),
        ("out", TermConfig::Ibot(IbotTerm { out: 0, ..<_>::default() })),
        (
            "hidden",
            TermConfig::LanguageAlignment(LanguageAlignmentTerm { hidden: 0, ..<_>::default() }),
        ),
        ("out", TermConfig::LanguageAlignment(LanguageAlignmentTerm { out: 0, ..<_>::default() })),
        ("hidden", TermConfig::SimDino(SimDinoTerm { hidden: 0, ..sim() })),
        ("out", TermConfig::SimDino(SimDinoTerm { out: 0, ..sim() })),
        ("epsilon", TermConfig::SimDino(SimDinoTerm { epsilon: -1.0, ..sim() })),
        ("coefficient", TermConfig::SimDino(SimDinoTerm { coefficient: f64::NAN, ..sim() })),
        (
            "coefficient",
            TermConfig::SimDinoRows(SimDinoRowsTerm { coefficient: f64::INFINITY, ..rows() }),
        ),
        ("out", TermConfig::SimDinoRows(SimDinoRowsTerm { out: 0, ..rows() })),
        ("hidden", TermConfig::SimDinoRows(SimDinoRowsTerm { hidden: 0, ..rows() })),
        ("shares", distillation([0.5, -0.1, 0.5], 0.3)),
        ("shares", distillation([0.0; 3], 0.3)),
        ("max_distance", distillation([0.5; 3], 0.0)),
    ] {
        let error = refused(&with(term)).unwrap();
        assert!(error.starts_with(&format!("{field} is")), "{field}: {error}");
    }
    assert_eq!(
        refused(&with(TermConfig::SimDino(SimDinoTerm { coefficient: -1.0, ..sim() }))),
        None
    );

    let plain = || with(TermConfig::Ibot(IbotTerm::default()));
    let of = |from, to| CosineSchedule { warmup: 0.0, warmup_from: 0.5, from, to };
    let [low, high] = [of(-0.1, 0.5), of(0.5, 1.1)];
    let gaussians = Masking { shape: MaskShape::Gaussians, ..Masking::default() };
    let first = CosineSchedule { warmup_from: 0.0, ..of(0.5, 0.5) };
    let beyond = CosineSchedule { warmup_from: 1.5, ..of(0.5, 0.5) };
    let alone = with(TermConfig::MaskedGaussians(MaskedGaussiansTerm::default()));
    let unmasked = |term| SelfSupervisedConfig { masking: None, ..with(term) };
    for (says, config) in [
        ("momentum is -0.1", SelfSupervisedConfig { momentum: low, ..plain() }),
        ("momentum is 1.1", SelfSupervisedConfig { momentum: high, ..plain() }),
        ("no term has a teacher", SelfSupervisedConfig { export: Export::Teacher, ..alone }),
        (
            "mask_size and mask_ratio vary",
            SelfSupervisedConfig {
                mask_size: Some(of(0.1, 0.1)),
                ..unmasked(TermConfig::SimDino(sim()))
            },
        ),
        (
            "mask_size and mask_ratio vary",
            SelfSupervisedConfig {
                mask_ratio: Some(of(0.1, 0.1)),
                ..unmasked(TermConfig::SimDino(sim()))
            },
        ),
        (
            "single Gaussians are masked",
            SelfSupervisedConfig {
                masking: Some(gaussians),
                mask_size: Some(of(0.1, 0.1)),
                ..plain()
            },
        ),
        ("mask_size is 0", SelfSupervisedConfig { mask_size: Some(of(0.1, 0.0)), ..plain() }),
        ("mask_size is -0.1", SelfSupervisedConfig { mask_size: Some(low), ..plain() }),
        ("mask_size is 0", SelfSupervisedConfig { mask_size: Some(first), ..plain() }),
        ("mask_ratio is -0.1", SelfSupervisedConfig { mask_ratio: Some(low), ..plain() }),
        ("mask_ratio is 1.1", SelfSupervisedConfig { mask_ratio: Some(high), ..plain() }),
        ("mask_ratio is 1.5", SelfSupervisedConfig { mask_ratio: Some(beyond), ..plain() }),
        (
            "masking",
            SelfSupervisedConfig {
                masking: Some(Masking { scenes: 2.0, ..<_>::default() }),
                ..plain()
            },
        ),
    ] {
        let error = refused(&config).unwrap();
        assert!(error.contains(says), "{says}: {error}");
    }
    let teacher = SelfSupervisedConfig { export: Export::Teacher, ..plain() };
    assert_eq!(refused(&teacher), None);
    // The size of patches over the run, too, and nothing where nothing is masked.
    let sized = SelfSupervisedConfig { mask_size: Some(CosineSchedule::new(0.25, 0.5)), ..plain() };
    let at = |step| sized.masking_at(step, 10).unwrap();
    assert_eq!((at(0).shape, at(10).shape), (MaskShape::Patches(0.25), MaskShape::Patches(0.5)));
    assert_eq!((at(0).ratio, at(0).scenes), (Masking::default().ratio, 0.5));
    assert_eq!(unmasked(TermConfig::SimDino(sim())).masking_at(0, 10), None);
}
