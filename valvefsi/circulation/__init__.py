"""Lumped models of the flow loop."""
