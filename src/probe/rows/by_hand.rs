//! Rows, draws and objects of small scenes.

use super::tests::scene_of;
use super::*;

#[test]
fn rows_are_those_of_the_encoder_or_of_the_input_and_labels_those_of_the_scene() {
    use super::super::ProbeScenes;
    use scenesplat_datasets::SyntheticRooms;
    use scenesplat_models::{ModelConfig, ParamStore, PointTransformerV3Config};
    let stages = [[1, 8, 1], [1, 16, 2]];
    let backbone = PointTransformerV3Config::language().with_stages(&stages, &[[1, 8, 1]], 32);
    let model = ModelConfig { grid_size: 0.3, ..ModelConfig::new(backbone) };
    let config = NetworkConfig { model, ..NetworkConfig::language() };
    let room =
        scenesplat_rooms::SyntheticRoomSettings { num_gaussians: Some(500), ..Default::default() };
    let rooms = std::sync::Arc::new(SyntheticRooms::new(2, room, 3).unwrap());
    let (data, _) = ProbeScenes::new(rooms, 0.3, Some(1)).unwrap().split().unwrap();
    let network = config.model.build(ParamStore::trainable(0).builder()).unwrap();
    let sample = data.get(0, 0).unwrap();
    let full = sample.full.clone().unwrap();
    assert!(full.len() > sample.len() && sample.grid_size == 0.3);
    for source in [RowSource::Network(network.as_ref()), RowSource::Inputs] {
        let read = read(data.as_ref(), &config, source).unwrap();
        let scene = &read[0];
        assert_eq!((read.len(), scene.id.as_str()), (1, "room-000000"));
        assert_eq!(
            (Some(&scene.labels), &scene.instances),
            (sample.segment.as_ref(), &sample.instance)
        );
        assert_eq!((&scene.voxel_of, Some(&scene.truth)), (&full.voxel, full.segment.as_ref()));
        let rows = scene.rows.to_vec2::<f32>().unwrap();
        match source {
            RowSource::Inputs => {
                // The height comes last: 11 channels of the network before it.
                assert_eq!((rows[0].len(), scene.batch.channels), (12, 12));
                assert_eq!(rows.concat(), scene.batch.feat);
                assert!(
                    rows.iter().all(|row| row[11] >= 0.0) && rows.iter().any(|row| row[11] > 1.0)
                );
            }
            RowSource::Network(network) => {
                assert_eq!(scene.batch.channels, 11);
                let mut rng = ChaCha8Rng::seed_from_u64(9);
                let options = LevelOptions { mask: None, decoder: false };
                let points = point_cloud(&scene.batch).unwrap();
                let levels =
                    network.forward_levels(&points, options, &mut Forward::eval(&mut rng)).unwrap();
                assert_eq!(rows, levels.up_cast(0).unwrap().to_vec2::<f32>().unwrap());
                assert_eq!(rows[0].len(), 8 + 16);
            }
        }
    }
}

#[test]
fn each_labelled_row_is_as_likely_and_each_scene_draws_its_own() {
    let labels = [1, -1, 0, 2, -1, 3];
    let scenes = [scene_of(&labels, &labels), scene_of(&labels, &labels)];
    let mut counts = [0; 6];
    let mut apart = 0;
    for seed in 0..400 {
        let [one, other] = [0, 1].map(|stream| {
            let rows = chosen_rows(&scenes[0], LabelRegime::PerScene(2), seed, stream);
            assert!(rows.len() == 2 && rows[0] < rows[1], "{rows:?}");
            rows
        });
        one.iter().for_each(|row| counts[*row as usize] += 1);
        apart += usize::from(one != other);
        let learned = choose(&scenes, LabelRegime::PerScene(2), seed).unwrap();
        let want: Vec<i32> = one.iter().chain(&other).map(|row| labels[*row as usize]).collect();
        assert_eq!(learned.labels, want, "the second scene is stream 1");
    }
    // Of 400 draws of two of four rows each is there in about 200, and two draws differ in five of six.
    assert!([0, 2, 3, 5].iter().all(|row| (160..240).contains(&counts[*row])), "{counts:?}");
    assert!(counts[1] + counts[4] == 0 && (290..375).contains(&apart), "{counts:?} {apart}");
}

#[test]
fn objects_stand_scene_by_scene_in_the_order_of_their_numbers() {
    // Rows (0, 1), (2, 3), (4, 5), (6, 7), (8, 9). Object 2 has a 3 and a 1, which is the smaller.
    let first = scene_of(&[3, 0, 1, 4, 4], &[2, 0, 2, 9, -1]);
    let none = ProbeScene { instances: None, ..scene_of(&[7], &[0]) };
    let found = objects(&[first, none, scene_of(&[2, 5, 5], &[0, 0, 0])]).unwrap().unwrap();
    assert_eq!(found.labels, [0, 1, 4, 5]);
    let rows = found.rows.to_vec2::<f32>().unwrap();
    assert_eq!(rows, [[2.0, 3.0], [2.0, 3.0], [6.0, 7.0], [2.0, 3.0]]);
    let learned = found.learned();
    assert_eq!((learned.labels, learned.rows.dims()), (vec![0, 1, 4, 5], &[4, 2][..]));
}
