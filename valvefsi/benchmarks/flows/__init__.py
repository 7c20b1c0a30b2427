"""Flows without deformable bodies."""
