//! Outputs of a run for people and for other programs.

pub(crate) mod chart;
pub(crate) mod diagnosis;
pub(crate) mod grid;
pub(crate) mod growth_tree;
pub(crate) mod html;
pub(crate) mod inspect;
mod markup;
pub(crate) mod protocol;
pub mod remarks;
pub(crate) mod sheet;
pub(crate) mod table;
pub(crate) mod top_view;

pub use html::{Input, MOST_POINTS, PointSource, headline, page};
