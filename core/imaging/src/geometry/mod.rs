//! Projective geometry: homographies and robust estimation.
