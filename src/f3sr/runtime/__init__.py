"""How a process runs: stages and their stored results, compiled kernels, signals, progress."""
