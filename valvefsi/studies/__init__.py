"""Studies: many steps, or many runs, of one case; resumable."""
