//! What the files of a folder say: defaults, limits, and what follows from each number.

use super::*;
use crate::resize::{Filter, resize, resize_planes};
use crate::siglip::config::{Config, Preprocessor, Tower};

fn read(change: impl Fn(&mut Value)) -> Result<Config, String> {
    let folder = tempfile::tempdir().unwrap();
    let mut config = numbers()["config"].clone();
    change(&mut config);
    write(&folder, "config.json", &config);
    Config::read(folder.path()).map_err(|error| error.to_string())
}

#[test]
fn what_a_file_leaves_out_is_the_default_of_the_class() {
    // As the published siglip2-base-patch16-512 has it.
    let config = read(|c| {
        *c = json!({"text_config": {"vocab_size": 256_000}, "vision_config": {"image_size": 512}});
    })
    .unwrap();
    for (tower, image_size, vocab_size) in
        [(&config.text_config, 224, 256_000), (&config.vision_config, 512, 32_000)]
    {
        let Tower { hidden_size, intermediate_size, num_hidden_layers, .. } = *tower;
        assert_eq!((hidden_size, intermediate_size, num_hidden_layers), (768, 3072, 12));
        assert_eq!((tower.num_attention_heads, tower.patch_size, tower.num_channels), (12, 16, 3));
        assert_eq!((tower.image_size, tower.vocab_size), (image_size, vocab_size));
        assert_eq!((tower.layer_norm_eps, tower.max_position_embeddings), (1e-6, 64));
        assert_eq!((tower.vision_use_head, tower.projection_size), (true, None));
        assert_eq!(tower.hidden_act, "gelu_pytorch_tanh");
    }
}

#[test]
fn sizes_beyond_any_known_model_are_refused_by_name() {
    // The largest and one more, of either tower.
    let limits = [
        ("hidden_size", 8192),
        ("intermediate_size", 32_768),
        ("num_hidden_layers", 256),
        ("vocab_size", 1 << 21),
        ("max_position_embeddings", 8192),
        ("patch_size", 256),
        ("image_size", 4096),
    ];
    for (tower, (key, most)) in
        ["text_config", "vision_config"].into_iter().flat_map(|t| limits.map(|limit| (t, limit)))
    {
        let with = |value: usize| {
            read(|c| {
                // A picture has to hold a patch, and the width has to be shared by the heads.
                c[tower]["image_size"] = json!(4096);
                c[tower]["num_attention_heads"] = json!(1);
                c[tower][key] = json!(value);
            })
            .map(drop)
        };
        assert_eq!(with(most), Ok(()), "{tower}.{key}");
        for bad in [0, most + 1] {
            let error = with(bad).unwrap_err();
            let part = format!("{tower}.{key} is {bad}, 1 to {most} are possible");
            assert!(error.contains(&part) && error.contains("config.json"), "{error}");
        }
    }
    let other = |key: &str, value: Value| {
        let error = read(|c| c["vision_config"][key] = value.clone()).unwrap_err();
        let text = matches!(key, "num_attention_heads" | "hidden_act" | "layer_norm_eps")
            .then(|| read(|c| c["text_config"][key] = value.clone()).unwrap_err());
        // The same of either tower.
        let said = |error: &str| error.split_once("config.json: ").unwrap().1.to_owned();
        let same = said(&error).replace("vision_config", "text_config");
        assert!(text.is_none_or(|text| said(&text) == same));
        error
    };
    for (key, value, part) in [
        ("num_attention_heads", json!(257), "num_attention_heads is 257, 1 to 256"),
        ("num_attention_heads", json!(5), "hidden_size 24 is no multiple of num_attention_heads 5"),
        ("hidden_act", json!("gelu"), "hidden_act is \"gelu\", only \"gelu_pytorch_tanh\""),
        ("layer_norm_eps", json!(1.0), "layer_norm_eps is 1"),
        ("layer_norm_eps", json!(-0.5), "layer_norm_eps is -0.5"),
        ("num_channels", json!(1), "num_channels 1"),
        ("vision_use_head", json!(false), "vision_use_head false"),
        ("image_size", json!(7), "image_size 7"),
    ] {
        let error = other(key, value);
        assert!(error.contains(part), "{error}");
    }
    assert!(read(|c| c["vision_config"]["image_size"] = json!(8)).is_ok());
    assert!(
        read(|c| c["model_type"] = json!("clip")).unwrap_err().contains("model_type is \"clip\"")
    );
    assert!(read(|c| *c = json!([1])).unwrap_err().contains("is not what SigLIP's folders hold"));
}

fn preprocessor(value: &Value) -> Result<Preprocessor, String> {
    let folder = tempfile::tempdir().unwrap();
    write(&folder, "preprocessor_config.json", value);
    Preprocessor::read(folder.path(), 34).map_err(|error| error.to_string())
}

