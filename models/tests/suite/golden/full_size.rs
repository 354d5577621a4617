//! Group g: the full-size networks with hashed weights.

use super::tiny_networks::{config, observe, outside};
use crate::support::{Tensors, eval, rng};
use candle_core::{Device, Tensor};
use scenesplat_models::weights::{WeightSource, unit};
use scenesplat_models::{
    Forward, ModelConfig, ParamStore, PointTransformerV3, PointTransformerV3Config,
};
use scenesplat_test_support::Golden;

/// Compares selected rows, the norm of every row, and every row's projection on two directions.
fn compare_rows(g: &Golden, name: &str, t: &Tensor) {
    let all = t.to_vec2::<f32>().unwrap();
    let c = all[0].len();
    match g.has(&format!("{name}.rows")) {
        true => {
            let rows: Vec<usize> = g.ints(&format!("{name}.rows"));
            let picked: Vec<f32> = rows.iter().flat_map(|r| all[*r].clone()).collect();
            g.compare(name, &picked);
        }
        false => g.compare_tensor(name, t),
    }
    if g.has(&format!("{name}.rownorm")) {
        let norms: Vec<f32> = all
            .iter()
            .map(|r| r.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt() as f32)
            .collect();
        g.compare(&format!("{name}.rownorm"), &norms);
        let p = unit(&format!("P{c}"), c * 2, g.number("seed") as u64);
        let projected: Vec<f32> = all
            .iter()
            .flat_map(|r| {
                [0, 1].map(|j| {
                    let sum: f64 = r
                        .iter()
                        .enumerate()
                        .map(|(i, v)| f64::from(*v) * f64::from(p[2 * i + j]))
                        .sum();
                    (sum / (c as f64).sqrt()) as f32
                })
            })
            .collect();
        g.compare(&format!("{name}.proj"), &projected);
    }
}

fn run(
    file: &str,
    prefix: &str,
    expected: &PointTransformerV3Config,
) -> Option<(Golden, ParamStore)> {
    let g = Golden::network(file)?;
    let mut config = config(&g);
    config.drop_path = expected.drop_path;
    assert_eq!(
        config,
        PointTransformerV3Config { batch_rule: config.batch_rule, ..expected.clone() },
        "the shipped configuration is the original's"
    );
    let source = WeightSource::hashed(g.number("seed") as u64, prefix);
    let store = ParamStore::frozen(source.clone());
    let network = PointTransformerV3::new(&config, store.builder()).unwrap();
    let points = g.points();
    let (mut seen, mut rng) = (Vec::new(), rng(0));
    let mut observer = observe(&mut seen);
    let mut cx = Forward { observer: Some(&mut observer), ..Forward::eval(&mut rng) };
    let out = network.forward_both(&points, g.mask().as_deref(), &mut cx).unwrap();
    drop(observer);
    let mut compared = 0;
    for (module, t) in seen {
        let name = format!("mid.{module}.feat");
        if g.has(&name) {
            compare_rows(&g, &name, &outside(&module, &t, &points));
            compared += 1;
        }
    }
    let stored = g.names("mid.").iter().filter(|n| n.ends_with(".feat")).count();
    assert_eq!(compared, stored);
    if g.has("out.feat") {
        compare_rows(&g, "out.feat", &out.decoder.unwrap());
    }
    if g.has("out.enc_feat") {
        g.compare_tensor("out.enc_feat", &out.encoder);
    }
    Some((g, ParamStore::frozen(source)))
}

#[test]
fn language() {
    let expected = PointTransformerV3Config::language();
    let Some((g, store)) = run("g_lang_full", "", &expected) else { return };
    let network = ModelConfig::language().build(store.builder()).unwrap();
    let report = store.report();
    // Buffers are entries of the state dict but no parameters.
    let shapes = store.shapes();
    assert_eq!(shapes.len(), 393);
    let trained: usize = shapes
        .iter()
        .filter(|(n, _)| !n.contains("running_") && !n.contains("num_batches"))
        .map(|(_, s)| s.iter().product::<usize>())
        .sum();
    assert_eq!(trained, 91_712_800);
    assert!(report.is_complete());
    assert_eq!(report.parameters, expected.num_values());
    let out = eval(&*network, &g.points());
    let rows: Vec<u32> = g.ints("out.feat.rows");
    let rows = Tensor::from_vec(rows, g.shape("out.feat.rows")[0], &Device::Cpu).unwrap();
    g.compare_tensor("out.feat_normalized", &out.index_select(&rows, 0).unwrap());
}

#[test]
fn semantic_segmentation() {
    let expected = PointTransformerV3Config::semseg();
    let Some((g, store)) = run("g_semseg_full", "backbone.", &expected) else { return };
    let network = ModelConfig::semseg().build(store.builder()).unwrap();
    assert_eq!(store.shapes().len(), 488);
    assert_eq!(store.report().parameters, ModelConfig::semseg().num_values());
    let recognized = |store: &ParamStore| ModelConfig::recognize(&store.shapes());
    assert_eq!(recognized(&store), Some(ModelConfig::semseg()));
    let out = eval(&*network, &g.points());
    g.compare_tensor("out.logits", &out);
}

#[test]
fn self_supervised() {
    run("g_ssl_full", "", &PointTransformerV3Config::ssl());
}
