"""Deformable bodies in a flow."""
