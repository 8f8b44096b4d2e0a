//! A rendered tissue scene seen by two or four cameras, with exact truth.
