//! Outputs of a run for people and for other programs.

pub mod chart;
pub mod diagnosis;
pub mod grid;
pub mod growth_tree;
pub mod html;
pub mod inspect;
mod markup;
pub mod protocol;
pub mod remarks;
pub mod sheet;
pub mod table;
pub mod top_view;
