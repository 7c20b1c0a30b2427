"""Norms, tables, observed order."""
