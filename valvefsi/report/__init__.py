"""The page that says what was run and how far to trust it: one HTML file that needs nothing else."""
