//! What a person or another program looks at after a run.

pub mod merged;
pub mod poses;
pub mod run;
pub mod table;
pub mod top_view;
