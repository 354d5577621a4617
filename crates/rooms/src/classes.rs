//! The classes of synthetic rooms.

use serde::{Deserialize, Serialize};

/// What a class is one of; a class may be in several groups.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// Part of the building.
    Structure,
    /// Stands in the room and is moved with effort.
    Furniture,
    /// To sit on.
    Seat,
    /// Has a level top to work or eat at.
    Surface,
    /// Keeps things.
    Storage,
    /// Runs on electricity and shows or computes something.
    Electronics,
    /// Large machine of a household.
    Appliance,
    /// Belongs to a bathroom.
    Bathroom,
    /// Belongs to a kitchen.
    Kitchen,
    /// Hung or put up for its looks.
    Decoration,
    /// Made of cloth.
    Textile,
    /// Small thing that is carried with one hand or two.
    Object,
}

impl Group {
    /// All of them, in the order of their declaration.
    pub const ALL: [Self; 12] = [
        Self::Structure,
        Self::Furniture,
        Self::Seat,
        Self::Surface,
        Self::Storage,
        Self::Electronics,
        Self::Appliance,
        Self::Bathroom,
        Self::Kitchen,
        Self::Decoration,
        Self::Textile,
        Self::Object,
    ];
}

/// A class of objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SyntheticClass {
    /// Its name, in the words of ScanNet20 where that has it.
    pub name: &'static str,
    /// The class of ScanNet200 with the same meaning.
    pub scannet200_name: &'static str,
    /// What it is one of, the most telling first.
    pub groups: &'static [Group],
}

macro_rules! classes {
    ($($id:ident $name:literal $scannet:literal [$($group:ident)*];)*) => {
        /// A class; as a number it is the row of [`CLASSES`] and the value in `segment`.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u8)]
        pub enum ClassId {
            $(
                #[doc = concat!("`", $name, "`")]
                $id,
            )*
        }

        impl ClassId {
            /// All classes, in the order of [`CLASSES`].
            pub const ALL: &[Self] = &[$(Self::$id),*];
        }

        /// The classes; `segment` is the index.
        pub const CLASSES: &[SyntheticClass] = &[
            $(SyntheticClass {
                name: $name,
                scannet200_name: $scannet,
                groups: &[$(Group::$group),*],
            }),*
        ];
    };
}

classes! {
    Wall "wall" "wall" [Structure];
    Floor "floor" "floor" [Structure];
    Ceiling "ceiling" "ceiling" [Structure];
    Window "window" "window" [Structure];
    Door "door" "door" [Structure];
    Table "table" "table" [Surface Furniture];
    CoffeeTable "coffee table" "coffee table" [Surface Furniture];
    Desk "desk" "desk" [Surface Furniture];
    Chair "chair" "chair" [Seat Furniture];
    Stool "stool" "stool" [Seat Furniture];
    Sofa "sofa" "couch" [Seat Furniture];
    Bed "bed" "bed" [Furniture];
    Cabinet "cabinet" "cabinet" [Storage Furniture];
    KitchenCabinet "kitchen cabinet" "kitchen cabinet" [Storage Kitchen Furniture];
    Wardrobe "wardrobe" "wardrobe" [Storage Furniture];
    Bookshelf "bookshelf" "bookshelf" [Storage Furniture];
    Nightstand "nightstand" "nightstand" [Storage Furniture];
    TvStand "tv stand" "tv stand" [Storage Furniture];
    Tv "tv" "tv" [Electronics];
    Monitor "monitor" "monitor" [Electronics];
    Keyboard "keyboard" "keyboard" [Electronics Object];
    Laptop "laptop" "laptop" [Electronics Object];
    Lamp "lamp" "lamp" [Decoration];
    Plant "plant" "plant" [Decoration];
    Picture "picture" "picture" [Decoration];
    Mirror "mirror" "mirror" [Decoration];
    Curtain "curtain" "curtain" [Textile];
    Rug "rug" "mat" [Textile];
    Pillow "pillow" "pillow" [Textile Object];
    Book "book" "book" [Object];
    Box "box" "box" [Object];
    TrashCan "trash can" "trash can" [Object];
    Mug "mug" "cup" [Object Kitchen];
    Clock "clock" "clock" [Object];
    Radiator "radiator" "radiator" [Appliance];
    Toilet "toilet" "toilet" [Bathroom];
    Sink "sink" "sink" [Bathroom Kitchen];
    Bathtub "bathtub" "bathtub" [Bathroom];
    Refrigerator "refrigerator" "refrigerator" [Appliance Kitchen];
    Stove "stove" "stove" [Appliance Kitchen];
    RangeHood "range hood" "range hood" [Appliance Kitchen];
}

impl ClassId {
    /// Row in [`CLASSES`].
    pub fn index(self) -> usize {
        self as usize
    }

    /// What is known about the class.
    pub fn about(self) -> &'static SyntheticClass {
        &CLASSES[self.index()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_and_numbers_agree_and_names_are_unique() {
        assert_eq!(CLASSES.len(), ClassId::ALL.len());
        for (i, id) in ClassId::ALL.iter().enumerate() {
            assert_eq!(id.index(), i);
            assert!(!id.about().groups.is_empty());
        }
        let mut names: Vec<_> = CLASSES.iter().map(|c| c.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), CLASSES.len());
        for group in Group::ALL {
            assert!(CLASSES.iter().any(|c| c.groups.contains(&group)), "{group:?}");
        }
    }
}
