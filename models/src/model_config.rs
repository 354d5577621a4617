//! A backbone with its head and its voxel size, as files give them.

use crate::params::check_values;
use crate::weights::Shapes;
use crate::{
    Backbone, BackboneConfig, BackboneCost, Compute, Head, LitePtSize, PointTransformerV3Config,
};
use candle_core::{Result, bail};
use candle_nn::VarBuilder;
use scenesplat_kernels::grid_sample::{MAX_GRID_SIZE, is_grid_size};
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};
use std::fmt;

/// A network: backbone, head, and the voxel size that it is trained for.
///
/// A file has all of it in one table: `architecture` (the first of [`BackboneConfig::NAMES`] if
/// absent), the fields of that backbone, `num_classes` or `projection`, and `grid_size`.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelConfig {
    /// The backbone.
    pub backbone: BackboneConfig,
    /// What stands behind it.
    pub head: Head,
    /// Voxel size that the network is trained for, meters.
    pub grid_size: f64,
}

/// The released networks' voxels, meters.
const GRID_SIZE: f64 = 0.02;

impl Default for ModelConfig {
    fn default() -> Self {
        Self::language()
    }
}

impl ModelConfig {
    /// A backbone without anything behind it: its features at unit length, voxels of 2 cm.
    pub fn new(backbone: impl Into<BackboneConfig>) -> Self {
        let head = Head::Features { projection: None };
        Self { backbone: backbone.into(), head, grid_size: GRID_SIZE }
    }

    /// The language network.
    pub fn language() -> Self {
        Self::new(PointTransformerV3Config::language())
    }

    /// The supervised segmentation network, 20 classes.
    pub fn semseg() -> Self {
        Self::new(PointTransformerV3Config::semseg()).with_classes(20)
    }

    /// The self-supervised network.
    pub fn ssl() -> Self {
        Self::new(PointTransformerV3Config::ssl())
    }

    /// A small language network for trying things out.
    pub fn tiny() -> Self {
        Self::new(PointTransformerV3Config::tiny())
    }

    /// The encoder of Sonata, which Concerto and Chorus share.
    pub fn sonata() -> Self {
        Self::new(PointTransformerV3Config::sonata())
    }

    /// With a linear classifier behind the backbone.
    #[must_use]
    pub fn with_classes(self, num_classes: usize) -> Self {
        Self { head: Head::Classes(num_classes), ..self }
    }

    /// With a linear layer that brings features to another width.
    #[must_use]
    pub fn with_projection(self, width: usize) -> Self {
        Self { head: Head::Features { projection: Some(width) }, ..self }
    }

    /// With another way to compute.
    #[must_use]
    pub fn with_compute(mut self, compute: Compute) -> Self {
        self.backbone.get_mut().set_compute(compute);
        self
    }

    /// The released network (language, segmentation, self-supervised, the small one, a LitePT, or an encoder of Sonata
    /// or Concerto, with decoder or without) that weights of these shapes belong to, with their number of inputs and classes; `None` if
    /// they belong to none.
    pub fn recognize(shapes: &Shapes) -> Option<Self> {
        let has_classes = shapes.contains_key("seg_head.weight");
        let lite = LitePtSize::ALL.map(|size| Self::new(size.config()));
        let second = [
            PointTransformerV3Config::sonata(),
            PointTransformerV3Config::sonata_with_decoder(),
            PointTransformerV3Config::concerto_large(),
        ];
        [Self::language(), Self::semseg(), Self::ssl(), Self::tiny()]
            .into_iter()
            .map(|config| config.adapted_to(shapes))
            .find(|c| c.num_classes().is_some() == has_classes && c.fits(shapes))
            .or_else(|| {
                // Of these any head is as released as another.
                lite.into_iter()
                    .chain(second.map(Self::new))
                    .map(|config| config.with_head_of(shapes).adapted_to(shapes))
                    .find(|c| c.fits(shapes))
            })
    }

