//! Weight files that tests make of seeded values, under all published names.

use super::definition::{SEED, Slow, small};
use super::*;

/// Names and shapes of the trunk of [`small`].
fn trunk_names() -> Arrays {
    let slow = Slow::default();
    let part = |name: &str, shape: &[usize]| {
        slow.get(&format!("image_encoder.trunk.{name}.weight"), shape);
        slow.get(&format!("image_encoder.trunk.{name}.bias"), &shape[..1]);
    };
    part("patch_embed.proj", &[16, 3, 7, 7]);
    slow.get("image_encoder.trunk.pos_embed", &[1, 16, 7, 5]);
    slow.get("image_encoder.trunk.pos_embed_window", &[1, 16, 8, 8]);
    // Stages of 1, 2, 3 and 1 blocks: the first of each further one doubles the channels.
    for (block, (before, dim)) in
        [(16, 16), (16, 32), (32, 32), (32, 64), (64, 64), (64, 64), (64, 128)].iter().enumerate()
    {
        let part = |name: &str, shape: &[usize]| part(&format!("blocks.{block}.{name}"), shape);
        part("norm1", &[*before]);
        part("norm2", &[*dim]);
        part("attn.qkv", &[3 * dim, *before]);
        part("attn.proj", &[*dim, *dim]);
        part("mlp.layers.0", &[4 * dim, *dim]);
        part("mlp.layers.1", &[*dim, 4 * dim]);
        if before != dim {
            part("proj", &[*dim, *before]);
        }
    }
    slow.0.into_inner()
}

/// All weights of [`small`] under their published names.
fn weight_names() -> Arrays {
    let slow = Slow::default();
    let rows = slow.picture(&[256 * 16, 64 * 32, 16 * 64, 4 * 128].map(|n| vec![0.0; n]));
    slow.decode(&rows, &slow.prompt(&[([1.0, 2.0], 1)]));
    let mut all = slow.0.into_inner();
    all.extend(trunk_names());
    all
}

#[test]
fn a_weight_file_is_the_network_of_its_values_or_refused_by_name() {
    let all = weight_names();
    let file = |change: &dyn Fn(&mut Arrays)| {
        let mut all = all.clone();
        change(&mut all);
        let file = tempfile::Builder::new().suffix(".safetensors").tempfile().unwrap();
        save(&all, file.path());
        file
    };
    let load = |change: &dyn Fn(&mut Arrays)| Sam2::load(file(change).path(), small());
    let picture = RgbPicture::from_fn(40, 24, |x, y| [(5 * x) as u8, (9 * y) as u8, 77]);
    let answer = |network: &Sam2| {
        let seen = network.encode(&picture).unwrap();
        network.predict(&seen, &[vec![PromptPoint::inside([30.0, 7.0])]]).unwrap().remove(0)
    };
    let seeded = Sam2::seeded(small(), SEED, Precision::F32).unwrap();
    let loaded = load(&|_| ()).unwrap();
    assert_eq!(answer(&loaded), answer(&seeded));
    assert_eq!(loaded.config(), &small());
    // The encoder alone is packed for the other precision.
    let rough = Sam2::load_with(file(&|_| ()).path(), small(), Precision::Bf16).unwrap();
    assert_ne!(answer(&rough), answer(&seeded));
    let seen = |n: &Sam2| n.encode(&picture).unwrap();
    let prompt = [vec![PromptPoint::inside([30.0, 7.0])]];
    let (seen, at) = (seen(&seeded), &prompt[..]);
    assert_eq!(rough.predict(&seen, at).unwrap(), seeded.predict(&seen, at).unwrap());

    let add = |name: &str| {
        let name = name.to_owned();
        load(&|w| drop(w.insert(name.clone(), (vec![1], vec![0.0]))))
    };
    // What only videos and masks as prompts need is passed over; anything else is of another network.
    for unused in [
        "memory_attention.x",
        "memory_encoder.x",
        "maskmem_tpos_enc",
        "no_mem_pos_enc",
        "no_obj_ptr",
        "no_obj_embed_spatial",
        "mask_downsample.weight",
        "obj_ptr_proj.x",
        "obj_ptr_tpos_proj.x",
        "sam_prompt_encoder.mask_downscaling.0.weight",
    ] {
        add(unused).unwrap();
    }
    for foreign in ["image_encoder.x", "sam_mask_decoder.x", "sam_prompt_encoder.x", "unet.0"] {
        let error = add(foreign).unwrap_err().to_string();
        assert!(
            error.contains(&format!(
                "1 tensors that belong to no part of this network, such as {foreign}"
            )),
            "{error}"
        );
    }
    let norm = "image_encoder.trunk.blocks.3.norm2.weight";
    for (change, part) in [
        (
            (&|w: &mut Arrays| drop(w.remove(norm))) as &dyn Fn(&mut Arrays),
            format!("has no tensor {norm}"),
        ),
        (
            &|w: &mut Arrays| w.get_mut(norm).unwrap().1[5] = f32::INFINITY,
            format!("{norm}: value 5 is inf"),
        ),
        (
            &|w| w.get_mut(norm).unwrap().0 = vec![8, 8],
            format!("{norm} has shape [8, 8], [64] was expected"),
        ),
    ] {
        let error = load(change).unwrap_err().to_string();
        assert!(error.contains(&part) && error.contains("sam2.1_hiera_large.pt"), "{error}");
    }
    let file = file(&|_| ());
    let unknown = Sam2::open(file.path(), Precision::F32).unwrap_err().to_string();
    assert!(unknown.contains("16 channels in 7 blocks"), "{unknown}");
    assert!(Sam2::load(file.path(), Sam2Config { d_model: 12, ..small() }).is_err());
}
