//! `scanweave config`.

use super::options::SettingOptions;
use super::{Status, terminal};
use clap::Args;
use scanweave::config;

/// Print the effective settings, or the schema they follow.
#[derive(Debug, Args)]
pub struct Arguments {
    #[command(flatten)]
    settings: SettingOptions,
    /// Print the JSON schema of configuration files, with what every key means.
    #[arg(long)]
    schema: bool,
}

pub fn run(arguments: Arguments) -> anyhow::Result<Status> {
    let text = if arguments.schema { config::schema() } else { arguments.settings.config()?.to_toml()? };
    terminal::print(&format!("{}\n", text.trim_end()))?;
    Ok(Status::Success)
}
