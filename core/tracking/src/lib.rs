//! What the movement of instrument tips tells, as plain mathematics without any framework type.
//!
//! [`skill`] measures how skilfully instruments are moved; [`proximity`] measures how near tips are to tissue and to each other, and when to warn.
//! Lengths in mm, times in s on one clock that the caller owns.

#![forbid(unsafe_code)]

pub mod proximity;
pub mod skill;
mod vector;
