//! Graph files of Panoscope: text to checked graph, with diagnostics.
