"""Meshes, shapes, tags and fibre fields."""
