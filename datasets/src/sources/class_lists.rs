//! Names of classes, and the numbers they have in the raw labels of their benchmark.

/// The lists that come with the program, one name a line, also for `--class-names`.
pub(crate) const SCANNET20: &str = include_str!("../../label_maps/scannet20.txt");
pub(crate) const SCANNET200: &str = include_str!("../../label_maps/scannet200.txt");
pub(crate) const SCANNETPP100: &str = include_str!("../../label_maps/scannetpp100.txt");
pub(crate) const MATTERPORT21: &str = include_str!("../../label_maps/matterport21.txt");
pub(crate) const MATTERPORT160: &str = include_str!("../../label_maps/matterport160.txt");
pub(crate) const NYU40: &str = include_str!("../../label_maps/nyu40.txt");
pub(crate) const HOLICITY: &str = include_str!("../../label_maps/holicity.txt");
pub(crate) const KITTI360: &str = include_str!("../../label_maps/kitti360.txt");

/// NYU40 class of each ScanNet class (20); every other one is ignored.
pub const SCANNET20_NYU40_IDS: [i32; 20] =
    [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 24, 28, 33, 34, 36, 39];

/// NYU40 class of each Matterport3D class (21); every other one is ignored.
///
/// The first are those of ScanNet, but for the twentieth, `other furniture`, which is NYU40's 39 there
/// and here; the last is the ceiling.
pub const MATTERPORT21_NYU40_IDS: [i32; 21] =
    [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 24, 28, 33, 34, 36, 39, 22];

/// Raw category of each ScanNet200 class; every other one is ignored.
pub const SCANNET200_IDS: [i32; 200] = [
    1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14, 15, 16, 17, 18, 19, 21, 22, 23, 24, 26, 27, 28, 29,
    31, 32, 33, 34, 35, 36, 38, 39, 40, 41, 42, 44, 45, 46, 47, 48, 49, 50, 51, 52, 54, 55, 56, 57,
    58, 59, 62, 63, 64, 65, 66, 67, 68, 69, 70, 71, 72, 73, 74, 75, 76, 77, 78, 79, 80, 82, 84, 86,
    87, 88, 89, 90, 93, 95, 96, 97, 98, 99, 100, 101, 102, 103, 104, 105, 106, 107, 110, 112, 115,
    116, 118, 120, 121, 122, 125, 128, 130, 131, 132, 134, 136, 138, 139, 140, 141, 145, 148, 154,
    155, 156, 157, 159, 161, 163, 165, 166, 168, 169, 170, 177, 180, 185, 188, 191, 193, 195, 202,
    208, 213, 214, 221, 229, 230, 232, 233, 242, 250, 261, 264, 276, 283, 286, 300, 304, 312, 323,
    325, 331, 342, 356, 370, 392, 395, 399, 408, 417, 488, 540, 562, 570, 572, 581, 609, 748, 776,
    1156, 1163, 1164, 1165, 1166, 1167, 1168, 1169, 1170, 1171, 1172, 1173, 1174, 1175, 1176, 1178,
    1179, 1180, 1181, 1182, 1183, 1184, 1185, 1186, 1187, 1188, 1189, 1190, 1191,
];

/// Raw label of each HoliCity class; every other one is ignored.
pub const HOLICITY_IDS: [i32; 4] = [1, 2, 3, 4];

/// KITTI-360's number (`kittiId`) of each class of the list; 0 stands for no class.
pub const KITTI360_IDS: [i32; 38] = {
    let mut ids = [0; 38];
    let mut i = 0;
    while i < 38 {
        ids[i] = i as i32;
        i += 1;
    }
    ids
};

/// The names of a list.
pub(crate) fn names(list: &str) -> Vec<String> {
    list.lines().map(str::trim).filter(|line| !line.is_empty()).map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_as_long_as_their_numbers() {
        for (list, count) in [
            (SCANNET20, SCANNET20_NYU40_IDS.len()),
            (SCANNET200, SCANNET200_IDS.len()),
            (MATTERPORT21, MATTERPORT21_NYU40_IDS.len()),
            (MATTERPORT160, 160),
            (SCANNETPP100, 100),
            (HOLICITY, HOLICITY_IDS.len()),
            (KITTI360, KITTI360_IDS.len()),
        ] {
            let names = names(list);
            assert_eq!(names.len(), count);
            let set: std::collections::BTreeSet<_> = names.iter().collect();
            assert_eq!(set.len(), count, "no name twice");
        }
        assert!(SCANNET200_IDS.is_sorted());
    }

    #[test]
    fn numbers_and_names_go_together() {
        let at = |list: &str, ids: &[i32], id: i32| {
            names(list)[ids.iter().position(|&i| i == id).unwrap()].clone()
        };
        assert_eq!(at(SCANNET20, &SCANNET20_NYU40_IDS, 39), "other furniture");
        assert_eq!(at(SCANNET20, &SCANNET20_NYU40_IDS, 28), "shower curtain");
        assert_eq!(at(MATTERPORT21, &MATTERPORT21_NYU40_IDS, 22), "ceiling");
        assert_eq!(at(SCANNET200, &SCANNET200_IDS, 1), "wall");
        assert_eq!(at(SCANNET200, &SCANNET200_IDS, 1191), "mattress");
        assert_eq!(at(KITTI360, &KITTI360_IDS, 1), "road");
        assert_eq!(at(KITTI360, &KITTI360_IDS, 37), "object");
    }
}