    /// Whether names and shapes are those of this network's backbone, as far as they show.
    pub fn fits(&self, shapes: &Shapes) -> bool {
        self.backbone.get().fits(shapes)
    }

    /// With the head that a checkpoint has, or none.
    #[must_use]
    pub fn with_head_of(self, shapes: &Shapes) -> Self {
        let rows = |name: &str| shapes.get(name).and_then(|s| s.first()).copied();
        match (rows("seg_head.weight"), rows("projection.weight")) {
            (Some(classes), _) => self.with_classes(classes),
            (None, projection) => Self { head: Head::Features { projection }, ..self },
        }
    }

    /// This network with what a checkpoint says of its ends: the number of inputs, where its first
    /// layer tells it, and the number of classes, where both have a classifier.
    #[must_use]
    pub fn adapted_to(mut self, shapes: &Shapes) -> Self {
        self.backbone.get_mut().adapt_to(shapes);
        if let (Head::Classes(classes), Some([rows, _])) =
            (&mut self.head, shapes.get("seg_head.weight").map(Vec::as_slice))
        {
            *classes = *rows;
        }
        self
    }

    /// Checks that the fields fit together, and that the network has no more than [`MAX_VALUES`](crate::MAX_VALUES)
    /// values.
    ///
    /// # Errors
    /// Names the first field that does not.
    pub fn check(&self) -> Result<()> {
        self.backbone.get().check()?;
        self.head.check()?;
        if !is_grid_size(self.grid_size) {
            bail!(
                "grid_size: {} is not above 0 and at most {MAX_GRID_SIZE} meters",
                self.grid_size
            );
        }
        check_values(self.num_values())
    }

    /// Builds the network.
    ///
    /// # Errors
    /// If the fields do not fit together, or parameters exist with another shape.
    pub fn build(&self, vb: VarBuilder<'_>) -> Result<Box<dyn Backbone>> {
        self.check()?;
        self.head.build(self.backbone.get().build(vb.clone())?, vb)
    }

    /// Width of the input features.
    pub fn in_channels(&self) -> usize {
        self.backbone.get().in_channels()
    }

    /// Width of the output, head included.
    pub fn out_channels(&self) -> usize {
        self.head.out_channels(self.backbone.get().out_channels())
    }

    /// Number of classes, if it is a classifier.
    pub fn num_classes(&self) -> Option<usize> {
        match self.head {
            Head::Classes(n) => Some(n),
            Head::Features { .. } => None,
        }
    }

    /// What inference costs, head included.
    pub fn cost(&self) -> BackboneCost {
        let backbone = self.backbone.get();
        self.head.cost(backbone.cost(), backbone.out_channels())
    }

    /// Values of all parameters and buffers, without building anything.
    pub fn num_values(&self) -> usize {
        let backbone = self.backbone.get();
        backbone.num_values().saturating_add(self.head.num_values(backbone.out_channels()))
    }

    /// Reads the table of a file.
    ///
    /// # Errors
    /// Names the field that is unknown or of a wrong type.
    pub fn from_fields(mut fields: Map<String, Value>) -> std::result::Result<Self, String> {
        let take = |fields: &mut Map<String, Value>, name| {
            fields.remove(name).filter(|value| !value.is_null())
        };
        let wrong = |name, value: &Value, want| format!("{name}: expected {want}, got {value}");
        let count = |value: Option<Value>, name| match value {
            None => Ok(None),
            Some(value) => match value.as_u64().and_then(|n| usize::try_from(n).ok()) {
                Some(n) => Ok(Some(n)),
                None => Err(wrong(name, &value, "a count")),
            },
        };
        let architecture = match take(&mut fields, "architecture") {
            None => BackboneConfig::NAMES[0].to_owned(),
            Some(Value::String(name)) => name,
            Some(other) => return Err(wrong("architecture", &other, "a name")),
        };
        let num_classes = count(take(&mut fields, "num_classes"), "num_classes")?;
        let projection = count(take(&mut fields, "projection"), "projection")?;
        let head = match (num_classes, projection) {
            (Some(n), None) => Head::Classes(n),
            (None, projection) => Head::Features { projection },
            (Some(_), Some(_)) => {
                return Err(
                    "projection: a classifier (num_classes) reads the features as they are"
                        .to_owned(),
                );
            }
        };
        let grid_size = match take(&mut fields, "grid_size") {
            None => GRID_SIZE,
            Some(v) => v.as_f64().ok_or_else(|| wrong("grid_size", &v, "a length in meters"))?,
        };
        let backbone = BackboneConfig::from_fields(&architecture, fields)?;
        Ok(Self { backbone, head, grid_size })
    }
}

