//! Which part of the work is this process's: by a flag, or by the variables that schedulers set.

use clap::Args;
use scanweave::Error;
use scanweave::pipeline::Shard;

/// The part of the work to do.
#[derive(Debug, Default, Args)]
pub struct ShardOption {
    /// Do only part I of N, counted from 0. Default: the task of a SLURM job array
    /// (SLURM_ARRAY_TASK_ID, _MIN, _STEP, _COUNT), or of an indexed job
    /// (JOB_COMPLETION_INDEX with JOB_COMPLETIONS), else everything.
    #[arg(long, value_name = "I/N", value_parser = parse_shard)]
    pub shard: Option<Shard>,
}

impl ShardOption {
    /// The shard of the flag, or else of the environment.
    pub fn shard(&self) -> Result<Shard, Error> {
        match self.shard {
            Some(shard) => Ok(shard),
            None => shard_of_environment(|name| std::env::var(name).ok()),
        }
    }
}

fn parse_shard(text: &str) -> Result<Shard, String> {
    text.parse().map_err(str::to_owned)
}

/// The shard that a cluster's scheduler asks this process for.
fn shard_of_environment(variable: impl Fn(&str) -> Option<String>) -> Result<Shard, Error> {
    let number = |name: &str| -> Result<Option<usize>, Error> {
        variable(name)
            .map(|text| {
                let remedy = "unset it, or pass --shard I/N";
                text.trim()
                    .parse()
                    .map_err(|_| Error::setting(name, format!("`{text}`"), "a whole number", remedy))
            })
            .transpose()
    };
    let (index, count, name) = if let Some(id) = number("SLURM_ARRAY_TASK_ID")? {
        let least = number("SLURM_ARRAY_TASK_MIN")?.unwrap_or(0);
        let step = number("SLURM_ARRAY_TASK_STEP")?.unwrap_or(1).max(1);
        (id.saturating_sub(least) / step, number("SLURM_ARRAY_TASK_COUNT")?, "SLURM_ARRAY_TASK_COUNT")
    } else if let Some(index) = number("JOB_COMPLETION_INDEX")? {
        (index, number("JOB_COMPLETIONS")?, "JOB_COMPLETIONS")
    } else {
        return Ok(Shard::WHOLE);
    };
    match count {
        Some(count) if index < count => Ok(Shard { index, count }),
        found => Err(Error::setting(
            name,
            found.map_or("nothing".to_owned(), |n| n.to_string()),
            format!("the number of tasks, more than this task's place {index}"),
            "set it, or pass --shard I/N",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shard(variables: &[(&str, &str)]) -> Result<Shard, Error> {
        let find = |name: &str| variables.iter().find(|v| v.0 == name).map(|v| v.1.to_owned());
        shard_of_environment(find)
    }

    #[test]
    fn schedulers_name_the_shard() {
        assert_eq!(shard(&[]).unwrap(), Shard::WHOLE);
        // An array of tasks 1, 3, 5 (--array=1-5:2): the last is number 2 of 3.
        let slurm = [
            ("SLURM_ARRAY_TASK_ID", "5"),
            ("SLURM_ARRAY_TASK_MIN", "1"),
            ("SLURM_ARRAY_TASK_STEP", "2"),
            ("SLURM_ARRAY_TASK_COUNT", "3"),
        ];
        assert_eq!(shard(&slurm).unwrap(), Shard { index: 2, count: 3 });
        let job = [("JOB_COMPLETION_INDEX", "3"), ("JOB_COMPLETIONS", "4")];
        assert_eq!(shard(&job).unwrap(), Shard { index: 3, count: 4 });
        assert!(shard(&job[..1]).unwrap_err().to_string().contains("JOB_COMPLETIONS"));
        let late = [("JOB_COMPLETION_INDEX", "4"), ("JOB_COMPLETIONS", "4")];
        assert!(shard(&late).is_err());
    }
}
