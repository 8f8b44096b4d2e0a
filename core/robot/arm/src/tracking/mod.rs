//! Instrument tips over time, as plain mathematics without any framework type.
//!
//! [`tracker`] follows tips in space with the filter of [`kalman`]; [`jaws`] finds the tip between jaws of which one is
//! hidden; [`skill`] measures surgical skill; [`proximity`] measures distances from tips to tissue and between tips,
//! and decides on warnings. Lengths in mm, times in s on one clock that the caller owns.

pub mod jaws;
pub mod kalman;
pub mod proximity;
pub mod real_time;
pub mod skill;
pub mod tracker;
mod vector;
