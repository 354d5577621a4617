//! From the names in a checkpoint to the names of our networks: a table, read top to bottom.
//!
//! Our names are those of the original backbone without any wrapper's prefix
//! (`enc.enc0.block0.attn.qkv.weight`), plus `seg_head.*` for segmentation.

/// What to do with names that start with a prefix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NameAction {
    /// Cut the prefix off and look again.
    Strip,
    /// Cut it off if this half of a student–teacher pair was asked for, else ignore the entry.
    StripIf(Branch),
    /// The entry is no weight of the network.
    Ignore,
}

/// The two halves of a self-supervised checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Branch {
    /// The averaged network: the usual choice.
    #[default]
    Teacher,
    /// The trained network.
    Student,
}

/// One line of the table.
#[derive(Debug, Clone, Copy)]
pub struct NameRule {
    /// Start of the name.
    pub prefix: &'static str,
    /// What to do.
    pub action: NameAction,
    /// Where such names come from.
    pub origin: &'static str,
}

/// The table.
pub const RULES: &[NameRule] = &[
    rule("state_dict.", NameAction::Strip, "trainer checkpoint"),
    rule("module.", NameAction::Strip, "data-parallel training"),
    rule("_orig_mod.", NameAction::Strip, "compiled module"),
    rule("backbone.", NameAction::Strip, "language or segmentation wrapper"),
    rule(
        "backbone_teacher.",
        NameAction::StripIf(Branch::Teacher),
        "self-supervised pair: teacher",
    ),
    rule(
        "backbone_student.",
        NameAction::StripIf(Branch::Student),
        "self-supervised pair: student",
    ),
    rule("mae_head.", NameAction::Ignore, "self-supervised reconstruction head"),
    rule("dino_head.", NameAction::Ignore, "self-supervised projection head"),
    rule("ibot_head.", NameAction::Ignore, "self-supervised patch head"),
    rule("optimizer.", NameAction::Ignore, "optimizer state"),
    rule("scheduler.", NameAction::Ignore, "learning-rate schedule"),
    rule("scaler.", NameAction::Ignore, "mixed-precision scaler"),
];

const fn rule(prefix: &'static str, action: NameAction, origin: &'static str) -> NameRule {
    NameRule { prefix, action, origin }
}

/// Result of [`rename`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Renamed {
    /// A weight, by our name.
    Weight(String),
    /// No weight of the network; why.
    Ignored(&'static str),
}

/// Applies the table to a name.
pub fn rename(name: &str, branch: Branch) -> Renamed {
    let mut rest = name;
    'again: loop {
        for rule in RULES {
            if let Some(cut) = rest.strip_prefix(rule.prefix) {
                match rule.action {
                    NameAction::Strip => {}
                    NameAction::StripIf(wanted) if wanted == branch => {}
                    NameAction::StripIf(_) | NameAction::Ignore => {
                        return Renamed::Ignored(rule.origin);
                    }
                }
                rest = cut;
                continue 'again;
            }
        }
        return Renamed::Weight(rest.to_owned());
    }
}

/// How a checkpoint stores the weights of sparse convolutions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ConvLayout {
    /// `[out, kx, ky, kz, in]`: spconv 2.2 and later, and ours.
    #[default]
    OutKernelIn,
    /// `[kx, ky, kz, in, out]`: spconv 1.x and 2.0–2.1.
    KernelInOut,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrappers_are_peeled_in_any_nesting() {
        let weight = |n: &str| Renamed::Weight(n.to_owned());
        let teacher = Branch::Teacher;
        assert_eq!(rename("module.backbone.enc.enc0.x", teacher), weight("enc.enc0.x"));
        assert_eq!(rename("_orig_mod.module.backbone.enc.x", teacher), weight("enc.x"));
        assert_eq!(rename("module.backbone._orig_mod.enc.x", teacher), weight("enc.x"));
        assert_eq!(rename("enc.enc0.x", teacher), weight("enc.enc0.x"));
        assert_eq!(rename("seg_head.weight", teacher), weight("seg_head.weight"));
        assert_eq!(rename("module.backbone_teacher.mask_token", teacher), weight("mask_token"));
        assert!(matches!(rename("backbone_student.mask_token", teacher), Renamed::Ignored(_)));
        assert_eq!(rename("backbone_student.mask_token", Branch::Student), weight("mask_token"));
        assert!(matches!(rename("module.dino_head.mlp.0.weight", teacher), Renamed::Ignored(_)));
    }
}
