//! Weights published by others, in PyTorch's layout.

pub mod lits;
pub mod mini_spin_net;
pub mod overlap_head;