#[test]
fn pictures_are_brought_to_size_as_the_processor_says() {
    let picture = &pictures()[3];
    let folder = tempfile::tempdir().unwrap();
    let default = Preprocessor::read(folder.path(), 34).unwrap();
    let own = json!({"resample": 3, "image_mean": [0.5, 0.25, 0.0], "image_std": [0.5, 0.25, 2.0],
                     "size": {"height": 34, "width": 34}});
    // Of 8 bits, and not rounded: by default bilinear to −1 … 1.
    for (found, filter, mean, std) in [
        (&default, Filter::Bilinear, [0.5; 3], [0.5; 3]),
        (&preprocessor(&json!({})).unwrap(), Filter::Bilinear, [0.5; 3], [0.5; 3]),
        (&preprocessor(&own).unwrap(), Filter::Bicubic, [0.5, 0.25, 0.0], [0.5, 0.25, 2.0]),
    ] {
        let small = resize(picture, 34, 34, filter).unwrap();
        let exact = resize_planes(picture, 34, 34, filter).unwrap();
        let (rounded, free) =
            (found.planes(picture, 34, true).unwrap(), found.planes(picture, 34, false).unwrap());
        assert_eq!((rounded.len(), free.len()), (3 * 34 * 34, 3 * 34 * 34));
        for (i, (a, b)) in rounded.iter().zip(&free).enumerate() {
            let (c, at) = (i / (34 * 34), i % (34 * 34));
            let unit = f32::from(small.pixels()[at][c]) / 255.0;
            assert!((a - (unit - mean[c]) / std[c]).abs() < 1e-6, "{i}: {a}");
            assert!((b - (exact[i] - mean[c]) / std[c]).abs() < 1e-6, "{i}: {b}");
        }
    }
    for (value, part) in [
        (json!({"do_resize": false}), "leaves out one of"),
        (json!({"do_rescale": false}), "leaves out one of"),
        (json!({"do_normalize": false}), "leaves out one of"),
        (json!({"resample": 1}), "resample is 1, 2 (bilinear) and 3 (bicubic)"),
        (json!({"rescale_factor": 0.00393}), "rescale_factor is 0.00393"),
        (json!({"rescale_factor": 1.0}), "rescale_factor is 1"),
        (json!({"image_std": [0.5, 0.0, 0.5]}), "image_mean or image_std"),
        (json!({"image_std": [-0.5, 0.5, 0.5]}), "image_mean or image_std"),
        (json!({"size": {"height": 34, "width": 35}}), "size is 35 × 34, the network's"),
        (json!({"size": {"height": 33, "width": 34}}), "size is 34 × 33"),
    ] {
        let error = preprocessor(&value).unwrap_err();
        assert!(error.contains(part) && error.contains("preprocessor_config.json"), "{error}");
    }
    assert!(preprocessor(&json!({"rescale_factor": 0.003_921_568_6})).is_ok());
}

#[test]
fn a_row_is_the_direction_of_what_the_network_gives() {
    let folder = folder(|_| ());
    let encoder = SiglipImageEncoder::load(folder.path(), Precision::F32).unwrap();
    let pictures = pictures();
    let planes = |rounded: bool| -> Vec<Vec<f32>> {
        let plane = |p: &RgbPicture| match rounded {
            true => {
                let small = resize(p, 34, 34, Filter::Bilinear).unwrap();
                let value = |i: usize| f32::from(small.pixels()[i % 1156][i / 1156]) / 255.0;
                (0..3 * 1156).map(|i| 2.0 * value(i) - 1.0).collect()
            }
            false => {
                let exact = resize_planes(p, 34, 34, Filter::Bilinear).unwrap();
                exact.iter().map(|v| 2.0 * v - 1.0).collect()
            }
        };
        pictures.iter().map(plane).collect()
    };
    let rows = encoder.encode_unscaled(&pictures).unwrap();
    close(&rows, &encoder.forward(&planes(true)));
    for (row, unit) in rows.chunks(24).zip(encoder.encode(&pictures).unwrap().chunks(24)) {
        let norm = row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt() as f32;
        assert!(row.iter().zip(unit).all(|(v, u)| (v / norm - u).abs() < 1e-6));
    }
    let encoder = encoder.with_resizing(Resizing::Torchvision);
    let exact = encoder.encode_unscaled(&pictures).unwrap();
    assert_ne!(exact, rows);
    let want = encoder.forward(&planes(false));
    assert!(exact.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-5));
    assert_eq!((encoder.image_size(), Resizing::default()), (34, Resizing::Pillow));
}

