//! A setting from its string.

use super::{Passes, Setting, SettingError};
use crate::inference::MAX_COPIES;
use scenesplat_datasets::Anchor;
use scenesplat_kernels::Precision;
use scenesplat_kernels::grid_sample::{MAX_GRID_SIZE, is_grid_size};
use scenesplat_metrics::MAX_VOTERS;
use std::ops::RangeInclusive;
use std::str::FromStr;

/// The most points of a patch that an architecture takes.
const MAX_PATCH: usize = 1 << 16;
/// The widest layer that an architecture takes.
const MAX_RANK: usize = 1 << 14;
/// The most passes that are worth a number of their own.
const MAX_PASSES: usize = 1 << 16;
/// The widest code.
const MAX_CODES: usize = 256;

impl FromStr for Setting {
    type Err = SettingError;

    /// Reads `KEY=VALUE` parts, separated by commas, in any order. An empty string names no part.
    fn from_str(text: &str) -> Result<Self, SettingError> {
        let mut setting = Self::default();
        let mut seen: Vec<(&'static str, &str)> = Vec::new();
        for part in text.split(',').filter(|_| !text.is_empty()) {
            let no_pair = || SettingError::NoPair { part: part.to_owned() };
            let (name, value) = part.split_once('=').ok_or_else(no_pair)?;
            if name.is_empty() {
                return Err(no_pair());
            }
            let Some(key) = Self::KEYS.into_iter().find(|key| *key == name) else {
                return Err(SettingError::UnknownKey { key: name.to_owned() });
            };
            if let Some((_, first)) = seen.iter().find(|(known, _)| *known == key) {
                let (first, second) = ((*first).to_owned(), value.to_owned());
                return Err(SettingError::Twice { key, first, second });
            }
            seen.push((key, value));
            setting.take(key, value)?;
        }
        Ok(setting)
    }
}

impl Setting {
    fn take(&mut self, key: &'static str, value: &str) -> Result<(), SettingError> {
        let wrong = |expected: &str| SettingError::Value {
            key,
            value: value.to_owned(),
            expected: expected.to_owned(),
        };
        let count = |range: RangeInclusive<usize>| {
            let expected = format!("a number from {} to {}", range.start(), range.end());
            // `parse` takes a sign, which no other way of writing this has.
            let digits = !value.is_empty() && value.bytes().all(|b| b.is_ascii_digit());
            let read = value.parse().ok().filter(|n| digits && range.contains(n));
            read.map(Some).ok_or_else(|| wrong(&expected))
        };
        match key {
            "voxel" => {
                let read = value.parse().ok().filter(|v: &f64| is_grid_size(*v));
                let expected = format!("a length above 0, in meters, at most {MAX_GRID_SIZE}");
                self.voxel = Some(read.ok_or_else(|| wrong(&expected))?);
            }
            "net" if value.is_empty() => {
                return Err(wrong("embedded, a configuration's name, or a model folder"));
            }
            "net" => self.net = Some(value.to_owned()),
            "precision" => {
                let names = Precision::ALL.map(Precision::name).join(", ");
                let read = value.parse().map_err(|_| wrong(&format!("one of {names}")))?;
                self.precision = Some(read);
            }
            "patch" => self.patch = count(1..=MAX_PATCH)?,
            "stage" => self.stage = Some(value.parse().map_err(|_| wrong("fine or coarse"))?),
            "rank" => self.rank = count(1..=MAX_RANK)?,
            "passes" if value == "all" => self.passes = Some(Passes::All),
            "passes" => {
                let expected = format!("all, or a number from 1 to {MAX_PASSES}");
                let read = count(1..=MAX_PASSES).map_err(|_| wrong(&expected))?;
                self.passes = read.map(Passes::Count);
            }
            "tta" => self.tta = count(1..=MAX_COPIES)?,
            "anchor" => {
                let found = Anchor::ALL.into_iter().find(|(name, _)| *name == value);
                self.anchor = Some(found.ok_or_else(|| wrong("box or world"))?.1);
            }
            "codes" => self.codes = count(1..=MAX_CODES)?,
            "k" => self.k = count(0..=MAX_VOTERS)?,
            _ => return Err(SettingError::UnknownKey { key: key.to_owned() }),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_models::LastStage;

    const ALL: &str = "voxel=0.04,net=litept-s,precision=bf16,patch=256,stage=coarse,rank=96,passes=all,tta=4,anchor=world,codes=16,k=8";

    #[test]
    fn every_key_is_read_and_written() {
        let setting: Setting = ALL.parse().unwrap();
        let whole = Setting {
            voxel: Some(0.04),
            net: Some("litept-s".to_owned()),
            precision: Some(Precision::Bf16),
            patch: Some(256),
            stage: Some(LastStage::Coarse),
            rank: Some(96),
            passes: Some(Passes::All),
            tta: Some(4),
            anchor: Some(Anchor::World),
            codes: Some(16),
            k: Some(8),
        };
        assert_eq!(setting, whole);
        assert_eq!(setting.to_string(), ALL);
        let keys: Vec<&str> = setting.parts().iter().map(|(key, _)| *key).collect();
        assert_eq!(keys, Setting::KEYS);
        // In any order; written in one.
        let mut parts: Vec<&str> = ALL.split(',').collect();
        parts.reverse();
        assert_eq!(parts.join(",").parse::<Setting>().unwrap().to_string(), ALL);
    }

    #[test]
    fn what_is_written_is_read_again() {
        for text in
            ["", "k=0", "passes=1", "passes=4", "voxel=0.30000000000000004", "net=a=b/c d", "k=8"]
        {
            assert_eq!(text.parse::<Setting>().unwrap().to_string(), text);
        }
        let tiny: Setting = "voxel=1e-7".parse().unwrap();
        assert_eq!(tiny.to_string().parse::<Setting>().unwrap(), tiny);
    }

    #[test]
    fn the_first_setting_wins_part_by_part() {
        let all: Setting = ALL.parse().unwrap();
        let none = Setting::default();
        assert!(none.is_empty() && !all.is_empty());
        assert_eq!(none.or(&all), all);
        assert_eq!(all.or(&none), all);
        for (key, value) in all.parts() {
            // Each part alone, over all others.
            let one: Setting = format!("{key}={value}").parse().unwrap();
            assert_eq!(one.parts().len(), 1);
            assert_eq!(one.or(&all), all, "{key}");
            let rest: Vec<String> = all
                .parts()
                .into_iter()
                .filter(|(k, _)| *k != key)
                .map(|(k, v)| format!("{k}={v}"))
                .collect();
            let rest: Setting = rest.join(",").parse().unwrap();
            assert_eq!(rest.or(&one), all, "{key}");
        }
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        let error = |text: &str| text.parse::<Setting>().unwrap_err();
        assert_eq!(error("voxels=1"), SettingError::UnknownKey { key: "voxels".to_owned() });
        assert!(error("Voxel=1").to_string().contains("known are voxel, net, precision, patch"));
        let twice = error("k=8,voxel=1,k=9").to_string();
        assert!(twice.contains("setting k") && twice.contains("\"8\"") && twice.contains("\"9\""));
        for text in [",", "k", "k=8,", ",k=8", "k=8,,voxel=1", "=8", "=", "k=8, voxel"] {
            assert!(matches!(error(text), SettingError::NoPair { .. }), "{text}: {}", error(text));
        }
        for (text, key, part) in [
            ("voxel=0", "voxel", "above 0"),
            ("voxel=-0.1", "voxel", "above 0"),
            ("voxel=nan", "voxel", "above 0"),
            ("voxel=inf", "voxel", "above 0"),
            ("voxel=", "voxel", "above 0"),
            ("voxel=2cm", "voxel", "meters"),
            ("net=", "net", "embedded"),
            ("precision=f16", "precision", "bf16"),
            ("precision=", "precision", "f32"),
            ("patch=0", "patch", "1 to 65536"),
            ("patch=65537", "patch", "1 to 65536"),
            ("patch=-1", "patch", "1 to 65536"),
            ("patch=+1", "patch", "1 to 65536"),
            ("patch= 1", "patch", "1 to 65536"),
            ("patch=1.5", "patch", "1 to 65536"),
            ("stage=middle", "stage", "coarse"),
            ("stage=", "stage", "fine"),
            ("rank=0", "rank", "1 to 16384"),
            ("rank=1e3", "rank", "1 to 16384"),
            ("passes=0", "passes", "all, or a number"),
            ("passes=ALL", "passes", "all, or a number"),
            ("tta=0", "tta", "1 to 12"),
            ("tta=13", "tta", "1 to 12"),
            ("codes=0", "codes", "1 to 256"),
            ("codes=257", "codes", "1 to 256"),
            ("k=-1", "k", "0 to 4096"),
            ("k=4097", "k", "0 to 4096"),
            ("k=18446744073709551615", "k", "0 to 4096"),
            ("k=99999999999999999999999", "k", "0 to 4096"),
            ("voxel=1e30", "voxel", "at most 1000000"),
        ] {
            let found = error(text);
            assert!(matches!(&found, SettingError::Value { key: k, .. } if *k == key), "{found}");
            assert!(found.to_string().contains(part), "{text}: {found}");
        }
        let long = format!("{}=1", "x".repeat(100_000));
        assert!(matches!(error(&long), SettingError::UnknownKey { .. }));
    }
}
