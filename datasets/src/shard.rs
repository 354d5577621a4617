//! One part of a list of scenes that several processes share.

use std::fmt;
use std::str::FromStr;

/// Part `index` of `count`: of a sorted list, the scenes at `index`, `index + count`, `index + 2 count`, …
///
/// All processes that sort the same list agree without talking, and the parts differ by at most one scene.
///
/// ```
/// use scenesplat_datasets::Shard;
///
/// let shard: Shard = "1/3".parse()?;
/// let held: Vec<usize> = (0..8).filter(|&place| shard.holds(place)).collect();
/// assert_eq!(held, [1, 4, 7]);
/// # Ok::<(), scenesplat_datasets::ShardError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

/// Why there is no such part.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ShardError {
    /// It is not written as a part.
    #[error("{0:?}: write i/n, such as 0/4 for the first of four parts")]
    Form(String),
    /// There is no such part.
    #[error("{index}/{count}: parts of {count} are 0/{count} to {last}/{count}", last = count.saturating_sub(1))]
    Range {
        /// The part asked for.
        index: usize,
        /// The number of parts.
        count: usize,
    },
    /// A variable of the scheduler that says nothing usable.
    #[error("{name}={value}: {problem}; give the part by hand, such as 0/4")]
    Variable {
        /// Name of the variable.
        name: &'static str,
        /// Its value.
        value: String,
        /// What is wrong with it.
        problem: &'static str,
    },
}

impl Default for Shard {
    /// All of the list.
    fn default() -> Self {
        Self { index: 0, count: 1 }
    }
}

impl Shard {
    /// Part `index` of `count`.
    ///
    /// # Errors
    /// If `index` is not below `count`.
    pub fn new(index: usize, count: usize) -> Result<Self, ShardError> {
        if index < count {
            Ok(Self { index, count })
        } else {
            Err(ShardError::Range { index, count })
        }
    }

    /// Which part it is, counted from 0.
    pub fn index(self) -> usize {
        self.index
    }

    /// How many parts there are.
    pub fn count(self) -> usize {
        self.count
    }

    /// Whether what stands at that place of the sorted list belongs to this part.
    pub fn holds(self, place: usize) -> bool {
        place % self.count == self.index
    }

    /// The part that a scheduler gave this process, with the variable that said so: the task of a SLURM
    /// array (`SLURM_ARRAY_TASK_ID`, of `SLURM_ARRAY_TASK_COUNT` from `SLURM_ARRAY_TASK_MIN` in steps of
    /// `SLURM_ARRAY_TASK_STEP`), or else the rank of `mpirun`, `srun` or `torchrun` by the usual names
    /// (`RANK` of `WORLD_SIZE`). `None` if neither is there. `variable` looks a name up; what it gives for
    /// an empty value counts as missing.
    ///
    /// # Errors
    /// If a variable is there without its partner, is no number, or names a part that does not exist.
    pub fn from_environment(
        variable: impl Fn(&'static str) -> Option<String>,
    ) -> Result<Option<(Self, &'static str)>, ShardError> {
        let read = |name| variable(name).filter(|value| !value.is_empty());
        let number = |name: &'static str| match read(name) {
            None => Ok(None),
            Some(value) => match value.trim().parse::<usize>() {
                Ok(number) => Ok(Some(number)),
                Err(_) => {
                    let problem = "a whole number is expected";
                    Err(ShardError::Variable { name, value, problem })
                }
            },
        };
        let partner = |name: &'static str, value: usize, problem| ShardError::Variable {
            name,
            value: value.to_string(),
            problem,
        };
        const TASK: &str = "SLURM_ARRAY_TASK_ID";
        if let Some(task) = number(TASK)? {
            let problem = "SLURM_ARRAY_TASK_COUNT is missing";
            let count =
                number("SLURM_ARRAY_TASK_COUNT")?.ok_or_else(|| partner(TASK, task, problem))?;
            let first = number("SLURM_ARRAY_TASK_MIN")?.unwrap_or(0);
            let step = number("SLURM_ARRAY_TASK_STEP")?.unwrap_or(1).max(1);
            let problem =
                "is no task of the array that SLURM_ARRAY_TASK_MIN, _STEP and _COUNT describe";
            let offset = task.checked_sub(first).filter(|offset| offset % step == 0);
            let index = offset.map(|offset| offset / step).filter(|index| *index < count);
            let index = index.ok_or_else(|| partner(TASK, task, problem))?;
            return Ok(Some((Self { index, count }, TASK)));
        }
        const RANK: &str = "RANK";
        if let Some(rank) = number(RANK)? {
            let count = number("WORLD_SIZE")?
                .ok_or_else(|| partner(RANK, rank, "WORLD_SIZE is missing"))?;
            let shard = Self::new(rank, count)
                .map_err(|_| partner(RANK, rank, "is not below WORLD_SIZE"))?;
            return Ok(Some((shard, RANK)));
        }
        Ok(None)
    }
}