#[test]
fn weights_without_a_direction_are_told_by_the_picture_or_text() {
    // All of the head is 0, so both towers answer 0 to everything.
    let folder = folder(|t| {
        let of_heads = |n: &&String| n.contains("_model.head.") && !n.contains("norm");
        let names: Vec<String> = t.keys().filter(of_heads).cloned().collect();
        names.iter().for_each(|name| t.get_mut(name).unwrap().1.fill(0.0));
    });
    let image = SiglipImageEncoder::load(folder.path(), Precision::F32).unwrap();
    let error = image.encode(&pictures()).unwrap_err().to_string();
    assert!(error.contains("number 0 has no vector"), "{error}");
    let text = SiglipTextEncoder::load(folder.path(), Precision::F32).unwrap();
    let error = text.encode(&["a red chair"]).unwrap_err().to_string();
    assert!(error.contains("\"a red chair\" has no vector"), "{error}");
    assert!(text.encode(&["red", " \t"]).unwrap_err().to_string().contains("says nothing"));
    assert!(text.encode::<&str>(&[]).unwrap().is_empty());
}

#[test]
fn more_texts_than_go_at_once_have_the_rows_of_each_alone() {
    let folder = folder(|_| ());
    let text = SiglipTextEncoder::load(folder.path(), Precision::F32).unwrap();
    let words = ["this", "is", "a", "chair", "red", "unknown"];
    let texts: Vec<String> = (0..70)
        .map(|i| format!("{} {} {}", words[i % 6], words[i / 6 % 6], words[i / 36 % 6]))
        .collect();
    let rows = text.encode(&texts).unwrap();
    for i in [0, 31, 32, 63, 64, 69] {
        assert_eq!(rows[24 * i..24 * (i + 1)], text.encode(&texts[i..=i]).unwrap(), "{i}");
    }
    // Eleven words and the end are twelve pieces; one word more is cut.
    let cut = |count: usize| text.is_cut(&"red ".repeat(count)).unwrap();
    assert_eq!((cut(11), cut(12)), (false, true));
    assert!(text.is_cut("").is_err());
}

#[test]
fn a_text_tower_may_have_vectors_of_another_width_and_a_tokenizer_of_its_own() {
    let mut config = numbers()["config"].clone();
    config["text_config"]["projection_size"] = json!(5);
    let wide = folder(|t| {
        t.insert("text_model.head.weight".to_owned(), (vec![5, 24], unit("head", 120, 1)));
        t.insert("text_model.head.bias".to_owned(), (vec![5], vec![0.1; 5]));
    });
    write(&wide, "config.json", &config);
    // Without <pad> the end stands for it.
    let mut own = tokenizer();
    own["added_tokens"] = json!([]);
    let vocab = own["model"]["vocab"].as_object_mut().unwrap();
    vocab.remove("<pad>");
    vocab.insert("</s>".to_owned(), json!(39));
    write(&wide, "tokenizer.json", &own);
    let load = |f: &tempfile::TempDir| SiglipTextEncoder::load(f.path(), Precision::F32);
    let text = load(&wide).unwrap();
    assert_eq!((text.width(), text.encode(&["red", "a chair"]).unwrap().len()), (5, 10));
    assert_eq!(text.token_ids("red").unwrap()[..4], [8, 1, 39, 39]);
    let bad = |change: &dyn Fn(&mut serde_json::Map<String, Value>)| {
        let mut other = own.clone();
        change(other["model"]["vocab"].as_object_mut().unwrap());
        write(&wide, "tokenizer.json", &other);
        load(&wide).unwrap_err().to_string()
    };
    let error = bad(&|v| drop(v.remove("</s>")));
    assert!(error.contains("has no <pad>") && error.contains("tokenizer.json"), "{error}");
    std::fs::write(wide.path().join("tokenizer.json"), "{}").unwrap();
    assert!(load(&wide).unwrap_err().to_string().contains("is no tokenizer"));
    // The picture tower beside it may have anything, what is the text's may not.
    let extra = |name: &'static str| {
        let with = folder(move |t| drop(t.insert(name.to_owned(), (vec![1], vec![0.0]))));
        let (image, text) = (SiglipImageEncoder::load(with.path(), Precision::F32), load(&with));
        (image.is_ok(), text.is_ok())
    };
    assert_eq!(extra("vision_model.extra"), (false, true));
    assert_eq!(extra("text_model.extra"), (true, false));
    assert_eq!(extra("text_model.embeddings.position_ids"), (true, true));
    assert_eq!(extra("vision_model.embeddings.position_ids"), (true, true));
    assert_eq!(extra("logit_extra"), (true, false));
    assert_eq!(extra("other"), (false, false));
}
