"""Numbers and pictures of what a run left behind."""