impl FromStr for Shard {
    type Err = ShardError;

    fn from_str(text: &str) -> Result<Self, ShardError> {
        let numbers = text.split_once('/').and_then(|(index, count)| {
            Some((index.trim().parse().ok()?, count.trim().parse().ok()?))
        });
        let (index, count) = numbers.ok_or_else(|| ShardError::Form(text.to_owned()))?;
        Self::new(index, count)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment(
        variables: &[(&'static str, &str)],
    ) -> Result<Option<(Shard, &'static str)>, ShardError> {
        Shard::from_environment(|name| {
            variables.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn every_scene_is_in_one_part() {
        for count in 1..6 {
            for place in 0..20 {
                let parts = (0..count).filter(|&i| Shard::new(i, count).unwrap().holds(place));
                assert_eq!(parts.count(), 1, "{place} of {count}");
            }
        }
        assert!((0..9).all(|place| Shard::default().holds(place)));
        assert_eq!("2/5".parse::<Shard>().unwrap().to_string(), "2/5");
    }

    #[test]
    fn parts_that_are_none_are_refused() {
        for text in ["", "1", "1/", "/2", "-1/2", "a/b", "1/2/3"] {
            let error = text.parse::<Shard>().unwrap_err();
            assert!(error.to_string().contains("write i/n"), "{error}");
        }
        for text in ["2/2", "0/0", "9/3"] {
            assert!(matches!(text.parse::<Shard>(), Err(ShardError::Range { .. })), "{text}");
        }
        assert!("4/4".parse::<Shard>().unwrap_err().to_string().contains("0/4 to 3/4"));
    }

    #[test]
    fn schedulers_say_which_part() {
        assert_eq!(environment(&[]).unwrap(), None);
        assert_eq!(environment(&[("RANK", "")]).unwrap(), None);
        let shard = |index, count| Shard::new(index, count).unwrap();
        let slurm = [
            ("SLURM_ARRAY_TASK_ID", "7"),
            ("SLURM_ARRAY_TASK_COUNT", "4"),
            ("SLURM_ARRAY_TASK_MIN", "5"),
        ];
        let found = environment(&slurm).unwrap();
        assert_eq!(found, Some((shard(2, 4), "SLURM_ARRAY_TASK_ID")));
        // Of --array=5-11:2: tasks 5, 7, 9, 11.
        let steps = [&slurm[..], &[("SLURM_ARRAY_TASK_STEP", "2")]].concat();
        assert_eq!(environment(&steps).unwrap().unwrap().0, shard(1, 4));
        // The array comes first: torchrun inside of it is another matter.
        let both = [&slurm[..], &[("RANK", "0"), ("WORLD_SIZE", "2")]].concat();
        assert_eq!(environment(&both).unwrap().unwrap().0, shard(2, 4));
        let ranks = [("RANK", "1"), ("WORLD_SIZE", "2")];
        assert_eq!(environment(&ranks).unwrap(), Some((shard(1, 2), "RANK")));
    }

    #[test]
    fn half_a_scheduler_is_refused_by_name() {
        type Case<'c> = (&'c [(&'static str, &'c str)], &'c str);
        let cases: [Case<'_>; 6] = [
            (&[("RANK", "1")], "WORLD_SIZE is missing"),
            (&[("RANK", "2"), ("WORLD_SIZE", "2")], "RANK=2: is not below"),
            (&[("RANK", "x"), ("WORLD_SIZE", "2")], "RANK=x: a whole number"),
            (&[("SLURM_ARRAY_TASK_ID", "1")], "SLURM_ARRAY_TASK_COUNT is missing"),
            (
                &[("SLURM_ARRAY_TASK_ID", "9"), ("SLURM_ARRAY_TASK_COUNT", "4")],
                "SLURM_ARRAY_TASK_ID=9: is no task",
            ),
            (
                &[
                    ("SLURM_ARRAY_TASK_ID", "1"),
                    ("SLURM_ARRAY_TASK_COUNT", "4"),
                    ("SLURM_ARRAY_TASK_MIN", "2"),
                ],
                "is no task",
            ),
        ];
        for (variables, problem) in cases {
            let error = environment(variables).unwrap_err().to_string();
            assert!(error.contains(problem), "{error}");
        }
    }
}
