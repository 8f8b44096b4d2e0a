//! Instrument tips over time, as plain mathematics without any framework type.
//!
//! [`tracker`] follows tips in space with the filter of [`kalman`]; [`jaws`] finds the tip between jaws of which one is hidden; [`skill`] measures how
//! skilfully instruments are moved; [`proximity`] measures how near tips are to tissue and to each other, and when to warn.
//! Lengths in mm, times in s on one clock that the caller owns.

#![forbid(unsafe_code)]

pub mod jaws;
pub mod kalman;
pub mod proximity;
pub mod real_time;
pub mod skill;
pub mod tracker;
mod vector;
