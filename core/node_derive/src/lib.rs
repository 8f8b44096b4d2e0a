//! Derives for ports, parameters and packets of Panoscope nodes.
