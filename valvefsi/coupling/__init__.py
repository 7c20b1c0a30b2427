"""The coupling of grid and solid through regularised delta functions."""
