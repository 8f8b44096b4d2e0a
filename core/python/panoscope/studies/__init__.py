"""Studies: a graph over many recordings, on this machine or a cluster.

``plan`` makes runs of a table or a pattern, ``driver`` hands them to an executor (``executors``), ``worker`` does one run in a process with limits
(``process``), ``store`` is the folder of a study, ``table`` its data set, ``report`` and ``worst`` read it.
"""
