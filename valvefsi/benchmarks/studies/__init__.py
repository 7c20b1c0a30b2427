"""Studies over many runs: kernels, speed, scaling."""
