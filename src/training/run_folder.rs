//! Names of the files of a training run.

/// The checkpoint that scored best on the validation scenes.
pub const BEST: &str = "best.safetensors";
/// The checkpoint that training goes on from.
pub const LAST: &str = "last.safetensors";
/// What the last step left, without the optimiser's state.
pub const FINAL: &str = "final.safetensors";
/// One JSON record a line.
pub const METRICS: &str = "metrics.jsonl";
/// Picture of the curves in the log.
pub const CURVES: &str = "curves.svg";
/// The recipe that the run was started with.
pub const RECIPE: &str = "recipe.toml";
/// What a run leaves but for its recipe, which every start writes anew.
pub const OF_A_RUN: [&str; 5] = [BEST, LAST, FINAL, METRICS, CURVES];
