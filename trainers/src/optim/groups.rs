use candle_core::Var;
use std::collections::BTreeMap;

/// Parameters that share a learning rate and a weight decay.
#[derive(Debug, Clone)]
pub struct ParamGroup {
    /// By name.
    pub params: BTreeMap<String, Var>,
    /// Learning rate before the schedule's factor.
    pub lr: f64,
    /// Weight decay per unit of learning rate.
    pub weight_decay: f64,
}

/// A rule that gives some parameters their own learning rate.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeywordGroup {
    /// Applies to parameters whose name contains this, e.g. "block".
    pub keyword: String,
    /// Learning rate before the schedule's factor.
    pub lr: f64,
}

/// Sorts parameters into groups by keywords in their names.
///
/// Group 0 holds the parameters that no rule claims, group `i + 1` those of rule `i`. The first rule
/// that matches wins. A group may be empty: a rule that is there for transformer blocks does no harm
/// to a model without any, and a misspelt one shows as an empty group.
///
/// `weight_decay` holds for all groups and all parameters, biases and norms too, as in the
/// original. Its language models train the groups (rest 0.006, "block" 0.0006) with decay 0.05.
///
/// # Source
/// `param_dicts` of the configurations, SceneSplat be9d5e1.
///
/// ```
/// use candle_core::{DType, Device, Var};
/// use scenesplat_trainers::{KeywordGroup, group_by_keyword};
///
/// let var = || Var::zeros(3, DType::F32, &Device::Cpu);
/// let params = [("enc.block0.norm.bias".to_owned(), var()?), ("stem.weight".to_owned(), var()?)];
/// let rules = [KeywordGroup { keyword: "block".to_owned(), lr: 0.0006 }];
/// let groups = group_by_keyword(&params.into(), 0.006, 0.05, &rules);
/// assert!(groups[0].params.contains_key("stem.weight"));
/// assert!(groups[1].params.contains_key("enc.block0.norm.bias"));
/// # Ok::<(), candle_core::Error>(())
/// ```
pub fn group_by_keyword(
    params: &BTreeMap<String, Var>,
    lr: f64,
    weight_decay: f64,
    rules: &[KeywordGroup],
) -> Vec<ParamGroup> {
    let rates = std::iter::once(lr).chain(rules.iter().map(|rule| rule.lr));
    let mut groups: Vec<ParamGroup> =
        rates.map(|lr| ParamGroup { params: BTreeMap::new(), lr, weight_decay }).collect();
    for (name, var) in params {
        let rule = rules.iter().position(|rule| name.contains(&rule.keyword));
        groups[rule.map_or(0, |i| i + 1)].params.insert(name.clone(), var.clone());
    }
    groups
}