impl Serialize for ModelConfig {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Table<'a> {
            architecture: &'a str,
            #[serde(flatten)]
            backbone: &'a BackboneConfig,
            num_classes: Option<usize>,
            projection: Option<usize>,
            grid_size: f64,
        }
        let projection = match self.head {
            Head::Features { projection } => projection,
            Head::Classes(_) => None,
        };
        let table = Table {
            architecture: self.backbone.name(),
            backbone: &self.backbone,
            num_classes: self.num_classes(),
            projection,
            grid_size: self.grid_size,
        };
        table.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for ModelConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let UniqueKeys(fields) = UniqueKeys::deserialize(deserializer)?;
        Self::from_fields(fields).map_err(D::Error::custom)
    }
}

/// A table of a file, each key once.
#[derive(Debug, Clone, Default)]
pub struct UniqueKeys(pub Map<String, Value>);

impl<'de> Deserialize<'de> for UniqueKeys {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Keys;
        impl<'de> Visitor<'de> for Keys {
            type Value = UniqueKeys;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a table")
            }
            fn visit_map<A: MapAccess<'de>>(
                self,
                mut map: A,
            ) -> std::result::Result<UniqueKeys, A::Error> {
                let mut out = Map::new();
                while let Some((key, value)) = map.next_entry::<String, Value>()? {
                    if out.contains_key(&key) {
                        return Err(A::Error::custom(format!("{key}: stands there twice")));
                    }
                    out.insert(key, value);
                }
                Ok(UniqueKeys(out))
            }
        }
        deserializer.deserialize_map(Keys)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> std::result::Result<ModelConfig, String> {
        serde_json::from_str(text).map_err(|e| e.to_string())
    }

    #[test]
    fn one_table_holds_backbone_head_and_voxels() {
        for config in [
            ModelConfig::language(),
            ModelConfig::semseg(),
            ModelConfig::ssl(),
            ModelConfig { grid_size: 0.05, ..ModelConfig::tiny().with_projection(96) },
        ] {
            let text = serde_json::to_string(&config).unwrap();
            assert!(text.starts_with(
                r#"{"architecture":"point_transformer_v3","version":"m1","in_channels":"#
            ));
            assert_eq!(read(&text).unwrap(), config, "{text}");
        }
        assert_eq!(read("{}").unwrap(), ModelConfig::language());
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, part) in [
            (r#"{"architecture": "pointnet"}"#, "point_transformer_v3"),
            (r#"{"num_classes": -1}"#, "num_classes"),
            (r#"{"num_classes": 3, "projection": 4}"#, "projection"),
            (r#"{"grid_size": "big"}"#, "grid_size"),
            (r#"{"enc_depth": [1]}"#, "enc_depth"),
            (r#"{"mlp_ratio": 2, "stride": 2}"#, "stride"),
            (r#"{"mlp_ratio": 2, "mlp_ratio": 3}"#, "twice"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
        let check = |text: &str| read(text).unwrap().check().unwrap_err().to_string();
        assert!(check(r#"{"num_classes": 0}"#).contains("num_classes"));
        assert!(check(r#"{"projection": 0}"#).contains("projection"));
        assert!(check(r#"{"grid_size": 0}"#).contains("grid_size"));
        assert!(check(r#"{"mlp_ratio": 0}"#).contains("mlp_ratio"));
    }
}
