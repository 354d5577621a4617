//! Synthetic rooms that look as converted points do.

use scenesplat_datasets::{PointSettings, SurfacePoints, gaussians_from_points};
use scenesplat_rooms::{SyntheticRoomSettings, generate};

#[test]
fn rooms_of_points_are_as_converted_points() {
    // The converter measures the spacing, the generator knows it. Rooms look as if thinned out by
    // one of a few factors, so the ratio of the two is nearly one of them.
    let mut checked = 0;
    for room in 0..6 {
        let all_points = SyntheticRoomSettings {
            points_share: 1.0,
            room,
            ..SyntheticRoomSettings::with_count(60_000, 0)
        };
        let room = generate(&all_points).unwrap();
        assert!(room.is_points);
        let cloud = SurfacePoints {
            coord: room.scene.coord.clone(),
            normal: room.scene.normal.clone(),
            ..SurfacePoints::default()
        };
        let converted = gaussians_from_points(&cloud, &PointSettings::default()).unwrap().scene;
        let mut ratios: Vec<f32> = (room.scene.log_scale.iter().zip(&converted.log_scale))
            .map(|(a, b)| a[0] - b[0])
            .collect();
        ratios.sort_by(f32::total_cmp);
        let median = ratios[ratios.len() / 2].exp();
        let factors = [1.0_f32, 0.8, 0.62, 0.5, 0.37, 0.25];
        let is_near = factors.iter().any(|f| (0.89..1.11).contains(&(median / f)));
        assert!(is_near, "{median}");
        for row in 0..room.scene.len() {
            let ours = room.scene.log_scale[row];
            let theirs = converted.log_scale[row];
            assert!((ours[0] - ours[2] - (theirs[0] - theirs[2])).abs() < 1e-5);
            assert!((room.scene.opacity_logit[row] - converted.opacity_logit[row]).abs() < 1e-5);
            for (a, b) in room.scene.quat[row].iter().zip(&converted.quat[row]) {
                assert!(
                    (a - b).abs() < 2e-3,
                    "{:?} {:?}",
                    room.scene.quat[row],
                    converted.quat[row]
                );
            }
            checked += 1;
        }
    }
    assert_eq!(checked, 360_000);
}
