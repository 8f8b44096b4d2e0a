"""Training of the instrument detectors that ship with Panoscope."""
